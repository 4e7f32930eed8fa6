"""Whatever a render allocates or launches names its device: Warp's default is one for all threads, and whoever brings
an array to the host changes it for a moment.
"""

import pytest
import warp as wp

from raybatch_addon.core.session import Session
from tests.support import scenes, schedule_scenes
from tests.support.feature_scenes import EACH_WIDE_FEATURE, FEATURES, WIDE_FEATURES
from tests.support.feature_scenes import SETTINGS as FEATURE_SETTINGS
from tests.support.under_test import DEVICE
from tests.support.watched_renders import FRAME, SETTINGS

pytestmark = pytest.mark.usefixtures("general_kernels")
WAYS = {
    "plain": dict(batching="OFF", error_estimate="ON"),
    "batched": dict(batching="ON"),
    "paged": dict(),
    "adaptive": dict(adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=4),
    "sorted": dict(ray_sort="ON", hit_sort="ON"),
}
TRIED = {**FEATURES, **WIDE_FEATURES, "shadow catchers": EACH_WIDE_FEATURE["shadow catchers"]}


@pytest.fixture
def asked(monkeypatch) -> list[int]:
    """An entry for each time that the default device was asked for, which fails."""
    runtime, asked = type(wp._src.context.runtime), []
    get_device = runtime.get_device

    def named(self, ident=None):
        if ident is None:
            asked.append(1)
            raise AssertionError("no device is named")
        return get_device(self, ident)

    monkeypatch.setattr(runtime, "get_device", named)
    return asked


@pytest.mark.parametrize("way", WAYS)
def test_a_render_never_asks_for_the_default_device(way, asked):
    budget = dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000) if way == "paged" else {}
    made = scenes.mixed(FRAME)
    assert Session(DEVICE).render(made, SETTINGS.replace(**WAYS[way], **budget)).complete
    assert not asked


@pytest.mark.parametrize("name", TRIED)
def test_no_feature_asks_for_the_default_device(name, asked):
    scene, changes = TRIED[name]
    assert Session(DEVICE).render(scene, FEATURE_SETTINGS.replace(**{"sample_count": 2, **changes})).complete
    assert not asked
