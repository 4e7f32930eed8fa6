"""Volumes of which a small part of their box emits: cells are divided there, and closed forms hold."""

import math
from collections import Counter

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Frame, Mesh, Scene, Volume
from raybatch_addon.core.wavefront.volumes.emission.cells import FoundCells, find_cells
from raybatch_addon.core.wavefront.volumes.table import PART, VolumeData
from tests.renders.volumes.test_volume_lights import ALBEDO, NARROW, run_means
from tests.renders.volumes.test_volumes import filled, medium, picture
from tests.support import scenes, under_test

pytestmark = pytest.mark.usefixtures("general_kernels")

EMISSION = 100.0
ONCE = dict(bounce_max=0, sample_count=64)
CUBES, CUBE, SPAN = 12, 0.06, 6.0


def over_floor(mesh: Mesh, volume: Volume, height: float) -> Scene:
    floor = scenes.plane(size=40), scenes.IDENTITY, scenes.diffuse(ALBEDO)
    placed = mesh, scenes.translation(0, 0, height), filled(volume)
    return scenes.scene([floor, placed], view=NARROW, frame=Frame(16, 16))


def cube_middles() -> np.ndarray:
    return np.random.default_rng(1).uniform(-SPAN / 2, SPAN / 2, (CUBES, 3))


def joined() -> Mesh:
    """Small cubes far from one another, in one mesh."""
    cube = scenes.box("cube", CUBE)
    positions = np.concatenate([cube.positions + middle for middle in cube_middles()]).astype(np.float32)
    triangles = np.concatenate([cube.triangles + k * len(cube.positions) for k in range(CUBES)]).astype(np.int32)
    return Mesh("joined", positions, triangles)


def flame(radius: float) -> Volume:
    """By a program: a ball that emits in the middle of an object."""
    builder = ProgramBuilder()
    total = None
    for axis in builder.value("separate_xyz", builder.value("object_coordinates", 0)):
        square = builder.value("math", int(MathOperation.MULTIPLY), False, axis, axis, 0.0)
        total = square if total is None else builder.value("math", int(MathOperation.ADD), False, total, square, 0.0)
    lit = builder.value("math", int(MathOperation.LESS_THAN), False, total, radius**2, 0.0)
    light = builder.value("math", int(MathOperation.MULTIPLY), False, lit, EMISSION, 0.0)
    builder.closure("emission", builder.value("splat", light))
    return Volume(program=builder.finish())


def lit_floor(middles: np.ndarray, volume: float) -> float:
    """Radiance of the floor below small emitters at `middles` [m], of a `volume` [m³] each."""
    distance = np.linalg.norm(middles, axis=1)
    return ALBEDO / math.pi * EMISSION * volume * float((middles[:, 2] / distance**3).sum())


def assert_found(session, scene: Scene, expected: float, noise: float) -> None:
    means = run_means(session, scene, **ONCE)
    error = means.std(ddof=1) / math.sqrt(len(means))
    assert abs(means.mean() - expected) < 5 * error + 2e-3 * expected, (means, expected)
    seen = picture(session, scene, **ONCE)
    assert seen.var() < noise * seen.mean() ** 2, seen.var() / seen.mean() ** 2


def test_small_parts_of_one_mesh(session):
    """Points of undivided cells miss most of them: the variance would be 20 times the mean's square."""
    scene = over_floor(joined(), medium(emission=EMISSION), 3.6)
    assert_found(session, scene, lit_floor(cube_middles() + (0, 0, 3.6), CUBE**3), 1.0)


def test_a_small_flame_in_a_large_box(session):
    """The same."""
    scene = over_floor(scenes.box("box", 2.0), flame(0.05), 1.1)
    assert_found(session, scene, lit_floor(np.array([[0, 0, 1.1]]), 4 / 3 * math.pi * 0.05**3), 0.3)


def found_cells(scene: Scene) -> FoundCells:
    volumes = VolumeData()
    volumes.volume_count, volumes.world = 1, -1
    device = wp.get_device(under_test.DEVICE)
    found = find_cells(volumes, scene, np.zeros(len(scene.materials), np.int32), lambda asked, count: None, device)
    assert found is not None
    return found


@pytest.mark.parametrize("far", [0.0, 1e4])
def test_cells_are_no_narrower_than_float32_tells(far):
    """Points that were drawn in one and rounded into another one would count for both."""
    placed = joined(), scenes.translation(far, 0, 0), filled(medium(emission=EMISSION))
    halves = np.linalg.norm(found_cells(scenes.scene([placed])).cells.half, axis=2)
    assert 2 * halves.min() >= 64 * np.spacing(np.float32(far))
    assert (2 * halves.min() < SPAN / 16 / PART / 2) == (far == 0), "near the origin they are divided twice"


def test_cells_of_many_objects_are_found_together(monkeypatch):
    """All launches are those of one object, and one tree is built for the surface that they share."""
    cube, filling = scenes.box("cube", 0.1), filled(medium(emission=1.0))
    done = Counter()
    for name in ("launch", "Mesh"):
        made = getattr(wp, name)
        monkeypatch.setattr(wp, name, lambda *a, made=made, name=name, **k: done.update([name]) or made(*a, **k))
    counts = []
    for n in (1, 10000):
        done.clear()
        scene = scenes.scene([(cube, scenes.translation(k % 100, k // 100, 0), filling) for k in range(n)])
        assert np.array_equal(np.unique(found_cells(scene).cells.instance), np.arange(n))
        counts.append(dict(done))
    assert counts[0] == counts[1] and counts[0]["Mesh"] == 1
