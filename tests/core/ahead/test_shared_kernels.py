"""Kernels that tests share give the films of specialised ones, bit for bit."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.scene.description import Closure, ClosureKind
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tier import general_features
from tests.support import scenes
from tests.support.feature_scenes import FEATURES
from tests.support.running.general_kernels import choose_general, independent_features
from tests.support.running.unweighed_kernels import unweighed_features
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
SETTINGS = RenderSettings(sample_count=4, bounce_max=5, roulette_bounce=2)


@pytest.mark.parametrize("sequence", ["SOBOL", "INDEPENDENT"])
def test_the_film_is_that_of_specialised_kernels(general_kernels, sequence):
    settings = SETTINGS.replace(sample_sequence=sequence)
    shared = Session(DEVICE).render(scenes.mixed(), settings)
    specialised = Session(DEVICE).render(scenes.mixed(), settings.replace(kernel_tier="SPECIALISED"))
    assert np.array_equal(shared.passes["Combined"], specialised.passes["Combined"])
    assert specialised.passes["Combined"][..., :3].std() > 0 and shared.statistics["warnings"] == []


def lit():
    """A metal ball on a floor, under a sun and a glowing square."""
    metal = scenes.material(Closure(ClosureKind.METAL, (0.9,) * 3, roughness=0.3))
    objects = [
        (scenes.plane(size=6), scenes.translation(0, 0, -1), scenes.diffuse()),
        (scenes.sphere(segments=16, rings=8), scenes.IDENTITY, metal),
        (scenes.plane("lamp", 0.8), scenes.translation(0.9, 0, 2), scenes.emitter(5.0)),
    ]
    return scenes.scene(objects, lights=[scenes.sun(1.0, 0.2)], world=0.1)


@pytest.mark.thorough  # kernels of its own
@pytest.mark.parametrize("nee", ["ON", "HALF"])
@pytest.mark.parametrize("sequence", ["SOBOL", "INDEPENDENT"])
def test_so_it_is_where_light_is_not_weighed(general_kernels, sequence, nee):
    settings = SETTINGS.replace(sample_sequence=sequence, mis="OFF", nee=nee)
    shared = Session(DEVICE).render(lit(), settings)
    specialised = Session(DEVICE).render(lit(), settings.replace(kernel_tier="SPECIALISED"))
    assert shared.statistics["modules"] != specialised.statistics["modules"]
    assert np.array_equal(shared.passes["Combined"], specialised.passes["Combined"])
    assert specialised.passes["Combined"][..., :3].std() > 0


def test_what_they_cannot_do_is_left_to_specialised_ones():
    device = wp.get_device(DEVICE)

    def shading(changes, scene=None, setting="AUTO"):
        features = derive_features(scene or scenes.mixed(), SETTINGS.replace(**changes))
        choice = choose_general(features, setting, device)
        assert choice.complaint == ""
        return "its own" if choice.shading == features else choice.shading

    independent = dict(sample_sequence="INDEPENDENT")
    assert shading({}) == general_features(device) and shading(independent) == independent_features()
    assert shading(dict(mis="OFF")) == shading(independent | dict(mis="OFF")) == "its own"
    for sequence in ("SOBOL", "INDEPENDENT"):
        assert shading(dict(mis="OFF", sample_sequence=sequence), lit()) == unweighed_features(sequence)
    assert shading(dict(mis="OFF", caustics_reflective="OFF"), lit()) == "its own"
    assert shading(independent, FEATURES["lamp program"][0]) == "its own"
    assert shading({}, setting="SPECIALISED") == shading(independent, setting="SPECIALISED") == "its own"
