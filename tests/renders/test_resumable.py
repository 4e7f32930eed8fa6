"""The integrator takes rays back in any order and at any time: a tracer that holds half of them gives the same film."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.rays import RayList
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers import choose
from raybatch_addon.core.wavefront.tracers.interface import UnbatchedTracer
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


class HesitantTracer(UnbatchedTracer):
    """Traces a random half of the rays that are under way, and keeps the others waiting."""

    waited = 0

    def __init__(self, tree, rays, stages, **more):
        super().__init__(tree, rays, stages, **more)
        self._where = rays.origin.device
        self._waiting = {}
        self._random = np.random.default_rng(5)

    def submit(self, kind, rays):
        slots = rays.slots.numpy()[: int(rays.count.numpy()[0])]
        self._waiting[kind] = np.concatenate([self._waiting.get(kind, slots[:0]), slots])

    def advance(self, stop=None):
        for kind, slots in self._waiting.items():
            order = self._random.permutation(len(slots))
            now = (len(slots) + 1) // 2
            chosen, self._waiting[kind] = slots[order[:now]], slots[order[now:]]
            HesitantTracer.waited += len(slots) - now
            if now:
                count = wp.array([now], dtype=int, device=self._where)
                super().submit(kind, RayList(wp.array(chosen, dtype=int, device=self._where), count, now))
        super().advance()


@pytest.mark.parametrize("features", ["everything", "transparent film"])
def test_rays_that_wait_do_not_change_the_film(session, monkeypatch, features):
    frame = scenes.Frame(16, 12, passes=("Combined", "Depth", "Normal"), transparent=features != "everything")
    settings = RenderSettings(sample_count=4, ray_count=300, bounce_max=5, roulette_bounce=1)
    expected = session.render(scenes.mixed(frame), settings).passes
    monkeypatch.setattr(choose, "UnbatchedTracer", HesitantTracer)
    held = Session(session.device.alias).render(scenes.mixed(frame), settings)
    assert HesitantTracer.waited > 1000
    for name, values in expected.items():
        assert np.array_equal(held.passes[name], values), name
    assert held.statistics["rays"] == session.render(scenes.mixed(frame), settings).statistics["rays"]
