"""The part of a scene beyond memory that stays on the device: the top level, top nodes and treelets' roots, entries,
and sometimes all nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...scene.flatten import FlatGeometry
from ...scene.geometry import mat34
from ..build.encode import as_vectors
from ..build.mesh_tree import mesh_parts
from ..build.top_level import OverTime, build_top_level
from ..node import VECTOR_BYTES, Layout, aligned_empty
from ..tree import Tree
from ..treelets.links import tree_levels
from .entries import chunk_entries
from .store import Page, PageStore, bytes_of_rows, page_buffer, page_rows
from .tables import PageTables


@dataclass(frozen=True)
class Resident:
    """The part of the scene that stays on the device."""

    tree: Tree
    of_node: wp.array  # as `Treelets`
    root: wp.array  # likewise
    deform: wp.array  # likewise
    levels: int  # of the top level and of the deepest top of a mesh tree
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    bytes: int


def place_resident(
    tables: PageTables, flat: FlatGeometry, visibility: np.ndarray, layout: Layout, device: wp.Device, room: int = 0
) -> Resident:
    """Everything on `device` but pages; `visibility` as for `entries_of`.

    `room`: what the top level may take where it has several ranges of time [bytes]; it has one where that is too
    little.
    """
    entries = chunk_entries(flat, visibility, tables.chunk_first, tables.baked)
    # trees of chunks have no nodes for ranges of time
    times = OverTime(entries, tables.chunk_box, tables.chunk_sah, np.zeros(len(tables.chunk_box), bool))
    count = times.count(room) if room else 1
    top = build_top_level(entries, [times.boxes(k, count) for k in range(count)], layout, device)
    if count > 1 and VECTOR_BYTES * top.nodes.size + 4 * top.order.size > room:
        top = build_top_level(entries, [times.whole], layout, device)
    top_words = top.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)
    node_count = len(tables.top_nodes)
    tree = Tree()
    tree.nodes = _upload_words(np.concatenate([tables.top_nodes, top_words]), device)
    tree.triangles = _upload_words(tables.top_triangles, device)
    upload = _Uploads(device)
    tree.entry_node = upload.add(tables.chunk_node[entries.mesh], int)
    tree.entry_triangle = upload.add(tables.chunk_triangle[entries.mesh], int)
    tree.entry_centre = upload.add(tables.chunk_centre[entries.mesh], wp.vec3)
    tree.entry_from_world = upload.add(entries.from_world, mat34)
    tree.entry_instance = upload.add(entries.instance, int)
    tree.entry_visibility = upload.add(entries.visibility, int)
    tree.merged_first = upload.add(entries.merged_first, int)
    tree.merged_instance = upload.add(entries.merged_instance, int)
    tree.merged_triangle_first = upload.add(entries.merged_triangle_first, int)
    tree.entry_count = len(entries.mesh)
    deform = np.zeros(0, np.int32)
    if flat.motion:
        chunk_deform, deform = _deform(tables, flat, layout)
        tree.entry_motion = upload.add(entries.motion, int)
        tree.entry_deform = upload.add(chunk_deform[entries.mesh], int)
        tree.motion_keys = upload.add(entries.keys.reshape(-1), float)
        tree.motion_steps, tree.deform_steps = entries.keys.shape[1], flat.motion.vertex_steps
    top.place(tree, node_count, device)
    of_node = upload.add(np.concatenate([tables.top_treelet, np.full(len(top_words), -1)]), int)
    root, deform = upload.add(tables.treelet_root, int), upload.add(deform, int)
    size = upload.bytes + VECTOR_BYTES * (tree.nodes.size + tree.triangles.size) + 4 * top.order.size
    levels = max(len(tree_levels(layout, top_words[first:])) for first in top.first[:-1])
    box = np.stack([times.whole[:, 0].min(0), times.whole[:, 1].max(0)])
    return Resident(tree, of_node, root, deform, levels + int(tables.chunk_levels.max()), box, size)


def _deform(tables: PageTables, flat: FlatGeometry, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Units of one step: of those at the top nodes of each chunk, and of each treelet; 0 where vertices do not move."""
    steps = np.array([len(flat.motion.steps.get(part.mesh, ((),))[0]) for part in mesh_parts(flat)])
    steps = np.repeat(steps, np.diff(tables.chunk_first))  # of each chunk, 0 or more than 1
    # triangles of each treelet, up to the next one's or the end of its page's
    page, unit = tables.treelet_page, 4 * layout.triangle_words
    first = tables.treelet_triangle // unit
    end = tables.page_units[page]
    end[:-1] = np.where(page[1:] == page[:-1], first[1:], end[:-1])
    of_treelet = np.repeat(steps, np.diff(tables.chunk_treelet))
    return (
        np.where(steps > 0, np.diff(tables.chunk_triangle) // np.maximum(steps, 1), 0),
        np.where(of_treelet > 0, (end - first) // np.maximum(of_treelet, 1), 0),
    )


def load_nodes(tables: PageTables, store: PageStore, device: wp.Device) -> wp.array:
    """The nodes of all treelets on `device`, page after page, as `page_rows`."""
    nodes = page_rows(int(tables.page_bytes[:, 0].sum()), device)
    buffer: wp.array | None = None
    end = 0
    for i, (byte, size) in enumerate(zip(tables.page_byte[:, 0].tolist(), tables.page_bytes[:, 0].tolist())):
        if size == 0:
            continue
        page = Page(int(tables.page_treelet[i]), 0, byte, size, size)
        view = store.view(page) if device.is_cuda else None
        if view is not None:
            wp.copy(bytes_of_rows(nodes, end, size), view, count=size)
        elif device.is_cuda:
            buffer = buffer or page_buffer(max(int(tables.page_bytes[:, 0].max()), 64))
            store.read_into(page, buffer.numpy(), direct=True)
            wp.copy(bytes_of_rows(nodes, end, size), buffer, count=size)
            wp.synchronize_device(device)
        else:
            store.read_into(page, bytes_of_rows(nodes, end, size).numpy(), direct=True)
        end += size
    wp.synchronize_device(device)
    return nodes


class _Uploads:
    """Copies arrays to a device and counts their bytes."""

    def __init__(self, device: wp.Device):
        self._device, self.bytes = device, 0

    def add(self, values: np.ndarray, dtype: type) -> wp.array:
        host = np.ascontiguousarray(values, np.int32 if dtype is int else np.float32)
        self.bytes += host.nbytes
        # nobody changes it: a CPU reads it where it is
        return wp.array(host, dtype=dtype, device=self._device, copy=self._device.is_cuda)


def _upload_words(words: np.ndarray, device: wp.Device) -> wp.array:
    """Nodes or triangles where kernels read them; at least one element, so that there is an address."""
    host = aligned_empty((max(words.size // 4, 1), 4), np.float32)
    host[:] = 0
    host.reshape(-1).view(words.dtype)[: words.size] = words.reshape(-1)
    return wp.array(host, dtype=wp.vec4, device=device) if device.is_cuda else as_vectors(host)
