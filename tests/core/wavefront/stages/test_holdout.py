"""Holes in the film's alpha."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

K = ClosureKind


def hole(share, *others):
    """A material that is a hole by `share`, and something else besides."""
    return scenes.material(Closure(K.HOLDOUT, (share,) * 3), *others, name="hole")


def alpha_of(session, *objects, samples=64):
    """Mean alpha, and the mean radiance, of a picture that squares fill, one behind the other."""
    placed = [(scenes.plane(f"square {i}", 20.0), scenes.translation(0, 0, -i), each) for i, each in enumerate(objects)]
    scene = scenes.scene(
        placed, view=scenes.camera(eye=(0, 0, 4), up=(0, 1, 0)), frame=Frame(16, 16, transparent=True), world=1.0
    )
    film = session.render(scene, RenderSettings(sample_count=samples, bounce_max=2))
    assert film.statistics["invalid_samples"] == 0
    combined = film.passes["Combined"]
    return combined[..., 3].mean(), combined[..., :3].mean()


def test_a_hole_is_black_and_has_no_alpha(session):
    assert alpha_of(session, hole(1.0), samples=4) == (0, 0)


def test_a_hole_in_part_keeps_the_rest(session):
    alpha, light = alpha_of(session, hole(0.25, Closure(K.DIFFUSE, (0.75,) * 3)), samples=4)
    assert alpha == 0.75 and light == pytest.approx(0.75, rel=0.02)


def test_a_hole_behind_a_veil_counts_as_far_as_it_is_seen(session):
    veil = scenes.material(Closure(K.TRANSPARENT, (0.5,) * 3), name="veil")
    alpha, light = alpha_of(session, veil, hole(1.0))
    np.testing.assert_allclose((alpha, light), (0.5, 0), rtol=0.03)
