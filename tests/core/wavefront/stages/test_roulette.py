"""Which paths Russian roulette may end, and how often."""

import pytest

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")


@pytest.mark.parametrize("threshold, lives", [(0.5, 1.0), (0.6, 1.0), (0.8, 0.75), (1.0, 0.6)])
def test_paths_end_where_they_carry_less_than_the_threshold(threshold, lives):
    """In a closed box of reflectance 0.6 a path carries 0.6 after its first hit: it goes on with a probability of that
    over the threshold.
    """
    scene = scenes.scene(
        [(scenes.box(), scenes.IDENTITY, scenes.diffuse(0.6))],
        frame=Frame(32, 32),
        view=scenes.camera(eye=(0, -0.5, 0)),
    )
    settings = RenderSettings(sample_count=16, bounce_max=0, roulette_bounce=0, roulette_throughput=threshold)
    rays = Session(DEVICE).render(scene, settings).statistics["rays"]
    assert rays["camera"] == 32 * 32 * 16
    error = (lives * (1 - lives) / rays["camera"]) ** 0.5
    assert rays["bounce"] / rays["camera"] == pytest.approx(lives, abs=5 * error)
