"""scripts/direct_light.py: closed forms, and what it does not know."""

import math

import direct_light
import numpy as np
import pytest
from lib.command import UsageError

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Closure, ClosureKind, Material, Mesh
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.command_line import error_line, run_script

PIXEL, SAMPLES = (3, 4), 50


def lit(*objects, normals=None, world=0.0):
    """A floor of albedo 0.8 under a sun of 2 W/m² from above, seen from above."""
    plane = scenes.plane()
    floor = Mesh("floor", plane.positions, plane.triangles, corner_normals=normals)
    white = Material("white", (Closure(ClosureKind.DIFFUSE, (0.8,) * 3),), (ClosureKind.DIFFUSE,))
    view = scenes.camera(eye=(0.3, 0, 1), up=(0, 1, 0))
    return scenes.scene(
        [(floor, scenes.IDENTITY, white), *objects],
        view=view,
        frame=scenes.Frame(8, 8),
        lights=[scenes.sun(2.0)],
        world=world,
    )


def light(scene):
    """Means with either normal."""
    return [each.mean() for each in direct_light.pixel_light(scene, direct_light.Triangles.of(scene), PIXEL, SAMPLES)]


def test_a_floor_gets_the_light_of_sun_and_sky():
    assert light(lit()) == pytest.approx([0.8 * 2 / math.pi] * 2, rel=1e-6)
    assert light(lit(world=0.5)) == pytest.approx([0.8 * (2 / math.pi + 0.5)] * 2, rel=1e-6)


def test_what_is_behind_something_is_dark():
    roof = (scenes.plane("roof"), scenes.translation(0, 0, 2), scenes.diffuse())
    assert light(lit(roof)) == [0.0, 0.0]


def test_an_interpolated_normal_decides_unless_it_is_turned_away():
    def leaning(x, z):
        return np.tile(np.float32([x, 0, z]), (2, 3, 1))

    assert light(lit(normals=leaning(0.6, 0.8))) == pytest.approx([0.8 * 0.8 * 2 / math.pi] * 2, rel=1e-5)
    # the eye is at x = 0.3: this normal points away from it, and up nevertheless
    turned = light(lit(normals=leaning(-math.sqrt(1 - 0.1**2), 0.1)))
    assert turned == pytest.approx([0.8 * 0.1 * 2 / math.pi, 0.8 * 2 / math.pi], rel=1e-4)


def test_what_is_not_known_is_refused(tmp_path):
    lamp = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], lights=[scenes.area_light(1.0)])
    with pytest.raises(UsageError, match="matt surfaces"):
        direct_light.Triangles.of(lamp)
    save_scene(tmp_path / "lamp.scene.npz", lamp, RenderSettings())
    assert "matt surfaces" in error_line(
        run_script("direct_light.py", tmp_path / "lamp.scene.npz", "--size", "8x8", "--pixel", "1,1")
    )
    assert "there is no file" in error_line(
        run_script("direct_light.py", tmp_path / "none.scene.npz", "--size", "8x8", "--pixel", "1,1")
    )
    for wrong in ("1", "1,8", "8,1", "a,b", "1,-1"):
        with pytest.raises(UsageError, match="within 8 x 8 pixels"):
            direct_light.parse_pixel(wrong, lit())
    assert direct_light.parse_pixel("7,0", lit()) == (7, 0)
