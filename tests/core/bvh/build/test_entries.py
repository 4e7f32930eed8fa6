"""The top level's margin covers whatever instances do to the errors of rays and triangle tests."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.entries import Entries, map_condition
from raybatch_addon.core.bvh.build.top_level import build_top_level
from raybatch_addon.core.bvh.node import Layout
from tests.twins.watertight import intersect_float32


@pytest.mark.parametrize("squash", [1.0, 1e3, 1e4])
def test_hits_of_squashed_instances_lie_within_their_margined_boxes(squash):
    """A triangle that straddles the origin of its squashed axis is hit where its box, with the margin, has begun
    already.
    """
    rng = np.random.default_rng(4)
    to_world = np.array([np.diag([1.0, 1.0, 1.0 / squash]) @ np.eye(3, 4)] * 2)
    from_world = np.concatenate([np.linalg.inv(to_world[:, :, :3]), np.zeros((2, 3, 1))], 2)
    boxes = np.array([[[-1.0, -1, -1], [1, 1, 1]]] * 2)
    entries = made_entries(to_world, from_world)
    top = build_top_level(entries, [boxes], Layout.BOXES, wp.get_device("cpu"))
    growth = 2 * top.margin * (np.abs(boxes).max() + np.abs(boxes).max())  # of a box with these coordinates
    matrix = from_world[0].astype(np.float32)
    found = 0
    for _ in range(300):
        x = rng.uniform(0.1, 1)
        corners = np.array([[x + rng.normal() * 1e-5, *rng.uniform(-1, 1, 2)] for _ in range(3)])
        corners = (corners * [1, 1, squash]).astype(np.float32)
        count = 100
        origin = rng.uniform(-0.1, 0.1, (count, 3)).astype(np.float32)
        aim = (corners * np.float32([1, 1, 1 / squash])).mean(0) + rng.normal(size=(count, 3)) * [1e-3, 0.2, 0.2]
        direction = (aim - origin).astype(np.float32)
        o = (origin[:, None] * matrix[:, :3]).sum(2, dtype=np.float32)
        d = (direction[:, None] * matrix[:, :3]).sum(2, dtype=np.float32)
        world = corners.astype(np.float64) * [1, 1, 1 / squash]
        low, high = world.min(0) - growth, world.max(0) + growth
        hit, t, _, _ = intersect_float32(o, d, *corners)
        found += int(hit.sum())
        margin = top.margin * np.abs(origin[hit]).max(axis=1, keepdims=True)
        points = origin[hit].astype(np.float64) + t[hit, None].astype(np.float64) * direction[hit]
        assert (points >= low - margin).all() and (points <= high + margin).all()
    assert found > 1000


def made_entries(to_world: np.ndarray, from_world: np.ndarray) -> Entries:
    """Entries of which only the maps are asked for."""
    entries = Entries.__new__(Entries)
    object.__setattr__(entries, "mesh", np.zeros(len(to_world), np.int32))
    object.__setattr__(entries, "instance", np.arange(len(to_world), dtype=np.int32))
    object.__setattr__(entries, "transform", to_world)
    object.__setattr__(entries, "condition", map_condition(to_world, from_world))
    return entries
