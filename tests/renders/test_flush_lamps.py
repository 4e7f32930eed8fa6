"""Area lamps in the plane of a surface lie before it, however both are turned: not rounding decides what it hides."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame, LightKind
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

RNG = np.random.default_rng(11)


def turned(axis_count: int) -> np.ndarray:
    """A rotation: of no axis, or of all at random."""
    if axis_count == 0:
        return np.eye(3)
    q, r = np.linalg.qr(RNG.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


PLACES = [
    (turned(0), (5.0, 6.5, 7.4205)),
    (turned(3), (5.0, 6.5, 7.4205)),
    (turned(3), (-31.7, 0.3, 12.1)),
    (turned(3), (0.0, 0.0, 0.0)),
]


def room(place, ceiling=0.0, with_ceiling=True, **changes):
    """A floor 3 m under a lamp, and a black ceiling in the lamp's plane, or `ceiling` [m] above it."""
    rotation, centre = place

    def flat(name, size, height):
        mesh = scenes.plane(name, size)
        points = mesh.positions.astype(np.float64) + (0, 0, height)
        return replace(mesh, positions=(points @ rotation.T + centre).astype(np.float32))

    lamp = replace(scenes.area_light(30.0, 0.3, np.column_stack([rotation, centre]).astype(np.float32)), **changes)
    objects = [(flat("floor", 6.0, -3.0), scenes.IDENTITY, scenes.diffuse(0.8))]
    if with_ceiling:
        objects.append((flat("ceiling", 9.0, ceiling), scenes.IDENTITY, scenes.diffuse(0.0)))
    eye = rotation @ (0, 0, -1.0) + centre
    view = scenes.camera(eye=eye, target=rotation @ (0, 0, -3.0) + centre, up=rotation @ (0, 1, 0))
    return scenes.scene(objects, view=view, frame=Frame(16, 16), lights=[lamp])


def picture(session, scene, **settings):
    chosen = RenderSettings(device=DEVICE, sample_count=64, bounce_max=2, **settings)
    return session.render(scene, chosen).passes["Combined"]


@pytest.mark.parametrize("place", PLACES, ids=["level", "turned", "far", "centre"])
@pytest.mark.parametrize("nee", ["ON", "OFF"])
@pytest.mark.parametrize(
    "changes",
    [{}, {"kind": LightKind.ELLIPSE}, {"spread": 0.0}, {"spread": 1.5}],
    ids=["", "ellipse", "parallel", "spread"],
)
def test_a_lamp_that_is_flush_with_the_ceiling_gives_all_its_light(session, place, nee, changes):
    if nee == "OFF" and changes.get("spread") == 0.0:
        pytest.skip("rays do not meet it")
    expected = picture(session, room(place, with_ceiling=False, **changes), nee=nee)
    assert expected[..., :3].mean() > 0.02
    assert np.array_equal(picture(session, room(place, **changes), nee=nee), expected)


@pytest.mark.parametrize("place", PLACES, ids=["level", "turned", "far", "centre"])
@pytest.mark.parametrize("nee", ["ON", "OFF"])
def test_a_lamp_half_a_millimetre_above_the_ceiling_gives_none(session, place, nee):
    assert picture(session, room(place, -5e-4), nee=nee)[..., :3].max() == 0
