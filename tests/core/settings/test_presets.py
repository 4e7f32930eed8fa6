"""Presets are whole sets of legal schedule settings."""

import pytest

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_preset_sets_the_whole_schedule_and_nothing_else(name):
    settings = preset_settings(name)
    assert set(settings) == {info.name for info in SETTINGS.values() if info.effect == "schedule"} - {
        "device",
        "thread_count",
        "kernel_tier",
    }
    before = RenderSettings(sample_count=7, device="cpu", warp_count=3, queue_size=9, geometry_budget=5)
    after = before.replace(**settings)
    assert after == RenderSettings(**settings, sample_count=7, device="cpu"), "nothing of the old schedule is left"
    assert preset_settings(f" {name.lower()} ") == settings


def test_what_presets_are():
    assert RenderSettings(**preset_settings("AUTO")) == RenderSettings()
    assert RenderSettings(**preset_settings("UNBATCHED")) == RenderSettings(batching="OFF")
    thesis = RenderSettings(**preset_settings("THESIS"))
    assert (thesis.batching, thesis.treelet_size, thesis.queue_size, thesis.warp_count, thesis.register_cap) == (
        "ON",
        800,
        64,
        1,
        64,
    )


def test_another_preset_is_refused_with_those_that_there_are():
    with pytest.raises(SettingsError, match="'Fast'.*AUTO, THESIS, UNBATCHED"):
        preset_settings("Fast")
