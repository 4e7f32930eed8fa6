"""The trees of a scene follow what moves from frame to frame, and give the films of trees that are built anew."""

import gc
import os
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.cuda.build import build_mesh
from raybatch_addon.core.bvh.build.refit import NodeLevels, refit_quantised
from raybatch_addon.core.bvh.node import Layout, WideMesh, aligned_empty, triangle_faces
from raybatch_addon.core.scene.description import Frame, Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.session import Session
from raybatch_addon.core.wavefront.scene import scene_cache
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.core.bvh.build.refit_scenes import (
    BALL,
    FLOOR,
    FRAME,
    MEMORY_TOLERANCE,
    SETTINGS,
    STATM,
    assert_same,
    counts,
    followed,
    hairy,
    layouts,
    opened,
    several,
    single,
    turned,
    waved,
)
from tests.support import scenes, wide_trees
from tests.support.under_test import DEVICE
from tests.twins.tree_walk import walk_tree

pytestmark = pytest.mark.usefixtures("general_kernels")


@layouts
@pytest.mark.parametrize(("scene_at", "trees", "moving"), [(several, 4, 3), (single, 1, 1), (hairy, 2, 2)])
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
    cache = SceneCache()
    followed(cache, several(0.0), layout)
    for time in (0.2, 0.9):
        built = followed(cache, several(time), layout)
        flat = flatten(several(time))
        for mesh in built.meshes:
            nodes = mesh.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)
            blocks = mesh.triangles.numpy().reshape(-1, layout.triangle_words)
            first, count = mesh.part.triangle_first, mesh.part.triangle_count
            references = int((triangle_faces(layout, np.ascontiguousarray(blocks)) >= 0).sum())
            leaves = walk_tree(layout, nodes).leaf_node
            assert layout is Layout.QUANTISED or (mesh.nodes.ptr | mesh.triangles.ptr) % 64 == 0
            nodes, blocks = (aligned(array) for array in (nodes, blocks))  # as those that were built alone
            wide = WideMesh(
                layout=layout,
                nodes=nodes,
                centre=mesh.centre,
                box=mesh.box,
                depth=mesh.depth,
                leaf_count=len(leaves),
                reference_count=references,
                sah=mesh.sah,
                triangles=blocks,
                triangle_count=count,
            )
            wide_trees.check_whole(wide, flat.positions, flat.triangles[first : first + count])


def aligned(array: np.ndarray) -> np.ndarray:
    copy = aligned_empty(array.shape, array.dtype.type)
    copy[:] = array
    return copy


def test_a_tree_that_a_device_built_follows():
    """The tree's nodes lie level by level, in the order of its refits."""
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
    wide = WideMesh(
        layout=Layout.QUANTISED,
        nodes=nodes,
        centre=result.centre,
        box=result.box,
        depth=made.depth,
        leaf_count=made.leaf_count,
        reference_count=len(triangles),
        sah=result.sah,
        triangles=blocks,
        triangle_count=len(triangles),
    )
    wide_trees.check_whole(wide, moved, triangles)


@layouts
def test_what_stands_still_is_left_alone(layout):
    cache = SceneCache()
    before = followed(cache, several(0.5), layout)
    nodes, centres = before.tree.nodes.numpy().copy(), before.tree.entry_centre.numpy().copy()
    places = before.tree.nodes.ptr, before.tree.triangles.ptr
    assert before.tree.top_entry.size == 6

    base = several(0.5)
    matrices = base.instances.transform.copy()
    matrices[4, 0, 3] += 0.5  # of a cube
    moved = replace(base, instances=replace(base.instances, transform=matrices))
    after = followed(cache, moved, layout)
    assert (
        after is before
        and counts(after.statistics) == (0, 0)
        and (after.tree.nodes.ptr, after.tree.triangles.ptr) == places
    )
    top = after.tree.top_node * layout.node_words // 4
    assert np.array_equal(after.tree.nodes.numpy()[:top].view(np.uint32), nodes[:top].view(np.uint32))
    assert not np.array_equal(after.tree.nodes.numpy()[top:].view(np.uint32), nodes[top:].view(np.uint32))
    assert np.array_equal(after.tree.entry_centre.numpy(), centres)

    normals = followed(
        cache, replace(moved, meshes=tuple(replace(mesh, corner_normals=None) for mesh in moved.meshes)), layout
    )
    assert normals is before and counts(normals.statistics) == (0, 0)


def test_normals_and_slots_of_a_kept_tree_are_the_new_ones():
    """Normals and slots are not in the tree; it stays, shading sees the change."""
    session = Session(DEVICE, SETTINGS)
    base = several(0.5)
    session.render(base)
    flat = replace(base, meshes=tuple(replace(mesh, corner_normals=None) for mesh in base.meshes))
    slots = replace(flat, slot_materials=np.roll(flat.slot_materials, 1), frame=replace(FRAME, transparent=True))
    for changed in (flat, slots, base):
        film = session.render(changed)
        assert counts(film.statistics["tree"]) == (0, 0)
        assert_same(film, Session(DEVICE, SETTINGS).render(changed))


@layouts
def test_a_top_level_that_outgrows_its_room_moves(layout):
    cache = SceneCache()
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
    session._at[0].cache._last.built.top_room = 0
    assert_same(session.render(several(0.3)), opened(layout).render(several(0.3)))


def test_nothing_half_done_is_kept(monkeypatch):
    session = Session(DEVICE, SETTINGS)
    session.render(several(0.0))

    def fail(*_):
        raise RuntimeError("in the middle")

    with monkeypatch.context() as patch:
        patch.setattr(scene_cache, "refit_scene_tree", fail)
        with pytest.raises(RuntimeError, match="in the middle"):
            session.render(several(0.1))
    film = session.render(several(0.1))
    assert counts(film.statistics["tree"]) == (4, 0)
    assert_same(film, Session(DEVICE, SETTINGS).render(several(0.1)))


@pytest.mark.skipif(not STATM.exists(), reason="the system does not tell the resident memory of a process")
@layouts
def test_memory_is_flat_over_two_hundred_refits(layout):
    mesh, cache = scenes.sphere(segments=120, rings=80), SceneCache()

    def at(time):
        shared = waved(mesh, time)
        return scenes.scene(
            [
                (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse()),
                *((shared, turned(time, 2.0 * i, 0, 0), scenes.diffuse()) for i in range(3)),
            ]
        )

    places, resident = set(), {}
    for number in range(201):
        built = followed(cache, at(0.02 * number), layout)
        assert counts(built.statistics) == ((0, 1) if number else (2, 0))
        places.add((built.tree.nodes.ptr, built.tree.triangles.ptr))
        if number in (50, 200):
            gc.collect()
            resident[number] = int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    growth = resident[200] - resident[50]
    print(
        f"resident: {resident[50] / 2**20:.1f} MiB after 50 frames, {growth / 2**20:+.2f} MiB after 200; a tree has "
        f"{built.statistics['bytes'] / 2**20:.1f}"
    )
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
        mesh = Mesh(
            "soup", (start + moved * spread * rng.normal(size=start.shape) * scale).astype(np.float32), triangles
        )
        view = scenes.camera(eye=(0, -6 * scale, 0), half_width=0.6)
        return scenes.scene(
            [
                (mesh, scenes.IDENTITY, scenes.diffuse(0.7)),
                (mesh, place, scenes.diffuse(0.4)),
                (BALL, scenes.translation(*place[:, 3], 0.3 * scale), scenes.diffuse(0.9)),
            ],
            view=view,
            frame=Frame(12, 12, passes=("Combined", "Depth")),
            world=0.5,
        )

    session = opened(layout)
    for moved in (0.0, 1.0, 1.0):
        scene = at(moved)
        film = session.render(scene)
        assert_same(film, opened(layout).render(scene))
    assert sum(counts(film.statistics["tree"])) <= 2
