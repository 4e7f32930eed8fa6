"""The part of a scene beyond memory that stays on the device: the top level, top nodes and treelets' roots, entries,
and sometimes all nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...device.bulk import copy_rows
from ...host_memory import Room
from ...native.structs import to_numpy
from ...scene.flatten import FlatGeometry
from ...scene.geometry import host_array, mat34
from ..build.encode import as_vectors
from ..build.entries import Entries
from ..build.mesh_tree import mesh_parts
from ..build.top_level import OverTime, TopLevel, build_top_level
from ..node import VECTOR_BYTES, Layout, aligned_empty
from ..tree import Tree
from ..treelets.links import tree_levels
from .entries import chunk_entries
from .store import Page, PageStore, bytes_of_rows, page_buffer, page_rows
from .tables import PageTables


@dataclass(frozen=True, kw_only=True)
class Resident:
    """The part of the scene that stays on the device."""

    tree: Tree
    of_node: wp.array  # as `Treelets`
    root: wp.array  # likewise
    deform: wp.array  # likewise
    levels: int  # of the top level and of the deepest top of a mesh tree
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    bytes: int  # on the device
    bytes_behind: int  # of records of instances that are read where they lie behind it


# What is known of an entry that does not move: two numbers of its mesh tree, the centre, the map, two numbers of the
# instance, and its first baked instance [bytes]
_RECORD_BYTES = 80
# Share of what may stay on the device that records of instances may take of it: the rest is for pages
_RECORDS_SHARE = 0.5


@dataclass(frozen=True)
class Limits:
    """What may be on the device, and where the rest is [bytes]."""

    most: int | None = None  # of all that stays; None: no limit
    ranges: int = 0  # of the top level where it has several ranges of time; it has one where that is too little
    behind: Room = np.empty  # on a CPU: makes the arrays of what `most` has no room for


def place_resident(
    tables: PageTables,
    flat: FlatGeometry,
    visibility: np.ndarray,
    layout: Layout,
    device: wp.Device,
    limits: Limits = Limits(),
) -> Resident:
    """Everything on `device` but pages; `visibility` as for `entries_of`.

    Records of instances (all that is known of an entry but its place in the top level) lie behind the device where
    `limits` have no room for them: in host memory, which a GPU reads through the bus, or in arrays of `Limits.behind`.
    """
    entries = chunk_entries(flat, visibility, tables.chunk_first, tables.baked)
    # trees of chunks have no nodes for ranges of time
    times = OverTime(entries, tables.chunk_box, tables.chunk_sah, np.zeros(len(tables.chunk_box), bool))
    box = np.stack([times.whole[:, 0].min(0), times.whole[:, 1].max(0)])
    chunk_deform, deform = _deform(tables, flat, layout) if flat.motion else (None, np.zeros(0, np.int32))
    lists = {
        "merged_instance": (entries.merged_instance, int),
        "merged_triangle_first": (entries.merged_triangle_first, int),
        **({"motion_keys": (entries.keys.reshape(-1), float)} if flat.motion else {}),
    }
    still = 4 * (len(tables.top_treelet) + len(tables.treelet_root) + len(deform))
    still += sum(max(each.nbytes, VECTOR_BYTES) for each in (tables.top_nodes, tables.top_triangles))
    still += sum(values.nbytes for values, _ in lists.values())
    top, fits = _top_level(entries, times, layout, device, limits, still, _record_bytes(entries, bool(flat.motion)))
    del times  # the boxes of all entries
    top_words = to_numpy(top.nodes).view(layout.node_type).reshape(-1, layout.node_words)
    node_count = len(tables.top_nodes)
    tree = Tree()
    tree.nodes = _upload_words(np.concatenate([tables.top_nodes, top_words]), device)
    tree.triangles = _upload_words(tables.top_triangles, device)
    upload = _Uploads(device)
    for name, make, dtype in _records(tables, entries, chunk_deform):
        setattr(tree, name, upload.add(make(), dtype, None if fits else limits.behind))
    for name, (values, dtype) in lists.items():
        setattr(tree, name, upload.add(values, dtype))
    tree.entry_count = len(entries)
    if flat.motion:
        tree.motion_steps, tree.deform_steps = entries.keys.shape[1], flat.motion.vertex_steps
    top.place(tree, node_count, device)
    of_node = upload.add(np.concatenate([tables.top_treelet, np.full(len(top_words), -1, np.int32)]), int)
    root, deform = upload.add(tables.treelet_root, int), upload.add(deform, int)
    size = upload.bytes + VECTOR_BYTES * (tree.nodes.size + tree.triangles.size) + 4 * top.order.size
    levels = max(len(tree_levels(layout, top_words[first:])) for first in top.first[:-1])
    levels += int(tables.chunk_levels.max())
    return Resident(
        tree=tree,
        of_node=of_node,
        root=root,
        deform=deform,
        levels=levels,
        box=box,
        bytes=size,
        bytes_behind=upload.bytes_behind,
    )


def _top_level(
    entries: Entries, times: OverTime, layout: Layout, device: wp.Device, limits: Limits, still: int, records: int
) -> tuple[TopLevel, bool]:
    """The top level, and whether records, of so many bytes, may be on the device too, where `still` bytes are."""
    may_fit = limits.most is None or records <= _RECORDS_SHARE * limits.most

    def fits(top: TopLevel, beside: int) -> bool:
        # a node has a number of the treelet whose root it is
        nodes = VECTOR_BYTES * top.nodes.size + top.nodes.size * 16 // layout.node_words
        return limits.most is None or still + nodes + 4 * top.order.size + beside <= limits.most

    count = times.count(limits.ranges) if limits.ranges else 1
    top = build_top_level(entries, [times.boxes(k, count) for k in range(count)], layout, device)
    fits_ranges = VECTOR_BYTES * top.nodes.size + 4 * top.order.size <= limits.ranges
    if count > 1 and not (fits_ranges and fits(top, records * may_fit)):
        top = build_top_level(entries, [times.whole], layout, device)
    return top, may_fit and fits(top, records)


def _record_bytes(entries: Entries, moving: bool) -> int:
    """What `_records` take."""
    return _RECORD_BYTES * len(entries) + 4 + 8 * moving * len(entries)


def _records(
    tables: PageTables, entries: Entries, chunk_deform: np.ndarray | None
) -> Iterator[tuple[str, Callable[[], np.ndarray], type]]:
    """What is known of each entry: the name in `Tree`, what makes the array, and the type of Warp; `chunk_deform`: as
    `_deform`, where something moves.
    """

    def of_chunk(values: np.ndarray) -> Callable[[], np.ndarray]:
        return lambda: values[entries.mesh]

    yield "entry_node", of_chunk(tables.chunk_node.astype(np.int32)), int
    yield "entry_triangle", of_chunk(tables.chunk_triangle.astype(np.int32)), int
    yield "entry_centre", of_chunk(tables.chunk_centre), wp.vec3
    yield "entry_from_world", lambda: entries.from_world, mat34
    yield "entry_instance", lambda: entries.instance, int
    yield "entry_visibility", lambda: entries.visibility, int
    yield "merged_first", lambda: entries.merged_first, int
    if chunk_deform is not None:
        yield "entry_motion", lambda: entries.motion, int
        yield "entry_deform", of_chunk(chunk_deform.astype(np.int32)), int


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
            store.read_into(page, to_numpy(buffer), direct=True)
            wp.copy(bytes_of_rows(nodes, end, size), buffer, count=size)
            wp.synchronize_device(device)
        else:
            store.read_into(page, to_numpy(bytes_of_rows(nodes, end, size)), direct=True)
        end += size
    wp.synchronize_device(device)
    return nodes


class _Uploads:
    """Copies arrays to a device and counts their bytes."""

    def __init__(self, device: wp.Device):
        self._device = device
        self.bytes = self.bytes_behind = 0

    def add(self, values: np.ndarray, dtype: type, behind: Room | None = None) -> wp.array:
        """`values` on the device, or `behind` it, where they do not count."""
        host = np.ascontiguousarray(values, np.int32 if dtype is int else np.float32)
        if behind is None:
            self.bytes += host.nbytes
        else:
            self.bytes_behind += host.nbytes
            if self._device.is_cuda:
                return host_array(host, dtype, self._device)
            there = behind(host.shape, host.dtype)
            copy_rows(host, there)
            host = there
        # nobody changes it: a CPU reads it where it is
        return wp.array(host, dtype=dtype, device=self._device, copy=self._device.is_cuda)


def _upload_words(words: np.ndarray, device: wp.Device) -> wp.array:
    """Nodes or triangles where kernels read them; at least one element, so that there is an address."""
    host = aligned_empty((max(words.size // 4, 1), 4), np.float32)
    host[:] = 0
    host.reshape(-1).view(words.dtype)[: words.size] = words.reshape(-1)
    return wp.array(host, dtype=wp.vec4, device=device) if device.is_cuda else as_vectors(host)
