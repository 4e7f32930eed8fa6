"""Scenes whose geometry need not fit in the device's memory: built chunk by chunk, and kept in pages."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ...device.bulk import digest_of
from ...device.devices import free_memory
from ...errors import OutOfMemoryError, check_cancelled
from ...scene.flatten import FlatGeometry
from ..build.mesh_tree import mesh_parts
from ..node import Layout
from ..tree import Tree
from ..treelets.cut import CutRule
from .budget import expected_bytes, least_budget, page_size
from .chunks import ChunkBuilder, chunk_size
from .cuda.packing import DevicePacker
from .divide.cells import MeshTriangles, mesh_from, mesh_triangles
from .divide.primitives import Primitives
from .encode import expand_page
from .entries import instances_in
from .file import PageFileWriter, delete_old_files, open_page_file
from .packing import HostPacker, NoStore, PagePacker
from .resident import Resident, load_nodes, place_resident
from .store import PAGE_ALIGNMENT, HostStore, Page, PageStore
from .tables import PageBuilder, PageTables

# Nodes stay on the device where they take no more than this share of the budget
_NODES_SHARE = 0.75
# Share of the host's free memory that pages may take once more, as the device has them
_PLAIN_SHARE = 0.5


@dataclass(kw_only=True)
class PagedScene:
    """The trees of a scene: what stays on the device, and pages of the rest.

    Every mesh is cut into chunks of nearby triangles, each a mesh tree by itself, and each instance has an entry for
    every chunk of its mesh; so there always is a top level (`SceneFeatures.instancing`).
    """

    layout: Layout
    tree: Tree  # on the device: top level, top nodes and roots of treelets, the few triangles right at them
    of_node: wp.array  # as `Treelets`, on the device
    root: wp.array  # likewise
    deform: wp.array  # likewise
    treelet_count: int
    levels: int  # resident levels on the longest way to a treelet's root: those of the top level and of one mesh's top
    pages: list[Page] = field(repr=False)
    treelet_page: np.ndarray  # int32, shape [treelet_count]
    # where a treelet's nodes begin in its page on the device, int64, shape [treelet_count]
    treelet_node_byte: np.ndarray
    treelet_triangle_byte: np.ndarray  # likewise its triangles
    nodes_resident: bool  # pages hold triangles alone; `treelet_node_byte` is then a byte of `resident_nodes`
    resident_nodes: wp.array  # as `page_rows`, on the device: the nodes of all treelets, or empty
    store: PageStore
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    resident_bytes: int  # of `tree`, `of_node`, `root` and `resident_nodes`
    # where the triangles of each page begin, in the store and on the device, int64, shape [pages]
    page_node_bytes: np.ndarray
    page_units: np.ndarray  # triangles, or groups of them (BOXES), of each page, likewise
    encoded: bool = False  # triangles are packed, and every page must be expanded where it arrives
    plain: HostStore | None = field(
        default=None, repr=False
    )  # pages of an encoded scene as the device has them, for rays to read there
    plain_byte: list[int] = field(default_factory=list, repr=False)  # where each begins
    statistics: dict[str, Any] = field(default_factory=dict)

    @property
    def page_bytes_max(self) -> int:
        """Bytes of the largest page on the device."""
        return max((page.device_bytes for page in self.pages), default=0)

    def plain_view(self, page: int) -> wp.array | None:
        """Page number `page` in host memory as the device has it; None where there is no such copy."""
        if self.plain is None:
            return None
        return self.plain.view(
            replace(self.pages[page], byte_first=self.plain_byte[page], byte_count=self.pages[page].device_bytes)
        )

    def expand(self, page: int, source: wp.array, target: wp.array) -> None:
        """Bring page number `page` of an encoded scene from `source` to `target`, in the current stream; as
        `expand_page`.
        """
        nodes = int(self.page_node_bytes[page])
        expand_page(source, target, nodes, nodes, int(self.page_units[page]))


def build_paged_scene(
    flat: FlatGeometry,
    visibility: np.ndarray,
    layout: Layout,
    device: wp.Device,
    budget: int,
    store: str = "HOST",
    folder: Path | None = None,
    rule: CutRule = CutRule(),
    nodes_resident: bool | None = None,
    spatial_splits: bool = False,
    on_device: bool | None = None,
    encoded: bool = False,
    plain: bool | None = None,
    corners: wp.array | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> PagedScene:
    """Build `flat`, of at least one triangle, in chunks, or find what was built of it before.

    Args:
        visibility: `Visibility` bits of each instance, int, shape [instance_count].
        layout: BOXES for the traversal of CPUs, QUANTISED for that of GPUs.
        device: that traces.
        budget: bytes of nodes and triangles on the device at most.
        store: HOST or DISK.
        folder: of the files of DISK.
        rule: cuts the tree of each chunk (`top_bytes_max` is that of all together); by default a chunk is one treelet.
        nodes_resident: whether all nodes stay on the device; None: where they fit well.
        spatial_splits, on_device: as for `MeshTrees`.
        encoded: pages hold triangles packed, to be expanded on arrival (`PagedScene.expand`); QUANTISED only.
        plain: HOST keeps encoded pages as the device has them besides, so that rays can read them there; None: for
            CUDA, where memory allows.
        corners: those of all triangles in the order of `flat`, wp.vec3 [3 n], where `device` reads them faster than it
            reads `flat`; there may be none.
        cancelled: ends the build soon; may be asked on any thread.

    `statistics` say what was done, `page_file_warning` among them where a file could not be used.

    Raises `OutOfMemoryError` for a budget that is too small, and says what is enough, and where a chunk or HOST does
    not fit; `PageFileError` where the file cannot be written; `BuildCancelledError`, after which no file is left.
    """
    if encoded and layout is not Layout.QUANTISED:
        raise ValueError("only triangles of QUANTISED are packed")
    start = time.perf_counter()
    page_bytes = page_size(budget)
    staged = device.is_cuda and encoded  # a page that arrives has a buffer beside its slot
    primitives = Primitives.of(flat)
    spatial_splits = spatial_splits and not primitives.stand_in

    def builder_of(page_bytes: int) -> ChunkBuilder:
        return ChunkBuilder(
            layout, device, rule, len(flat.triangles), _treelets_bytes(page_bytes), spatial_splits, on_device, cancelled
        )

    @functools.cache
    def source_on(where: str) -> tuple[MeshTriangles, MeshTriangles | None]:
        device = wp.get_device(where)
        if primitives.stand_in:
            boxed = mesh_triangles(primitives.boxed_positions, primitives.boxed_triangles, device)
            return boxed, mesh_triangles(primitives.positions, primitives.triangles, device)
        return mesh_triangles(flat.positions, flat.triangles, device, corners if device.is_cuda else None), None

    def build(
        builder: ChunkBuilder,
        page_bytes: int,
        target: HostStore | PageFileWriter | NoStore,
        plain: HostStore | None = None,
    ) -> tuple[PageTables, list[int]]:
        packer: PagePacker = (
            DevicePacker(device, target, encoded, plain)
            if builder.on_device
            else HostPacker(layout, target, primitives.positions if encoded else None, plain)
        )
        try:
            pages = PageBuilder(layout, page_bytes, packer)
            return _build(flat, primitives, source_on(builder.where.alias), builder, pages), packer.plain_byte
        finally:
            packer.close()

    def bound(page_bytes: int) -> int:
        size_max = chunk_size(layout, _treelets_bytes(page_bytes), spatial_splits)
        return (
            sum(-(-part.triangle_count // size_max) for part in mesh_parts(flat)) * 4 * layout.node_words
            + PAGE_ALIGNMENT
        )

    def needed(page_bytes: int) -> int:
        tables, _ = build(builder_of(page_bytes), page_bytes, NoStore())
        resident = place_resident(tables, flat, visibility, layout, device)
        return tables.needed_bytes(resident.bytes, bool(nodes_resident), staged)

    def too_small() -> OutOfMemoryError:
        enough = least_budget(budget, len(flat.triangles), bound, needed)
        return OutOfMemoryError(
            f"a geometry budget of {budget:,} bytes is too small for {len(flat.triangles):,} triangles: top level, "
            "instances and the roots of "
            f"treelets must stay on the device, beside a page; {enough:,} bytes are enough"
        )

    if bound(page_bytes) > budget:
        raise too_small()
    builder = builder_of(page_bytes)
    known: dict[str, Any] = {"store": store, "page_bytes": page_bytes, "encoded": encoded, "reused": False}
    copy: HostStore | None = None
    expected = expected_bytes(primitives, flat.curves, layout, encoded)
    if store == "DISK":
        tables, pages = _from_disk(flat, layout, builder, rule, Path(folder), expected, known, build)
    else:
        free = free_memory(wp.get_device("cpu"))
        if expected > free:
            raise OutOfMemoryError(
                f"the scene's geometry takes about {expected / 1e9:.2f} GB, and {free / 1e9:.2f} GB of memory are "
                "free; use DISK"
            )
        pages = HostStore(pinned=device.is_cuda)
        if plain is None:
            expanded = expected_bytes(primitives, flat.curves, layout, False)
            plain = device.is_cuda and expected + expanded < _PLAIN_SHARE * free
        copy = HostStore(pinned=device.is_cuda) if encoded and plain else None
        tables, copy_byte = build(builder, page_bytes, pages, copy)
    check_cancelled(cancelled)
    known["seconds_build"] = round(time.perf_counter() - start, 6)
    made = _assembled(flat, visibility, layout, device, budget, tables, pages, nodes_resident, known)
    if made is None:
        raise too_small()
    if copy:
        # where nodes stay on the device, a page begins with its triangles
        skipped = tables.page_device[:, 0] * made.nodes_resident
        made.plain, made.plain_byte = copy, (np.array(copy_byte, np.int64) + skipped).tolist()
    return made


def _from_disk(
    flat: FlatGeometry,
    layout: Layout,
    builder: ChunkBuilder,
    rule: CutRule,
    folder: Path,
    expected: int,
    known: dict[str, Any],
    build: Callable,
) -> tuple[PageTables, PageStore]:
    """Tables and pages of the file in `folder`, which is written where there is none that is sound; it takes about
    `expected` bytes.
    """
    page_bytes, encoded = known["page_bytes"], known["encoded"]
    key = _key(flat, layout, builder, rule, page_bytes, encoded)
    found = open_page_file(folder, layout, key)
    if isinstance(found, tuple):
        try:
            tables = PageTables.from_index(found[1])
            known["reused"] = True
            return tables, found[0]
        except KeyError as error:
            found = f"{found[0].path} does not hold {error}"
    if found is not None:
        known["page_file_warning"] = f"{found}: it was written anew"
    writer = PageFileWriter(folder, layout, key, expected)
    try:
        tables, _ = build(builder, page_bytes, writer)
        store = writer.finish(tables.index())
    except BaseException:
        writer.abandon()
        raise
    delete_old_files(folder, writer.path)
    return tables, store


def _build(
    flat: FlatGeometry,
    primitives: Primitives,
    source: tuple[MeshTriangles, MeshTriangles | None],
    builder: ChunkBuilder,
    pages: PageBuilder,
) -> PageTables:
    """Tables of what goes to the store of `pages`. `source`: stand-ins, or what needs none, and primitives that have
    some.
    """
    none = np.zeros(0, np.int32)
    for i, part in enumerate(mesh_parts(flat)):
        mesh, own_mesh = (each and mesh_from(each, part.triangle_first) for each in source)
        boxed, own = primitives.boxed_triangles[part.span], primitives.own(part)
        for chunk in builder.build(mesh, primitives.boxed_positions, boxed, own, own_mesh):
            instances = instances_in(flat.merged[i], chunk.faces) if i < len(flat.merged) else none
            pages.add(chunk, instances, flat.triangles[part.span])
        pages.end_part()
    return pages.finish()


def _key(
    flat: FlatGeometry, layout: Layout, builder: ChunkBuilder, rule: CutRule, page_bytes: int, encoded: bool
) -> bytes:
    """The key of everything that pages and tables depend on; instances and what they show do not change them, but for
    baked ones.
    """
    arrays = [flat.positions, flat.triangles, *(group.instance_triangle_first for group in flat.merged)]
    if flat.motion:
        arrays += [vertices for vertices, _ in flat.motion.steps.values()]
    parts = [tuple(part) for part in mesh_parts(flat)]
    return digest_of(arrays, repr((layout, builder.choices, rule, page_bytes, encoded, parts)))


def _assembled(
    flat: FlatGeometry,
    visibility: np.ndarray,
    layout: Layout,
    device: wp.Device,
    budget: int,
    tables: PageTables,
    store: PageStore,
    nodes_resident: bool | None,
    known: dict[str, Any],
) -> PagedScene | None:
    """The scene: what stays on the device, and its tables; all of it is within the budget, and a page too. None where
    that cannot be.
    """
    start = time.perf_counter()
    resident = place_resident(tables, flat, visibility, layout, device)
    node_bytes = int(tables.page_bytes[:, 0].sum())
    staged = device.is_cuda and known["encoded"]
    if nodes_resident is None:
        # room for more than one page without nodes
        rest = budget - resident.bytes - node_bytes
        page_most = int(tables.page_device[:, 1].max()) + staged * int(tables.page_bytes[:, 1].max())
        nodes_resident = node_bytes <= _NODES_SHARE * budget and rest >= 2 * page_most
    if tables.needed_bytes(resident.bytes, nodes_resident, staged) > budget:
        return None
    sizes, stored = tables.page_sizes(nodes_resident)
    first, ends = tables.page_byte[:, 1 if nodes_resident else 0], tables.page_treelet
    pages = [
        Page(int(ends[i]), int(ends[i + 1] - ends[i]), int(first[i]), int(stored[i]), int(sizes[i]))
        for i in range(len(sizes))
    ]
    page = tables.treelet_page
    if nodes_resident:
        nodes_first = np.cumsum(tables.page_bytes[:, 0]) - tables.page_bytes[:, 0]
        node_byte, triangle_byte = nodes_first[page] + tables.treelet_node, tables.treelet_triangle
        nodes = load_nodes(tables, store, device)
    else:
        node_byte, triangle_byte = tables.treelet_node, tables.page_bytes[page, 0] + tables.treelet_triangle
        nodes = wp.empty((0, PAGE_ALIGNMENT), dtype=wp.uint8, device=device)
    wp.synchronize_device(device)
    known["seconds"] = round(time.perf_counter() - start + known["seconds_build"], 6)
    return PagedScene(
        layout=layout,
        tree=resident.tree,
        of_node=resident.of_node,
        root=resident.root,
        deform=resident.deform,
        treelet_count=len(tables.treelet_root),
        levels=resident.levels,
        pages=pages,
        treelet_page=page,
        treelet_node_byte=node_byte,
        treelet_triangle_byte=triangle_byte,
        nodes_resident=bool(nodes_resident),
        resident_nodes=nodes,
        store=store,
        box=resident.box,
        resident_bytes=resident.bytes + nodes.size,
        encoded=known["encoded"],
        page_node_bytes=tables.page_bytes[:, 0] * (not nodes_resident),
        page_units=tables.page_units,
        statistics={**known, **_description(tables, layout, resident, nodes_resident)},
    )


def _treelets_bytes(page_bytes: int) -> int:
    """Bytes of the treelets in a page, whose two segments are padded."""
    return max(page_bytes - 2 * PAGE_ALIGNMENT, page_bytes // 2)


def _description(tables: PageTables, layout: Layout, resident: Resident, nodes_resident: bool) -> dict[str, Any]:
    """Figures of the pages for statistics."""
    node_bytes, triangle_bytes = (int(each) for each in tables.page_device.sum(0))
    return {
        "layout": layout.value,
        "trees": len(tables.chunk_first) - 1,
        "chunks": len(tables.chunk_size),
        "entries": resident.tree.entry_count,
        "triangles": int(tables.chunk_size.sum()),
        "treelets": len(tables.treelet_root),
        "pages": len(tables.page_bytes),
        "page_fill": round(float(tables.page_device.sum(1).mean() / max(tables.page_device.sum(1).max(), 1)), 4),
        "bytes": node_bytes + triangle_bytes + tables.top_nodes.nbytes + tables.top_triangles.nbytes,
        "node_bytes": node_bytes,
        "triangle_bytes": triangle_bytes,
        "stored_bytes": int(tables.page_bytes.sum()),
        "nodes_resident": bool(nodes_resident),
        "depth": int(tables.chunk_depth.max()),
        "levels": resident.levels,
        "sah": round(float(tables.chunk_sah.max()), 4),
    }
