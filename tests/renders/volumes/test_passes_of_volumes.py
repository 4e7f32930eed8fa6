"""Passes of data and of a denoiser's guides where paths scatter in volumes, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.scene.description import CameraKind, Frame
from raybatch_addon.core.scene.passes import DEPTH_OF_NOTHING, GUIDE_PASSES
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import filled, medium, varying
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

_SIZE, _SAMPLES = 32, 64
# Of the cube, 2 m deep; of the varying one in the mean over its height
_ALBEDO, _EXTINCTION, _EMISSION = 0.75, 0.6, 0.2
_THROUGH = math.exp(-2 * _EXTINCTION)  # share of light
_FLOOR, _FLOOR_DEPTH, _CUBE_DEPTH = 0.3, 4.0, 1.0


def looking_down(volume, passes):
    """A cube of `volume` from above, in parallel, and below it a floor that leans by an eighth of a turn."""
    view = dataclasses.replace(scenes.camera(eye=(0, 0, 2), up=(0, 1, 0), half_width=0.5), kind=CameraKind.ORTHOGRAPHIC)
    leans = np.eye(4)[:3]
    leans[1:, 1:3] = np.array([[1, -1], [1, 1]]) / math.sqrt(2)
    leans[:, 3] = 0, 0, 2 - _FLOOR_DEPTH
    things = [(scenes.box(), scenes.IDENTITY, filled(volume)), (scenes.plane(size=9), leans, scenes.diffuse(_FLOOR))]
    frame = Frame(_SIZE, _SIZE, passes=("Combined", *passes))
    return scenes.scene(things, view=view, frame=frame, world=0.5, lights=[scenes.sun(1.0)])


def volumes():
    """The cube's volume, and the share of paths that pass it: of one that is the same everywhere that of light; where
    it varies, absorption dims paths instead, here as in Cycles.
    """
    scattering = _ALBEDO * _EXTINCTION
    made = [each(_EXTINCTION - scattering, scattering, _EMISSION) for each in (medium, varying)]
    passing = (_THROUGH, math.exp(-2 * scattering))
    return [pytest.param(*each, id=name) for *each, name in zip(made, passing, ("constant", "varying"), strict=True)]


@pytest.mark.parametrize(("volume", "passing"), volumes())
def test_first_samples_that_scatter_show_no_surface(session, volume, passing):
    """Depth is what Blender has for nothing, as in Cycles, where the first sample met no surface before it scattered;
    a film's depths do not depend on which samples are rendered together.
    """
    scene = looking_down(volume, ("Depth", "Position"))
    film = session.render(scene, RenderSettings(sample_count=2))
    depth, position = film.passes["Depth"][..., 0], film.passes["Position"]
    none = depth == DEPTH_OF_NOTHING
    assert 1 - none.mean() == pytest.approx(passing, abs=5 * math.sqrt(passing * (1 - passing)) / _SIZE)
    assert not position[none].any() and np.all(np.abs(depth[~none] - _FLOOR_DEPTH) < 0.6)
    assert depth[~none] == pytest.approx(2 - position[~none][:, 2], rel=1e-5)
    halves = [session.render(scene, RenderSettings(sample_count=1), sample_first=i) for i in range(2)]
    assert np.all(halves[1].passes["Depth"] == DEPTH_OF_NOTHING)
    for merged in (halves[0].merge(halves[1]), halves[1].merge(halves[0])):
        assert np.array_equal(merged.passes["Depth"][..., 0], depth)


@pytest.mark.parametrize(("volume", "passing"), volumes())
def test_guides_of_volumes_are_their_albedo_and_look_at_the_camera(session, volume, passing):
    """What scatters a path ends what it notes; emission that is seen counts as albedo."""
    scene = looking_down(volume, GUIDE_PASSES)
    passes = session.render(scene, RenderSettings(sample_count=_SAMPLES)).passes
    albedo, normal, depth = (passes[name].mean((0, 1), dtype=np.float64) for name in GUIDE_PASSES)
    error = 5 * math.sqrt(passing * (1 - passing)) / (_SIZE * math.sqrt(_SAMPLES))
    of_volume = (_ALBEDO + _EMISSION / _EXTINCTION) * (1 - _THROUGH)
    assert albedo == pytest.approx(of_volume + _FLOOR * passing, abs=error)
    slope = math.sqrt(0.5)
    assert normal == pytest.approx((0, -slope * passing, -slope * passing - (1 - passing)), abs=error)
    # the way to the volume counts, and behind it that of paths which pass
    assert depth == pytest.approx(_CUBE_DEPTH + (_FLOOR_DEPTH - _CUBE_DEPTH) * passing, abs=4 * error)
