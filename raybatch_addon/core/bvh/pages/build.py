"""Scenes whose geometry need not fit in the device's memory: built chunk by chunk, and kept in pages."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ...device.bulk import digest_of
from ...device.devices import free_memory
from ...errors import OutOfMemoryError, check_cancelled
from ...host_memory import Room, mapped_empty
from ...scene.flatten import FlatGeometry
from ..build.mesh_tree import mesh_parts
from ..node import Layout
from ..treelets.cut import CutRule
from .budget import expected_bytes, least_budget, page_size
from .chunks import ChunkBuilder, chunk_size
from .cuda.packing import DevicePacker
from .divide.cells import MeshTriangles, mesh_from, mesh_triangles
from .divide.primitives import Primitives
from .entries import instances_in
from .file import PageFileWriter, delete_old_files, open_page_file
from .packing import HostPacker, NoStore, PagePacker, PageTarget
from .paged_scene import PagedScene
from .peers.share import ShareTooLargeError
from .peers.shared import PeerPages
from .peers.store import BuiltPages, PeerPlace, PeerStore
from .resident import Limits, load_nodes, place_resident
from .store import PAGE_ALIGNMENT, HostStore, Page, PageStore
from .tables import PageBuilder, PageTables, page_statistics

# Nodes stay on the device where they take no more than this share of the budget
_NODES_SHARE = 0.75
# Share of the budget that top levels for several ranges of time may take
_RANGES_SHARE = 0.125
# Share of the host's free memory that pages may take once more, as the device has them
_PLAIN_SHARE = 0.5


@dataclass
class _BuildRecord:
    """How the pages of a scene were made."""

    store: str  # HOST, PEERS or DISK
    page_bytes: int  # of a page on the device at most
    encoded: bool  # as in `PagedScene`
    reused: bool = False  # they were found in a file
    page_file_warning: str = ""  # why a file was not used
    seconds_build: float = 0.0

    @property
    def statistics(self) -> dict[str, Any]:
        """The figures by name."""
        figures = asdict(self)
        if not self.page_file_warning:
            del figures["page_file_warning"]
        return figures


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
    peers: PeerPages | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> PagedScene:
    """Build `flat`, of at least one triangle, in chunks, or find what was built of it before.

    Args:
        visibility: `Visibility` bits of each instance, int, shape [instance_count].
        layout: BOXES for the traversal of CPUs, QUANTISED for that of GPUs.
        device: that traces.
        budget: bytes of nodes and triangles on the device at most.
        store: HOST, PEERS or DISK.
        folder: of the files of DISK.
        rule: cuts the tree of each chunk (`top_bytes_max` is that of all together); by default a chunk is one treelet.
        nodes_resident: whether all nodes stay on the device; None: where they fit well.
        spatial_splits, on_device: as for `MeshTrees`.
        encoded: pages hold triangles packed, to be expanded on arrival (`PagedScene.expand`); QUANTISED only.
        plain: HOST keeps encoded pages as the device has them besides, so that rays can read them there; None: for
            CUDA, where memory allows.
        corners: those of all triangles in the order of `flat`, wp.vec3 [3 n], where `device` reads them faster than it
            reads `flat`; there may be none.
        peers: of PEERS: what `device` is among those that hold the pages. Its share is part of `budget`.
        cancelled: ends the build soon; may be asked on any thread.

    `statistics` say what was done, `page_file_warning` among them where a file could not be used.

    Raises `OutOfMemoryError` for a budget that is too small, and says what is enough, and where a chunk or HOST does
    not fit; `PageFileError` where the file cannot be written; `BuildCancelledError`, after which no file is left.
    """
    if encoded and layout is not Layout.QUANTISED:
        raise ValueError("only triangles of QUANTISED are packed")
    start = time.perf_counter()
    share = peers.way.share if peers else 0
    page_bytes = page_size(budget - share)
    staged = device.is_cuda and encoded  # a page that arrives has a buffer beside its slot
    primitives = Primitives.of(flat)
    spatial_splits = spatial_splits and not primitives.stand_in

    def builder_of(page_bytes: int) -> ChunkBuilder:
        return ChunkBuilder(
            layout,
            device,
            rule,
            len(flat.triangles),
            page_bytes=_treelets_bytes(page_bytes),
            spatial_splits=spatial_splits,
            on_device=on_device,
            cancelled=cancelled,
        )

    @functools.cache
    def source_on(where: str) -> tuple[MeshTriangles, MeshTriangles | None]:
        device = wp.get_device(where)
        if primitives.stand_in:
            boxed = mesh_triangles(primitives.boxed_positions, primitives.boxed_triangles, device)
            return boxed, mesh_triangles(primitives.positions, primitives.triangles, device)
        return mesh_triangles(flat.positions, flat.triangles, device, corners if device.is_cuda else None), None

    def build(
        builder: ChunkBuilder, page_bytes: int, target: HostStore | PageTarget, plain: HostStore | None = None
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
        resident = place_resident(tables, flat, visibility, layout, device, Limits(most=0))
        return tables.needed_bytes(resident.bytes, bool(nodes_resident), staged)

    def too_small() -> OutOfMemoryError:
        if share:
            return ShareTooLargeError("the shares of pages leave no room for what is brought in")
        enough = least_budget(budget, len(flat.triangles), bound, needed)
        return OutOfMemoryError(
            f"a geometry budget of {budget:,} bytes is too small for {len(flat.triangles):,} triangles and "
            f"{len(flat.instance_mesh):,} instances: the top level and the roots of treelets must stay on the device, "
            f"beside a page; {enough:,} bytes are enough"
        )

    if bound(page_bytes) > budget - share:
        raise too_small()
    builder = builder_of(page_bytes)
    record = _BuildRecord(store if share or store != "PEERS" else "HOST", page_bytes, encoded)
    copy: HostStore | None = None
    expected = expected_bytes(primitives, flat.curves, layout, encoded)
    if store == "DISK":
        tables, pages = _from_disk(
            flat, layout, builder, rule, folder=Path(folder), expected=expected, record=record, build=build
        )
    elif peers is not None:

        def make() -> BuiltPages:
            _check_host(expected - share * len(peers.devices))
            held = PeerStore(peers.devices, share)
            return BuiltPages(build(builder, page_bytes, held)[0], held)

        key = _key(flat, layout, builder, rule, page_bytes, encoded) + repr((peers.devices, share, budget)).encode()
        built = peers.shared.get(key, make, cancelled)
        tables, pages = built.tables, PeerPlace(built, peers.place)
    else:
        free = _check_host(expected)
        pages = HostStore(pinned=device.is_cuda)
        if plain is None:
            expanded = expected_bytes(primitives, flat.curves, layout, False)
            plain = device.is_cuda and expected + expanded < _PLAIN_SHARE * free
        copy = HostStore(pinned=device.is_cuda) if encoded and plain else None
        tables, copy_byte = build(builder, page_bytes, pages, copy)
    check_cancelled(cancelled)
    record.seconds_build = round(time.perf_counter() - start, 6)
    made = _assembled(
        flat=flat,
        visibility=visibility,
        layout=layout,
        device=device,
        budget=budget,
        tables=tables,
        store=pages,
        nodes_resident=nodes_resident,
        record=record,
        behind=functools.partial(mapped_empty, folder=Path(folder)) if store == "DISK" else np.empty,
    )
    if made is None:
        if isinstance(pages, PeerPlace) and share:
            peers.shared.refuse(key)
        raise too_small()
    if copy:
        # where nodes stay on the device, a page begins with its triangles
        skipped = tables.page_device[:, 0] * made.nodes_resident
        made.plain, made.plain_byte = copy, (np.array(copy_byte, np.int64) + skipped).tolist()
    return made


def _check_host(needed: int) -> int:
    """Free memory of the host [bytes]; raises `OutOfMemoryError` where that is less than `needed`."""
    free = free_memory(wp.get_device("cpu"))
    if needed > free:
        raise OutOfMemoryError(
            f"the scene's geometry takes about {needed / 1e9:.2f} GB, and {free / 1e9:.2f} GB of memory are free; "
            "use DISK"
        )
    return free


def _from_disk(
    flat: FlatGeometry,
    layout: Layout,
    builder: ChunkBuilder,
    rule: CutRule,
    *,
    folder: Path,
    expected: int,
    record: _BuildRecord,
    build: Callable,
) -> tuple[PageTables, PageStore]:
    """Tables and pages of the file in `folder`, which is written where there is none that is sound; it takes about
    `expected` bytes.
    """
    key = _key(flat, layout, builder, rule, record.page_bytes, record.encoded)
    found = open_page_file(folder, layout, key)
    if isinstance(found, tuple):
        try:
            tables = PageTables.from_index(found[1])
            record.reused = True
            return tables, found[0]
        except KeyError as error:
            found = f"{found[0].path} does not hold {error}"
    if found is not None:
        record.page_file_warning = f"{found}: it was written anew"
    writer = PageFileWriter(folder, layout, key, expected)
    try:
        tables, _ = build(builder, record.page_bytes, writer)
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
    *,
    flat: FlatGeometry,
    visibility: np.ndarray,
    layout: Layout,
    device: wp.Device,
    budget: int,
    tables: PageTables,
    store: PageStore,
    nodes_resident: bool | None,
    record: _BuildRecord,
    behind: Room,
) -> PagedScene | None:
    """The scene: what stays on the device, and its tables; all of it is within the budget, and a page too. None where
    that cannot be.
    """
    start = time.perf_counter()
    staged = device.is_cuda and record.encoded
    peer = store if isinstance(store, PeerPlace) else None
    held = peer.held if peer else 0
    budget -= held
    most = budget - tables.needed_bytes(0, bool(nodes_resident), staged)
    limits = Limits(most, int(_RANGES_SHARE * budget), behind)
    resident = place_resident(tables, flat, visibility, layout, device, limits)
    node_bytes = int(tables.page_bytes[:, 0].sum())
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
    seconds = round(time.perf_counter() - start + record.seconds_build, 6)
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
        resident_bytes=resident.bytes + nodes.size + held,
        home=peer.home_addresses(pages) if peer and not record.encoded else None,
        encoded=record.encoded,
        page_node_bytes=tables.page_bytes[:, 0] * (not nodes_resident),
        page_units=tables.page_units,
        statistics={
            **record.statistics,
            "seconds": seconds,
            **(peer.statistics() if peer else {}),
            **page_statistics(tables, layout, resident.tree, resident.levels, nodes_resident),
            **({"records_behind": resident.bytes_behind} if resident.bytes_behind else {}),
        },
    )


def _treelets_bytes(page_bytes: int) -> int:
    """Bytes of the treelets in a page, whose two segments are padded."""
    return max(page_bytes - 2 * PAGE_ALIGNMENT, page_bytes // 2)
