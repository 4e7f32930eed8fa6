"""Trees of which a part moved: the boxes above it are those of a refit of the whole, all others are left alone."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.collapse import collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary
from raybatch_addon.core.bvh.build.encode import as_vectors
from raybatch_addon.core.bvh.build.refit import refit_boxes
from raybatch_addon.core.bvh.build.refit_part import WholeBoxes, is_part, refit_part
from raybatch_addon.core.bvh.node import Layout
from tests.support.wide_trees import OPTIONS, check_whole, needles, refit_mesh, soup, sphere, wide


class Moving:
    """A tree that is refitted in part from position to position, from a refit of the whole on."""

    def __init__(self, mesh, positions, triangles):
        self.mesh = refit_mesh(mesh, positions, triangles)
        self.triangles = triangles
        vertices = (
            wp.array(each, dtype=dtype, device="cpu") for each, dtype in ((positions, wp.vec3), (triangles, wp.vec3i))
        )
        found = refit_boxes(as_vectors(self.mesh.nodes), as_vectors(self.mesh.triangles), *vertices)
        self.whole = WholeBoxes.of(found.boxes, found.costs, self.mesh.nodes, len(self.mesh.triangles))

    def to(self, positions, moved):
        mesh = self.mesh
        result = refit_part(mesh.nodes, mesh.triangles, mesh.centre, self.whole, moved, positions, self.triangles)
        if result is not None:
            self.mesh = replace(mesh, centre=result.centre, box=result.box, sah=result.sah)
        return result


def moved_in(positions, triangles, moved, rng, size=0.1):
    """`positions`, of which the vertices of the triangles `moved` are elsewhere, in the same box."""
    there = positions.copy()
    vertices = np.unique(np.concatenate([triangles[first : first + count].ravel() for first, count in moved]))
    inside = np.clip(there[vertices] + size * rng.normal(size=(len(vertices), 3)), positions.min(0), positions.max(0))
    corners = np.isin(there[vertices], [positions.min(0), positions.max(0)]).any(1)
    there[vertices] = np.where(corners[:, None], there[vertices], inside.astype(np.float32))
    return there


def assert_as_whole(mesh, expected):
    """Bit for bit, as the centre is where it was."""
    assert np.array_equal(mesh.centre, expected.centre) and np.array_equal(mesh.box, expected.box)
    assert np.array_equal(mesh.nodes.view(np.uint32), expected.nodes.view(np.uint32))
    assert np.array_equal(mesh.triangles.view(np.uint32), expected.triangles.view(np.uint32))
    assert mesh.sah == pytest.approx(expected.sah, rel=1e-9)


def test_a_part_that_moves_from_frame_to_frame_in_the_same_box_gives_the_tree_of_a_whole_refit():
    positions, triangles = soup(4000)
    mesh, rng = wide(positions, triangles, Layout.BOXES), np.random.default_rng(3)
    moving, there = Moving(mesh, positions, triangles), positions
    for moved in ([(100, 40)], [(100, 40)], [(0, 3), (3990, 10)], [(2000, 60)]):
        there = moved_in(there, triangles, moved, rng)
        before = moving.mesh.nodes.copy()
        assert moving.to(there, moved) is not None
        assert_as_whole(moving.mesh, refit_mesh(mesh, there, triangles))
        same = (before.view(np.uint32) == moving.mesh.nodes.view(np.uint32)).all(1)
        assert not same.all() and same.mean() > 0.3


def test_a_part_that_leaves_the_box_is_held_by_a_tree_with_its_old_centre():
    positions, triangles = sphere(40)
    mesh = wide(positions, triangles, Layout.BOXES)
    moving, there = Moving(mesh, positions, triangles), positions.copy()
    there[np.unique(triangles[500:520])] += np.float32([9, -3, 100])
    moving.to(there, [(500, 20)])
    assert np.array_equal(moving.mesh.centre, mesh.centre) and not np.array_equal(moving.mesh.box, mesh.box)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), scale=st.sampled_from([1.0, 1e-15, 1e15]), far=st.sampled_from([0.0, 1.0, 1e4]))
def test_boxes_hold_what_moved_anywhere(seed, scale, far):
    rng = np.random.default_rng(seed)
    positions, _ = soup(300)
    triangles = np.arange(900, dtype=np.int32).reshape(-1, 3)
    positions = (scale * rng.normal(size=(900, 3))).astype(np.float32)
    moving, there = Moving(wide(positions, triangles, Layout.BOXES), positions, triangles), positions.copy()
    for _ in range(2):
        first = int(rng.integers(0, 290))
        there = there.copy()
        there[3 * first : 3 * first + 30] += (scale * far * rng.normal(size=(30, 3))).astype(np.float32)
        if moving.to(there, [(first, 10)]) is not None:
            check_whole(moving.mesh, there, triangles)
            assert moving.mesh.sah == pytest.approx(refit_mesh(moving.mesh, there, triangles).sah, rel=1e-6)
        else:
            return


def test_a_tree_with_split_triangles_finds_all_that_list_one():
    positions, triangles = needles(2000)
    options = replace(OPTIONS[Layout.BOXES], spatial_splits=True, split_budget=1.0)
    mesh = collapse_mesh(build_binary(positions, triangles, options), positions, triangles, Layout.BOXES)
    assert mesh.reference_count > 1.05 * len(triangles)
    moving = Moving(mesh, positions, triangles)
    there = moved_in(positions, triangles, [(50, 20)], np.random.default_rng(1), 0.01)
    assert moving.to(there, [(50, 20)]) is not None
    assert_as_whole(moving.mesh, refit_mesh(mesh, there, triangles))


def test_where_much_moved_or_all_is_flat_the_whole_is_to_be_refitted():
    positions, triangles = soup(2000)
    moving = Moving(wide(positions, triangles, Layout.BOXES), positions, triangles)
    before = moving.mesh.nodes.copy()
    assert not is_part([(0, 1000), (1000, 1000)], 2000) and is_part([(0, 100), (1000, 100)], 2000)
    assert moving.to(positions + np.float32(1), [(0, 2000)]) is None
    assert np.array_equal(moving.mesh.nodes.view(np.uint32), before.view(np.uint32))
