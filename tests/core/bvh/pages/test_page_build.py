"""Scenes built in chunks and kept in pages: sound trees, all triangles, the hits of the scene in memory."""

import functools
import itertools
import re

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout, triangle_faces
from raybatch_addon.core.bvh.pages import chunks as page_chunks
from raybatch_addon.core.bvh.pages.build import build_paged_scene, page_size
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.errors import BuildCancelledError, OutOfMemoryError
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.support import paged_scenes, scenes
from tests.support.running.shares import each_of, pairs_of
from tests.support.under_test import DEVICE
from tests.twins.tree_walk import triangle_corners
from tests.twins.treelet_walk import walk_treelets

# layout, built where rays are traced
KINDS = {"boxes": (Layout.BOXES, False), "quantised": (Layout.QUANTISED, False), "device": (Layout.QUANTISED, True)}
MANY = CutRule(size=4, size_min=1)


@functools.cache
def scene():
    made = paged_scenes.everything()
    return made, flatten(made)


def paged(kind: str, budget: int, store: str = "HOST", **more) -> PagedScene:
    layout, on_device = KINDS[kind]
    made, flat = scene()
    return build_paged_scene(
        flat, made.instances.visibility, layout, wp.get_device("cpu"), budget, store, on_device=on_device, **more
    )


@pytest.mark.parametrize("asks", [1, 5, 20])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_cancel_ends_the_build_and_leaves_no_file(kind, store, asks, tmp_path):
    answers = itertools.count()
    with pytest.raises(BuildCancelledError):
        paged(kind, 300_000, store, folder=tmp_path, cancelled=lambda: next(answers) >= asks)
    assert next(answers) < asks + 20  # what was under way at that time ends too
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rule", [CutRule(), MANY, CutRule(size=1)], ids=["one", "many", "all"])
@pytest.mark.parametrize("budget", each_of(2, [300_000, 600_000, 100_000_000]))
@pytest.mark.parametrize("kind", KINDS)
def test_chunks_are_sound_trees_and_hold_every_triangle_once(kind, budget, rule):
    built, (_, flat) = paged(kind, budget, rule=rule, nodes_resident=False), scene()
    held = []
    chunks = paged_scenes.cut_blocks(built)
    assert (
        len(chunks) == built.statistics["chunks"] and sum(len(chunk.nodes) for chunk in chunks) == built.treelet_count
    )
    first = np.unique(built.tree.entry_node.numpy())
    for chunk, node in zip(chunks, first):
        walk_treelets(built.layout, chunk)
        # the mesh that the chunk is of: baked ones share a part
        instance = int(built.tree.entry_instance.numpy()[np.flatnonzero(built.tree.entry_node.numpy() == node)[0]])
        e = int(np.flatnonzero(built.tree.entry_node.numpy() == node)[0])
        if instance < 0:
            instance = int(built.tree.merged_instance.numpy()[built.tree.merged_first.numpy()[e]])
        start = next(
            (group.triangle_first for group in flat.merged if instance in group.instance),
            flat.mesh_triangle_first[flat.instance_mesh[instance]],
        )
        for words in (chunk.top_triangles, *chunk.triangles):
            faces, corners = triangle_faces(built.layout, words), triangle_corners(built.layout, words)
            held.append(start + faces[faces >= 0])
            assert np.array_equal(corners[faces >= 0], flat.positions[flat.triangles[held[-1]]])
    assert np.array_equal(np.sort(np.concatenate(held)), np.arange(len(flat.triangles)))
    assert built.statistics["triangles"] == len(flat.triangles)


@pytest.mark.parametrize("nodes_resident", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_pages_are_runs_of_whole_treelets_within_their_size(kind, nodes_resident):
    budget = 500_000
    built = paged(kind, budget, nodes_resident=nodes_resident, rule=MANY)
    assert len(built.pages) > 3 and built.nodes_resident == nodes_resident
    ends = [page.treelet_first + page.treelet_count for page in built.pages]
    assert [page.treelet_first for page in built.pages] == [0, *ends[:-1]] and ends[-1] == built.treelet_count
    assert np.array_equal(
        built.treelet_page, np.repeat(np.arange(len(built.pages)), [page.treelet_count for page in built.pages])
    )
    assert built.page_bytes_max <= page_size(budget) <= budget // 8
    assert all(page.byte_first % 4096 == page.byte_count % 4096 == 0 for page in built.pages)
    assert built.resident_bytes + built.page_bytes_max <= budget
    assert np.array_equal(np.sort(built.of_node.numpy()[built.root.numpy()]), np.arange(built.treelet_count))
    nodes, triangles = paged_scenes.blocks(built)
    for k, page in enumerate(built.treelet_page):
        assert (
            built.treelet_triangle_byte[k] >= 0
            and built.treelet_triangle_byte[k] + triangles[k].nbytes <= built.pages[page].device_bytes
        )
    if nodes_resident:
        assert built.resident_nodes.size >= sum(block.nbytes for block in nodes)


@pytest.mark.parametrize("kind", KINDS)
def test_chunks_share_what_may_be_resident(kind):
    least = paged(kind, 500_000, nodes_resident=False)
    built = paged(kind, 500_000, nodes_resident=False, rule=CutRule(top_bytes_max=60_000))
    assert built.treelet_count > 2 * least.treelet_count
    top = 4 * built.layout.node_words * built.tree.top_node + 16 * built.tree.triangles.size
    # a root stays in any case
    assert 15_000 < top <= 60_000 + 4 * built.layout.node_words * built.statistics["chunks"]
    for chunk in paged_scenes.cut_blocks(built):
        walk_treelets(built.layout, chunk)


def test_nodes_stay_where_they_fit_well():
    assert not paged("quantised", 130_000).nodes_resident
    assert paged("quantised", 2_000_000).nodes_resident


@pytest.mark.parametrize("budget", [250_000, 2_000_000])
@pytest.mark.parametrize("kind", KINDS)
def test_hits_are_those_of_the_scene_in_memory(kind, budget):
    """Ties between touching meshes too: distances, instances and primitives are the same bit for bit."""
    made, flat = scene()
    layout, on_device = KINDS[kind]
    device = wp.get_device("cpu")
    built = build_scene_tree(
        flat, upload_geometry(flat, made, device), made.instances.visibility, True, device, layout, on_device=on_device
    )
    for visibility in (1, 255):
        expected = traced(built.tree, layout, visibility)
        found = traced(paged_scenes.whole_tree(paged(kind, budget)), layout, visibility)
        assert (expected[1] >= 0).sum() > 500
        for a, b in zip(expected, found):
            assert np.array_equal(a, b)


@pytest.mark.parametrize("layout", Layout)
def test_hits_are_those_of_a_scene_in_memory_without_instancing(layout):
    """Entries of identity change no bit of a ray, also of those along axes."""
    device = wp.get_device("cpu")
    ball, other = scenes.sphere("ball", 40, 20), scenes.sphere("other", 40, 20)
    made = scenes.scene(
        [(ball, scenes.IDENTITY, scenes.diffuse()), (other, scenes.translation(0.5, 0, 0), scenes.diffuse())]
    )
    flat = flatten(made)
    built = build_scene_tree(
        flat, upload_geometry(flat, made, device), made.instances.visibility, False, device, layout
    )
    assert not built.instancing
    paged = build_paged_scene(flat, made.instances.visibility, layout, device, 150_000)
    assert paged.statistics["chunks"] > 5
    expected, found = (
        traced(built.tree, layout, 255, instancing=False),
        traced(paged_scenes.whole_tree(paged), layout, 255),
    )
    assert (expected[1] >= 0).sum() > 500
    for a, b in zip(expected, found):
        assert np.array_equal(a, b)


def traced(tree, layout, visibility, instancing=True) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(3)
    count = 3000
    rays = allocate_rays(count, wp.get_device("cpu"))
    origin = rng.normal(size=(count, 3)) * 4
    vertices = scene()[1].positions
    # half of them through vertices, where triangles tie
    aim = np.where(
        np.arange(count)[:, None] % 2,
        vertices[rng.integers(0, len(vertices), count)],
        rng.normal(size=(count, 3)) * 1.5,
    )
    direction = aim - origin
    # some along axes, with zeros of either sign, from vertices' own coordinates
    direction[:600] = np.where(
        np.arange(3) == rng.integers(0, 3, (600, 1)), np.sign(direction[:600]), np.copysign(0.0, direction[:600])
    )
    origin[:600] = vertices[rng.integers(0, len(vertices), 600)] - 5 * direction[:600]
    rays.origin.assign(origin.astype(np.float32))
    rays.direction.assign(direction.astype(np.float32))
    rays.t_max.fill_(np.inf)
    rays.visibility.fill_(visibility)
    listed = RayList(
        wp.array(np.arange(count, dtype=np.int32), device="cpu"), wp.array([count], dtype=int, device="cpu"), count
    )
    trace_stage(layout, TraceOptions(any_hit=False, instancing=instancing)).launch(tree, rays, listed, None)
    return rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy()


def test_chunks_that_come_out_too_large_are_divided(monkeypatch):
    monkeypatch.setitem(page_chunks.CHUNK_BYTES_EACH, Layout.BOXES, 10)
    built = paged("boxes", 600_000, nodes_resident=False)
    assert built.page_bytes_max <= page_size(600_000)
    assert sum(len(chunk.triangles) for chunk in paged_scenes.cut_blocks(built)) == built.statistics["chunks"]


def enough_of(error: pytest.ExceptionInfo) -> int:
    """The budget that a refusal calls enough."""
    (number,) = re.findall(r"too small.* ([\d,]+) bytes are enough", str(error.value))
    return int(number.replace(",", ""))


@pytest.mark.parametrize("kind, rule", pairs_of(zip(KINDS, KINDS), {"one": CutRule(), "many": MANY}.items()))
def test_a_budget_that_is_too_small_is_refused_with_the_least_one_that_is_enough(kind, rule):
    """Whatever is asked for, it is the same number."""
    with pytest.raises(OutOfMemoryError) as error:
        paged(kind, 1, rule=rule)
    enough = enough_of(error)
    assert 15_000 < enough < 500_000
    for budget in (enough // 2, enough - 1):
        with pytest.raises(OutOfMemoryError) as error:
            paged(kind, budget, rule=rule)
        assert enough_of(error) == enough
    built = paged(kind, enough, rule=rule)
    assert built.resident_bytes + built.page_bytes_max <= enough
    residency = Residency(built, enough, wp.get_device("cpu"))
    assert residency.slot_count == 1
    residency.close()


@pytest.mark.parametrize("nodes_resident", [False, True])
def test_the_budget_that_is_named_is_enough_for_pages_that_arrive_packed(nodes_resident):
    """On CUDA they have a buffer beside their slot."""
    made, flat = scene()
    device = wp.get_device(DEVICE)

    def build(budget: int) -> PagedScene:
        return build_paged_scene(
            flat,
            made.instances.visibility,
            Layout.QUANTISED,
            device,
            budget,
            nodes_resident=nodes_resident,
            encoded=True,
        )

    with pytest.raises(OutOfMemoryError) as error:
        build(10_000)
    enough = enough_of(error)
    with pytest.raises(OutOfMemoryError):
        build(enough - 1)
    Residency(build(enough), enough, device).close()


def test_sizes_of_pages():
    assert [page_size(b) for b in (0, 100_000, 2 << 20, 127 << 20, 200 << 20, 256 << 20, 1 << 40)] == [
        8192,
        12288 - 4096 + 4096,
        256 << 10,
        (127 << 17) // 4096 * 4096,
        16 << 20,
        32 << 20,
        64 << 20,
    ]


def test_a_scene_of_one_triangle():
    made = scenes.scene(
        [
            (
                scenes.Mesh("one", np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.int32([[0, 1, 2]])),
                scenes.IDENTITY,
                scenes.diffuse(),
            )
        ]
    )
    flat = flatten(made)
    for layout in Layout:
        built = build_paged_scene(flat, made.instances.visibility, layout, wp.get_device("cpu"), 100_000)
        assert built.treelet_count == len(built.pages) == 1 and built.levels >= 2
        assert built.tree.entry_instance.numpy().tolist() == [0]


def test_memory_that_is_not_there_is_reported(monkeypatch):
    monkeypatch.setattr("raybatch_addon.core.bvh.pages.build.free_memory", lambda device: 1000)
    with pytest.raises(OutOfMemoryError, match="use DISK"):
        paged("boxes", 600_000)


@pytest.mark.parametrize("nodes_resident", [False, True])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("rule", [CutRule(), MANY], ids=["one", "many"])
@pytest.mark.parametrize("kind", each_of(2, ["quantised", "device"]))
def test_packed_pages_are_the_same_on_the_device(kind, rule, store, nodes_resident, tmp_path):
    plain = paged(kind, 500_000, nodes_resident=nodes_resident, rule=rule)
    for reused in (False, True) if store == "DISK" else (False,):
        packed = paged(kind, 500_000, store, nodes_resident=nodes_resident, rule=rule, encoded=True, folder=tmp_path)
        assert (
            packed.encoded and packed.statistics["reused"] == reused and packed.page_bytes_max == plain.page_bytes_max
        )
        assert [page.device_bytes for page in packed.pages] == [page.device_bytes for page in plain.pages]
        for a, b in zip(paged_scenes.page_bytes(packed), paged_scenes.page_bytes(plain), strict=True):
            assert np.array_equal(a, b)
        assert (
            np.array_equal(packed.treelet_triangle_byte, plain.treelet_triangle_byte) and packed.plain_view(0) is None
        )
    if store == "HOST":
        kept = paged(kind, 500_000, nodes_resident=nodes_resident, rule=rule, encoded=True, plain=True)
        for number, page in enumerate(plain.pages):
            assert np.array_equal(kept.plain_view(number).numpy(), plain.store.view(page).numpy())
        assert np.array_equal(packed.resident_nodes.numpy(), plain.resident_nodes.numpy())
        assert packed.statistics["stored_bytes"] < 0.6 * plain.statistics["stored_bytes"]


def test_boxes_are_not_packed():
    with pytest.raises(ValueError, match="QUANTISED"):
        paged("boxes", 500_000, encoded=True)
