"""Light that is scattered many times: plane layers and a half space whose albedo is known to ten digits."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame, Scene, Volume
from tests.renders.volumes.test_volumes import filled, medium, picture, varying
from tests.support import scenes
from tests.support.running.shares import each_of, pairs_of
from tests.twins.slabs import h_function, layer

pytestmark = pytest.mark.usefixtures("general_kernels")

ALBEDOS = np.array([0.3, 0.9, 0.99])
# How many times as wide as thick layers are: light hardly leaves by the sides. Rays begin up to 25 roundings of the
# longest edge beyond a face, which must be a small part of a free path
WIDE = 100.0
# So deep that nothing comes through, and free paths so short that the sides of a cube are far off
DEEP = medium(100 * (1 - ALBEDOS), 100 * ALBEDOS)
LONG = dict(bounce_max=100_000, sample_count=64)
WIDTH = 64  # pixels, which all see the same


def slab(volume: Volume, cosine: float, lit_from: int = 1, wide: float = 1.0) -> Scene:
    """A layer from z = -1 to 1, `wide` times as wide, seen from above at `cosine` to its normal, in a white world of
    which a black plane leaves the half above it (`lit_from` 1) or below (-1).
    """
    stretched = np.diag([wide, wide, 1.0, 1.0])[:3].astype(np.float32)
    eye = 4.0 * np.array([0.0, -np.sqrt(1 - cosine**2), cosine]) + (0, 0, 1)
    view = scenes.camera(eye=eye, target=(0, 0, 1), up=(0, 1, 0), half_width=1e-4)
    black = scenes.plane(size=20 * WIDE), scenes.translation(0, 0, -8.0 * lit_from), scenes.diffuse(0.0)
    made = scenes.scene([(scenes.box(), stretched, filled(volume)), black], world=1.0, view=view)
    return dataclasses.replace(made, lights=(scenes.sun(0.0), scenes.area_light(0.0)))


def assert_mean(session, scene: Scene, expected: np.ndarray, rows=6, **changes) -> None:
    """Rows of a picture have other random numbers, as pictures of other seeds have, but longest paths in common: these
    take most of the time.
    """
    scene = dataclasses.replace(scene, frame=Frame(WIDTH, rows))
    means = picture(session, scene, **LONG | changes).mean(1)
    error = means.std(0, ddof=1) / np.sqrt(rows)
    assert np.all(np.abs(means.mean(0) - expected) < 5 * error + 2e-6 * expected), (means.mean(0), expected, error)


@pytest.mark.parametrize("cosine", each_of(2, [0.2, 1.0]))
def test_the_albedo_of_a_half_space(session, cosine):
    """It gives back 1 - H(cosine) sqrt(1 - albedo) of the light of a white sky."""
    scene = slab(DEEP, cosine)
    expected = np.array([1 - h_function(each, np.array([cosine]))[0] * np.sqrt(1 - each) for each in ALBEDOS])
    assert_mean(session, scene, expected)


def test_a_half_space_in_the_sun(session, examples):
    """The sun stands above, and what comes back at a slant is a product of two values of H."""
    cosine, sun = 0.6, 2.0
    lit = slab(DEEP, cosine)
    scene = dataclasses.replace(lit, lights=(scenes.sun(sun), lit.lights[1]), world=scenes.scene().world)
    slant = np.array([np.prod(h_function(each, np.array([cosine, 1.0]))) for each in ALBEDOS])
    # of few rows the error is not known well enough: that of the least albedo is 6e-4 of the mean in six
    expected = sun * ALBEDOS / (4 * np.pi) / (cosine + 1) * slant
    assert_mean(session, scene, expected, rows=24, sample_count=examples(64))


@pytest.mark.parametrize(
    "make, depth", pairs_of({"fixed": medium, "program": varying}.items(), {"thin": 0.5, "thick": 4.0}.items())
)
def test_what_layers_give_back_and_let_through(session, make, depth):
    """Only the optical depth counts, also where a program makes the layer denser above."""
    volume = make(0.5 * depth * (1 - ALBEDOS), 0.5 * depth * ALBEDOS)
    expected = np.array([layer(each, depth, 0.7) for each in ALBEDOS])
    for lit_from, side in ((1, 0), (-1, 1)):
        assert_mean(session, slab(volume, 0.7, lit_from, WIDE), expected[:, side])
