"""Volumes that stand on surfaces: rays that leave them there meet the surface, however coordinates are rounded."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import color, filled, in_box, medium
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

_SHEET = Material("clear", (Closure(ClosureKind.TRANSPARENT, (1.0, 1.0, 1.0)),), (ClosureKind.TRANSPARENT,))
# height of the floor [m], and how far all is turned around an axis that is none of the world's [rad]
PLACES = {
    "at the origin": (0.0, 0.0),
    "above it": (1.37, 0.0),
    "below it": (-0.731, 0.0),
    "turned": (2.9, 0.7),
    "far off": (321.7, 1.1),
}


def turned(angle: float, height: float) -> np.ndarray:
    """A turn by `angle` around (1, 2, 2) / 3 of all that was raised by `height`, float64, shape [3, 4]."""
    x, y, z = np.array([1, 2, 2]) / 3
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return np.column_stack([rotation, rotation @ (0, 0, height)])


def standing(volume, place: str, world=1.0, up=0.0, side=1, floor=30.0) -> Scene:
    """A cube of `volume` on a black floor that it meets at its own face, and what a camera sees of that face from
    above or, with a `side` of -1, from below. `up`: of a sun below the floor, which is `floor` m wide.
    """
    height, angle = PLACES[place]
    there = turned(angle, height)

    def at(*point) -> np.ndarray:
        return there[:, :3] @ np.asarray(point, np.float64) + there[:, 3]

    stretched = np.column_stack([there[:, :3] * 0.7, at(0.1, -0.2, 0.7)]).astype(np.float32)
    wide = np.column_stack([there[:, :3] * (floor / 2, floor / 2, 1.0), at(0.3, 0.1, 0.0)]).astype(np.float32)
    things = [(scenes.box(), stretched, filled(volume)), (scenes.plane(), wide, scenes.diffuse(0.0))]
    view = scenes.camera(eye=at(0.4, -4.1, 3.3 * side), target=at(0.1, -0.2, 0.0), half_width=0.04)
    made = scenes.scene(things, world=world, frame=Frame(24, 24), view=view)
    upwards = np.column_stack([there[:, :3] @ np.diag([1.0, -1.0, -1.0]), at(0, 0, -5)]).astype(np.float32)
    lights = (scenes.sun(up, matrix=upwards), *in_box(medium(1.0)).lights[1:])
    return dataclasses.replace(made, lights=lights)


def in_volume(scene: Scene, side: int) -> float:
    """How long the ray in the middle is in the volume [m], between its side and the face on the floor."""
    eye = np.array([0.4, -4.1, 3.3 * side]) - (0.1, -0.2, 0.0)
    return 0.7 * np.linalg.norm(eye) / -eye[1]


def rendered(session, scene: Scene) -> np.ndarray:
    return color(session.render(scene, RenderSettings(sample_count=4, bounce_max=4)))


@pytest.mark.parametrize("side", [1, -1], ids=["from above", "from below"])
@pytest.mark.parametrize("place", PLACES)
def test_the_floor_is_seen_through_the_volume(session, place, side):
    """A black floor: light comes from where rays have missed it."""
    found = rendered(session, standing(medium(absorption=0.2), place, side=side))
    np.testing.assert_array_equal(found, 0.0)


@pytest.mark.parametrize("place", PLACES)
def test_no_light_comes_into_the_volume_through_the_floor(session, place):
    lit = standing(medium(scattering=0.4), place, world=0.0, up=3.0)
    np.testing.assert_array_equal(rendered(session, lit), 0.0)
    clear = dataclasses.replace(lit, materials=(lit.materials[0], _SHEET))
    assert rendered(session, clear).mean() > 0.01  # the sun is there


@pytest.mark.parametrize("floor", [3.0, 30.0, 200.0])
@pytest.mark.parametrize("side", [1, -1], ids=["from above", "from below"])
def test_rays_leave_the_volume_behind_a_sheet_that_lets_them_through(session, floor, side):
    """However large the sheet is, and so the error of points there."""
    made = standing(medium(absorption=0.5), "turned", side=side, floor=floor)
    through = dataclasses.replace(made, materials=(made.materials[0], _SHEET))
    expected = np.exp(-0.5 * in_volume(made, side))
    np.testing.assert_allclose(rendered(session, through)[11:13, 11:13].mean((0, 1)), expected, rtol=3e-3)


def test_a_volume_on_a_floor_keeps_its_height(session):
    """What is absorbed above a floor that shines is by Beer's law."""
    made = standing(medium(absorption=0.5), "above it", world=0.0)
    shining = dataclasses.replace(made, materials=(made.materials[0], scenes.emitter(2.0)))
    found = rendered(session, shining)
    middle = found[11:13, 11:13].mean((0, 1))
    np.testing.assert_allclose(middle, 2.0 * np.exp(-0.5 * in_volume(made, 1)), rtol=3e-3)
