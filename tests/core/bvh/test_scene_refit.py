"""The trees of a scene follow what moves from frame to frame, and give the films of trees that are built anew."""

import gc
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scenes
import warp as wp
import wide_trees
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from under_test import DEVICE

from raybatch_addon.core.bvh.build_cuda import build_mesh
from raybatch_addon.core.bvh.node import Layout, WideMesh, aligned_empty, triangle_faces
from raybatch_addon.core.bvh.refit import NodeLevels, refit_quantised
from raybatch_addon.core.device import find_device
from raybatch_addon.core.scene.description import Frame, Mesh, Visibility
from raybatch_addon.core.scene.features import needs_instancing
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.wavefront import geometry_cache
from raybatch_addon.core.wavefront.geometry_cache import GeometryCache, GeometryRequest
from raybatch_addon.core.wavefront.plan import Method, TracingPlan

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=3, spatial_splits="OFF")
FRAME = Frame(20, 16, passes=("Combined", "Depth", "Normal", "Position"))
BALL, SMOOTH_BALL, FLOOR, CUBE = scenes.sphere(segments=16, rings=8), scenes.sphere("smooth", 16, 8, smooth=True), scenes.plane(size=8), scenes.box()
NOT_CAMERA = int(Visibility.ALL & ~Visibility.CAMERA)
STATM = Path("/proc/self/statm")
# What the resident memory may grow by over 150 frames [bytes]: the allocator's own unrest; a tree kept from every frame takes ten
# times this
MEMORY_TOLERANCE = 12 * 2**20

layouts = pytest.mark.parametrize("layout", list(Layout) if DEVICE == "cpu" else [Layout.QUANTISED])


def waved(mesh: Mesh, time: float) -> Mesh:
    """`mesh` with a wave through it, normals and all."""
    x, y, z = mesh.positions.T
    positions = np.stack([x + 0.1 * np.sin(5 * y + time), y, z * (1 + 0.2 * np.sin(4 * x + 3 * time))], 1).astype(np.float32)
    normals = mesh.corner_normals
    if normals is not None:
        normals = normals + 0.05 * np.sin(time)
        normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    return replace(mesh, positions=positions, corner_normals=normals)


def turned(angle: float, *place, scale=0.6) -> np.ndarray:
    """A matrix that turns about z."""
    matrix = scenes.translation(*place, scale)
    c, s = np.cos(angle), np.sin(angle)
    matrix[:, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return matrix


def several(time: float):
    """A waving mesh and one that moves, both baked; a mesh placed twice that moves, one that waves, one that stands still."""
    colours = [scenes.diffuse((0.8, 0.3, 0.2)), scenes.diffuse((0.2, 0.7, 0.4)), scenes.diffuse(0.6)]
    shared = waved(BALL, time)
    return scenes.scene(
        [
            (FLOOR, scenes.translation(0, 0, -1), colours[2]),
            (waved(SMOOTH_BALL, time), turned(0.3, -1.2, 0, 0), colours[0]),
            (scenes.plane("moving", 1.0), turned(time, 0.3 * time, 1, 0.4, scale=1.0), colours[1]),
            (scenes.plane("hidden", 1.5), scenes.translation(0, -2.5, 0.2 + 0.1 * time), scenes.emitter(2.0), NOT_CAMERA),
            (CUBE, turned(time, 1.2, 0.2 * time, 0, scale=0.3), colours[1]),
            (CUBE, turned(-time, 0.4, -1, 0.1 * time, scale=0.2), colours[0]),
            (shared, turned(0, -0.2, 1.5, 0.5, scale=0.4), colours[0]),
            (shared, turned(0, 1.8, 1.0, 0.3, scale=0.4), colours[1]),
        ],
        view=scenes.camera(eye=(0.2, -6, 1.5), half_width=0.5), frame=FRAME, lights=[scenes.area_light(3.0)], world=0.3,
    )  # fmt: skip


def single(time: float):
    """All in one tree."""
    return scenes.scene(
        [
            (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse(0.6)),
            (waved(BALL, time), turned(time, 0.2 * time, 0, 0, scale=0.8), scenes.diffuse((0.8, 0.3, 0.2))),
        ],
        view=scenes.camera(eye=(0.2, -6, 1.5), half_width=0.5), frame=FRAME, world=0.5,
    )  # fmt: skip


def opened(layout: Layout) -> Session:
    session = Session(DEVICE, SETTINGS)
    session.layout = layout
    return session


def assert_same(film, expected):
    assert film.passes.keys() == expected.passes.keys()
    for name, values in expected.passes.items():
        assert np.array_equal(film.passes[name], values), name


def counts(statistics) -> tuple[int, int]:
    return statistics["built"], statistics["refitted"]


def followed(cache: GeometryCache, scene, layout=Layout.QUANTISED, settings=SETTINGS):
    plan = TracingPlan(Method.REFERENCE if settings.batching == "REFERENCE" else Method.UNBATCHED)
    request = GeometryRequest(settings, plan, layout, needs_instancing(scene), Path("unused"))
    return cache.get(scene, request, find_device(DEVICE)).built


@layouts
@pytest.mark.parametrize(("scene_at", "trees", "moving"), [(several, 4, 3), (single, 1, 1)])
def test_films_are_those_of_trees_built_anew(layout, scene_at, trees, moving):
    session = opened(layout)
    for number, time in enumerate((0.0, 0.1, 0.4, 1.3)):
        film = session.render(scene_at(time))
        assert counts(film.statistics["tree"]) == ((trees, 0) if number == 0 else (0, moving))
        assert film.passes["Combined"][..., :3].std() > 0.02 and film.statistics["invalid_samples"] == 0
        assert_same(film, opened(layout).render(scene_at(time)))
    again = session.render(scene_at(1.3))
    assert counts(again.statistics["tree"]) == (0, 0)
    assert_same(again, film)


@layouts
def test_refitted_trees_hold_what_moved(layout):
    cache = GeometryCache()
    followed(cache, several(0.0), layout)
    for time in (0.2, 0.9):
        built = followed(cache, several(time), layout)
        flat = flatten(several(time))
        for mesh in built.meshes:
            nodes = mesh.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)
            blocks = mesh.triangles.numpy().reshape(-1, layout.triangle_words)
            first, count = mesh.part.triangle_first, mesh.part.triangle_count
            references = int((triangle_faces(layout, np.ascontiguousarray(blocks)) >= 0).sum())
            leaves = wide_trees.walk_tree(layout, nodes).leaf_node
            assert layout is Layout.QUANTISED or (mesh.nodes.ptr | mesh.triangles.ptr) % 64 == 0
            nodes, blocks = (aligned(array) for array in (nodes, blocks))  # as those that were built alone
            wide = WideMesh(layout, nodes, mesh.centre, mesh.box, mesh.depth, len(leaves), references, mesh.sah, blocks, count)
            wide_trees.check_whole(wide, flat.positions, flat.triangles[first : first + count])


def aligned(array: np.ndarray) -> np.ndarray:
    copy = aligned_empty(array.shape, array.dtype.type)
    copy[:] = array
    return copy


def test_a_tree_that_a_device_built_follows():
    """Its nodes lie level by level, in the order of its refits."""
    positions, triangles = wide_trees.soup(700)
    moved = (positions + 0.05 * np.sin(20 * positions)).astype(np.float32)

    def upload(values, dtype):
        return wp.array(values, dtype=dtype, device=DEVICE)

    made = build_mesh(upload(positions, wp.vec3), upload(triangles, wp.vec3i), 0, len(triangles))
    levels = NodeLevels(upload(np.arange(made.node_count, dtype=np.int32), int), made.level_first)
    same = refit_quantised(made.nodes, made.triangles, levels, upload(positions, wp.vec3), upload(triangles, wp.vec3i))
    assert same.sah == pytest.approx(made.sah, rel=1e-5), "costs before and after a refit can be compared"
    result = refit_quantised(made.nodes, made.triangles, levels, upload(moved, wp.vec3), upload(triangles, wp.vec3i))
    nodes = aligned(made.nodes.numpy().view(np.uint32).reshape(-1, 20))
    blocks = aligned(made.triangles.numpy().reshape(-1, 12))
    wide = WideMesh(Layout.QUANTISED, nodes, result.centre, result.box, made.depth, made.leaf_count, len(triangles), result.sah, blocks, len(triangles))
    wide_trees.check_whole(wide, moved, triangles)


@layouts
def test_what_stands_still_is_left_alone(layout):
    cache = GeometryCache()
    before = followed(cache, several(0.5), layout)
    nodes, centres = before.tree.nodes.numpy().copy(), before.tree.entry_centre.numpy().copy()
    places = before.tree.nodes.ptr, before.tree.triangles.ptr
    assert before.tree.top_entry.size == 6

    base = several(0.5)
    matrices = base.instances.transform.copy()
    matrices[4, 0, 3] += 0.5  # of a cube
    moved = replace(base, instances=replace(base.instances, transform=matrices))
    after = followed(cache, moved, layout)
    assert after is before and counts(after.statistics) == (0, 0) and (after.tree.nodes.ptr, after.tree.triangles.ptr) == places
    top = after.tree.top_node * layout.node_words // 4
    assert np.array_equal(after.tree.nodes.numpy()[:top].view(np.uint32), nodes[:top].view(np.uint32))
    assert not np.array_equal(after.tree.nodes.numpy()[top:].view(np.uint32), nodes[top:].view(np.uint32))
    assert np.array_equal(after.tree.entry_centre.numpy(), centres)

    normals = followed(cache, replace(moved, meshes=tuple(replace(mesh, corner_normals=None) for mesh in moved.meshes)), layout)
    assert normals is before and counts(normals.statistics) == (0, 0)


def test_normals_and_slots_of_a_kept_tree_are_the_new_ones():
    """They are not in the tree; it stays, shading sees the change."""
    session = Session(DEVICE, SETTINGS)
    base = several(0.5)
    session.render(base)
    flat = replace(base, meshes=tuple(replace(mesh, corner_normals=None) for mesh in base.meshes))
    slots = replace(flat, slot_materials=np.roll(flat.slot_materials, 1), frame=replace(FRAME, transparent=True))
    for changed in (flat, slots, base):
        film = session.render(changed)
        assert counts(film.statistics["tree"]) == (0, 0)
        assert_same(film, Session(DEVICE, SETTINGS).render(changed))


def with_object(scene, index, **changes):
    instances = {name: getattr(scene.instances, name).copy() for name in changes}
    for name, value in changes.items():
        instances[name][index] = value
    return replace(scene, instances=replace(scene.instances, **instances))


def without_last_object(scene):
    return replace(scene, instances=replace(scene.instances, **{k: v[:-1] for k, v in vars(scene.instances).items() if v is not None}))


def without_last_triangle(scene):
    mesh = scene.meshes[1]
    return replace(scene, meshes=(scene.meshes[0], replace(mesh, triangles=mesh.triangles[:-1], corner_normals=None), *scene.meshes[2:]))


def with_other_triangles(scene):
    mesh = scene.meshes[0]
    return replace(scene, meshes=(replace(mesh, triangles=mesh.triangles[::-1].copy()), *scene.meshes[1:]))


@pytest.mark.parametrize(
    "change",
    [
        without_last_triangle,
        with_other_triangles,
        lambda scene: with_object(scene, 2, visibility=NOT_CAMERA),
        lambda scene: with_object(scene, 6, visibility=NOT_CAMERA),
        lambda scene: with_object(scene, 6, mesh=4),
        lambda scene: with_object(scene, 1, transform=turned(0.3, -1.2, 0, 0) * np.array([[-1], [1], [1]])),  # mirrored
        without_last_object,
    ],
    ids=["fewer triangles", "other triangles", "baked hidden", "instance hidden", "other mesh", "mirrored", "fewer instances"],
)
def test_another_topology_is_built_anew(change):
    session = Session(DEVICE, SETTINGS)
    session.render(several(0.5))
    film = session.render(change(several(0.5)))
    tree = film.statistics["tree"]
    assert counts(tree) == (tree["trees"], 0)
    assert_same(film, Session(DEVICE, SETTINGS).render(change(several(0.5))))


def test_other_settings_of_the_tree_build_it_anew():
    session = Session(DEVICE, SETTINGS)
    expected = session.render(several(0.5))
    splits = session.render(several(0.5), SETTINGS.replace(spatial_splits="ON"))
    assert counts(splits.statistics["tree"]) == (4, 0)
    assert_same(splits, expected)
    assert session.render(several(0.5), SETTINGS.replace(batching="REFERENCE")).statistics["tree"] is None
    film = session.render(several(0.5))
    assert counts(film.statistics["tree"]) == (4, 0)
    assert_same(film, expected)


def soup_scene(positions: np.ndarray, triangles: np.ndarray, copies: int = 1):
    mesh = Mesh("soup", positions, triangles)
    objects = [(mesh, scenes.translation(1.5 * i, 0, 0), scenes.diffuse(0.7)) for i in range(copies)]
    return scenes.scene([*objects, (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse(0.5))], frame=FRAME, world=0.5)


@layouts
@pytest.mark.parametrize("copies", [1, 2], ids=["baked", "instances"])
def test_a_tree_that_became_bad_is_built_anew(layout, copies):
    positions, triangles = wide_trees.soup(500)
    session = opened(layout)
    first = session.render(soup_scene(positions, triangles, copies)).statistics["tree"]
    assert first["sah"] == first["sah_built"] > 0
    shaken = (positions + 0.02 * np.sin(40 * positions)).astype(np.float32)
    tree = session.render(soup_scene(shaken, triangles, copies)).statistics["tree"]
    assert counts(tree) == (0, 1) and tree["sah_built"] == first["sah"] and tree["sah"] != first["sah"]
    mixed = positions[np.random.default_rng(0).permutation(len(positions) // 3)[triangles // 3] * 3 + np.arange(3)].reshape(-1, 3)
    film = session.render(soup_scene(mixed, triangles, copies))
    tree = film.statistics["tree"]
    assert counts(tree) == (1, 0) and tree["sah"] == tree["sah_built"] < 1.4 * first["sah"]
    assert_same(film, opened(layout).render(soup_scene(mixed, triangles, copies)))


def test_what_moves_is_built_without_splits_once_and_followed_from_then_on():
    positions, triangles = wide_trees.needles(500)
    session = opened(Layout.BOXES)
    session.settings = SETTINGS.replace(spatial_splits="AUTO")
    work = []
    for frame in range(4):
        moved = (positions + 0.002 * frame * np.sin(40 * positions)).astype(np.float32)
        film = session.render(soup_scene(moved, triangles))
        work.append(counts(film.statistics["tree"]))
        assert_same(film, opened(Layout.BOXES).render(soup_scene(moved, triangles)))
    assert work == [(1, 0), (1, 0), (0, 1), (0, 1)]


def test_split_triangles_are_split_anew():
    """What was split is worth it for its own positions only."""
    positions, triangles = wide_trees.needles(500)
    settings = SETTINGS.replace(spatial_splits="ON")
    session = Session(DEVICE, settings)
    scene = soup_scene(positions, triangles)
    first = session.render(scene).statistics["tree"]
    shaken = soup_scene((positions + 0.001 * np.sin(40 * positions)).astype(np.float32), triangles)
    film = session.render(shaken)
    tree = film.statistics["tree"]
    assert counts(tree) == (1, 0) and tree["sah"] == pytest.approx(first["sah"], rel=0.05)
    assert_same(film, Session(DEVICE, SETTINGS).render(shaken))
    assert counts(session.render(shaken).statistics["tree"]) == (0, 0)


@layouts
def test_a_top_level_that_outgrows_its_room_moves(layout):
    cache = GeometryCache()
    built = followed(cache, several(0.0), layout)
    triangles = built.tree.triangles.ptr
    built.top_room = 0
    moved = followed(cache, several(0.3), layout)
    assert moved is built and built.top_room > 0 and built.tree.triangles.ptr == triangles
    # all blocks are where the tree says
    for mesh, first in zip(built.meshes, np.cumsum([0, *(mesh.nodes.size for mesh in built.meshes)]), strict=False):
        assert mesh.nodes.ptr == built.tree.nodes.ptr + 16 * first
    session = opened(layout)
    session.render(several(0.0))
    session._geometry._last.built.top_room = 0
    assert_same(session.render(several(0.3)), opened(layout).render(several(0.3)))


def test_nothing_half_done_is_kept(monkeypatch):
    session = Session(DEVICE, SETTINGS)
    session.render(several(0.0))

    def fail(*_):
        raise RuntimeError("in the middle")

    with monkeypatch.context() as patch:
        patch.setattr(geometry_cache, "refit_scene_tree", fail)
        with pytest.raises(RuntimeError, match="in the middle"):
            session.render(several(0.1))
    film = session.render(several(0.1))
    assert counts(film.statistics["tree"]) == (4, 0)
    assert_same(film, Session(DEVICE, SETTINGS).render(several(0.1)))


@pytest.mark.skipif(not STATM.exists(), reason="the system does not tell the resident memory of a process")
@layouts
def test_memory_is_flat_over_two_hundred_refits(layout):
    mesh, cache = scenes.sphere(segments=120, rings=80), GeometryCache()

    def at(time):
        shared = waved(mesh, time)
        return scenes.scene(
            [
                (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse()),
                *((shared, turned(time, 2.0 * i, 0, 0), scenes.diffuse()) for i in range(3)),
            ]
        )  # fmt: skip

    places, resident = set(), {}
    for number in range(201):
        built = followed(cache, at(0.02 * number), layout)
        assert counts(built.statistics) == ((0, 1) if number else (2, 0))
        places.add((built.tree.nodes.ptr, built.tree.triangles.ptr))
        if number in (50, 200):
            gc.collect()
            resident[number] = int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    growth = resident[200] - resident[50]
    print(f"resident: {resident[50] / 2**20:.1f} MiB after 50 frames, {growth / 2**20:+.2f} MiB after 200; a tree has {built.statistics['bytes'] / 2**20:.1f}")
    assert len(places) == 1, "the tree stays where it is"
    assert growth < MEMORY_TOLERANCE


@layouts
@hypothesis_settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32), scale=st.sampled_from([1e-4, 1.0, 1e4]), spread=st.sampled_from([0.0, 0.05, 3.0]))
def test_any_motion_gives_the_film_of_trees_built_anew(layout, seed, scale, spread):
    rng = np.random.default_rng(seed)
    triangles = rng.integers(0, 40, (60, 3)).astype(np.int32)
    start = rng.normal(size=(40, 3)) * scale

    def at(moved):
        place = scenes.translation(*(moved * rng.normal(size=3) * scale))
        place[:, :3] += moved * 0.3 * rng.normal(size=(3, 3))
        mesh = Mesh("soup", (start + moved * spread * rng.normal(size=start.shape) * scale).astype(np.float32), triangles)
        view = scenes.camera(eye=(0, -6 * scale, 0), half_width=0.6)
        return scenes.scene(
            [(mesh, scenes.IDENTITY, scenes.diffuse(0.7)), (mesh, place, scenes.diffuse(0.4)), (BALL, scenes.translation(*place[:, 3], 0.3 * scale), scenes.diffuse(0.9))],
            view=view, frame=Frame(12, 12, passes=("Combined", "Depth")), world=0.5,
        )  # fmt: skip

    session = opened(layout)
    for moved in (0.0, 1.0, 1.0):
        scene = at(moved)
        film = session.render(scene)
        assert_same(film, opened(layout).render(scene))
    assert sum(counts(film.statistics["tree"])) <= 2
