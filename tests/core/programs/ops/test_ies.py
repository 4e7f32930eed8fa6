"""Lookups in photometric profiles."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.inputs.ies import WITHOUT_PROFILE, profile_intensity
from raybatch_addon.core.shading.lights.ies_profile import LightProfile
from tests.support.under_test import DEVICE


@functools.cache
def kernel():
    @wp.kernel(**KERNEL_OPTIONS)
    def look(
        table: wp.array(dtype=float),
        first: int,
        h: int,
        v: int,
        direction: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=float),
    ):
        i = wp.tid()
        out[i] = profile_intensity(table, first, h, v, direction[i])

    return look


def intensities(profile: LightProfile | None, directions) -> np.ndarray:
    """Intensities in directions [n, 3]; the table follows a constant that is none of its own."""
    directions = np.asarray(directions, np.float32).reshape(-1, 3)
    table = np.append(np.float32(np.nan), profile.table if profile else np.float32(0))
    h, v = profile.intensity.shape if profile else (0, 0)
    out = wp.zeros(len(directions), dtype=float, device=DEVICE)
    inputs = [
        wp.array(table, dtype=float, device=DEVICE),
        1,
        h,
        v,
        wp.array(directions, dtype=wp.vec3, device=DEVICE),
        out,
    ]
    wp.launch(kernel(), len(directions), inputs, device=DEVICE)
    return out.numpy()


def profile(horizontal, vertical, intensity) -> LightProfile:
    """A profile with angles in degrees."""
    to_radians = np.float32(np.pi) / np.float32(180)
    return LightProfile(np.float32(horizontal) * to_radians, np.float32(vertical) * to_radians, np.float32(intensity))


def towards(horizontal, vertical) -> np.ndarray:
    """The node's input vector for light at these angles [degrees]: the direction back to the lamp."""
    h, v = np.radians(np.asarray(horizontal, float)) - np.pi, np.radians(np.asarray(vertical, float))
    return np.stack([np.sin(v) * np.sin(h), np.sin(v) * np.cos(h), -np.cos(v)], -1)


HORIZONTAL, VERTICAL = np.arange(0, 361, 30), np.arange(0, 181, 10)


def test_entries_of_the_table_are_met():
    values = np.random.default_rng(2).uniform(1, 2, (13, 19))
    values[-1] = values[0]
    h, v = np.meshgrid(HORIZONTAL[1:-1], VERTICAL[1:-1], indexing="ij")
    found = intensities(profile(HORIZONTAL, VERTICAL, values), towards(h, v))
    assert found == pytest.approx(values[1:-1, 1:-1].ravel(), rel=1e-4)


def test_straight_lines_stay_straight_between_entries():
    values = 1 + 0.01 * HORIZONTAL[:, None] + 0.002 * VERTICAL[None]
    random = np.random.default_rng(3)
    h, v = random.uniform(31, 299, 500), random.uniform(11, 169, 500)
    found = intensities(profile(HORIZONTAL, VERTICAL, values), towards(h, v))
    assert found == pytest.approx(1 + 0.01 * h + 0.002 * v, rel=1e-4)


def test_a_curve_between_four_entries():
    values = np.zeros((13, 19))
    values[:, 9] = 1.0  # at 90 degrees
    found = intensities(profile(HORIZONTAL, VERTICAL, values), towards([45] * 4, [85, 95, 75, 105]))
    # Catmull and Rom half way: (9 - 1) / 16 ..., and 0 where that is negative
    assert found == pytest.approx([0.5625, 0.5625, 0, 0], abs=1e-4)


def test_beyond_its_angles_there_is_no_light():
    half = profile([0, 360], [0, 45, 90], [[2, 2, 2], [2, 2, 2]])
    assert intensities(half, towards([10, 10, 200, 200], [30, 91, 89, 150])).tolist() == [2, 0, 2, 0]
    part = profile([90, 180], [0, 180], [[2, 2], [2, 2]])
    assert intensities(part, towards([100, 10, 200], [30, 30, 30])).tolist() == [2, 0, 0]


@pytest.mark.parametrize("direction", ((0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 0), (0, 0, -np.inf)))
def test_what_is_no_direction_is_dark(direction):
    assert intensities(profile([0, 360], [0, 180], np.ones((2, 2))), direction).tolist() == [0]


def test_tiny_and_huge_vectors_are_directions():
    found = intensities(profile([0, 360], [0, 180], np.ones((2, 2))), [(0, 1e-15, -1e-15), (1e15, 1e15, 0)])
    assert found == pytest.approx([1, 1])


def test_without_profile_light_is_as_in_cycles():
    assert intensities(None, (0, 0, 1)).tolist() == [WITHOUT_PROFILE]


def test_known_directions_fold():
    table = profile([0, 360], [0, 90, 180], [[1, 2, 3], [1, 2, 3]])
    value = ProgramBuilder().value("ies", table.table, 2, 3, (0.3, -0.2, 0.0), 5.0)
    assert value.known and value.number() == pytest.approx(10, rel=1e-5)
