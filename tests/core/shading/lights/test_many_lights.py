"""Light of many emitters of all kinds in whole renders."""

import math

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame, Light, LightKind
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def test_all_ways_to_find_many_lights_agree(session):
    """20 lamps and 9 glowing plates, more than are compared one by one; a sun and the brightest lamp are hidden."""
    rng = np.random.default_rng(8)
    places = [(x, y, 0.8 + 0.4 * rng.random()) for x in (-1.5, -0.5, 0.5, 1.5) for y in (-1, -0.5, 0, 0.5, 1)]
    lamps = [
        Light(f"ball {i}", LightKind.POINT, scenes.translation(*place), (0.2,) * 3, radius=0.15, soft_falloff=False)
        for i, place in enumerate(places)
    ]
    hidden = Light("hidden", LightKind.POINT, scenes.translation(0, 0, 5), (20.0,) * 3, radius=0.2, soft_falloff=False)
    plates = [scenes.translation(x, y, 1.5) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    scene = scenes.scene(
        [
            (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(0.7)),
            (scenes.plane("roof", 12), scenes.translation(0, 0, 2), scenes.diffuse(0.2)),
            *((scenes.plane("plate", 0.3), place, scenes.emitter(1.0)) for place in plates),
        ],
        lights=[scenes.sun(3.0, 0.5), *lamps, hidden],
        frame=Frame(16, 16),
        view=scenes.camera(eye=(0, -2.5, 1.2), target=(0, 0, 0)),
        world=0.1,
    )

    def mean_and_error(**changes) -> tuple[float, float]:
        means = [
            session.render(scene, RenderSettings(bounce_max=1, sample_count=64, seed=seed, **changes))
            .passes["Combined"][..., :3]
            .mean(dtype=np.float64)
            for seed in range(8)
        ]
        return float(np.mean(means)), float(np.std(means, ddof=1) / math.sqrt(len(means)))

    both, error = mean_and_error()
    assert mean_and_error(tile_size=8, batching="ON") == (both, error)
    assert error < 0.005 * both
    for mean, spread in (mean_and_error(nee=nee) for nee in ("OFF", "HALF")):
        assert spread < 0.02 * both
        assert abs(mean - both) < 4 * math.hypot(error, spread) + 1e-6 * both
