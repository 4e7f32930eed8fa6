"""The tree over boxes of lights: a ray finds all that it enters, each once."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import Light, LightKind, Visibility
from raybatch_addon.core.shading.lights.met.boxes import BOXES_WIDE, BoxBlock, box_tree, light_of, next_met
from raybatch_addon.core.shading.lights.table import upload_lights
from tests.core.shading.lights.light_probe import facing, scene_of
from tests.support.under_test import BLOCK_DIM, DEVICE

RAYS = 300


@wp.kernel(**KERNEL_OPTIONS)
def find_all(
    tree: wp.array(dtype=BoxBlock),
    leaf_first: int,
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: float,
    met: wp.array2d(dtype=int),
):
    i = wp.tid()
    item = int(-1)
    before = int(-1)
    while True:
        item = next_met(tree, origin[i], direction[i], t_max, item)
        if item < 0:
            break
        light = light_of(tree, leaf_first, item)
        met[i, light] = met[i, light] + wp.where(item > before, 1, 1000)
        before = item


def found(low, high, origin, direction, t_max):
    tree, leaf_first = box_tree(low, high, np.arange(len(low)), wp.get_device(DEVICE))
    met = wp.zeros((len(origin), len(low)), dtype=int, device=DEVICE)
    rays = [wp.array(each.astype(np.float32), dtype=wp.vec3, device=DEVICE) for each in (origin, direction)]
    wp.launch(find_all, len(origin), [tree, leaf_first, *rays, t_max, met], device=DEVICE, block_dim=BLOCK_DIM)
    return met.numpy(), tree


@pytest.mark.parametrize("count", [3, BOXES_WIDE, BOXES_WIDE + 1, 700, BOXES_WIDE**3 + 5])
def test_a_ray_finds_every_box_that_it_enters_once(count):
    """Directions along axes and diagonals too; numbers that have no rounding."""
    rng = np.random.default_rng(count)
    middle, half = rng.integers(-8, 8, (count, 3)), rng.choice([2.0**-6, 0.5, 2.25], (count, 3))
    low, high = (middle - half).astype(np.float32), (middle + half).astype(np.float32)
    origin = rng.integers(-10, 10, (RAYS, 3)).astype(float)
    direction = rng.choice([-1.0, 0.0, 0.0, 1.0], (RAYS, 3))
    direction[(direction == 0).all(1)] = 1.0
    t_max = 9.5
    met, tree = found(low, high, origin, direction, t_max)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack([low, high])[:, None] - origin[:, None]) / direction[:, None]
    beside = (direction == 0)[:, None]
    within = (low <= origin[:, None]) & (origin[:, None] <= high)
    first = np.where(beside, np.where(within, -np.inf, np.inf), sides.min(0)).max(2)
    end = np.where(beside, np.where(within, np.inf, -np.inf), sides.max(0)).min(2)
    expected = (np.maximum(first, 0) <= end) & (np.maximum(first, 0) < t_max)
    assert expected.any() and not expected.all()
    np.testing.assert_array_equal(met, expected)
    # blocks are full but the last of each level
    levels = [count]
    while levels[-1] > BOXES_WIDE:
        levels.append(-(-levels[-1] // BOXES_WIDE))
    assert tree.size == sum(-(-level // BOXES_WIDE) for level in levels)


def test_the_table_says_which_rays_meet_any_light():
    def lamp(radius, visibility):
        return Light(
            "lamp", LightKind.POINT, facing((0, 0, 1), (0, 0, -1)), (1,) * 3, radius=radius, visibility=visibility
        )

    lamps = [lamp(0.1, int(Visibility.DIFFUSE)), lamp(0.2, int(Visibility.GLOSSY)), lamp(0.0, int(Visibility.ALL))]
    table = upload_lights(scene_of(*lamps), wp.get_device(DEVICE)).table
    assert table.tree_visibility == Visibility.DIFFUSE | Visibility.GLOSSY  # no ray meets a point
    assert upload_lights(scene_of(lamps[2]), wp.get_device(DEVICE)).table.tree_visibility == 0
