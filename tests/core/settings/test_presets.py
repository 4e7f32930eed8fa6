"""Presets are whole sets of legal settings: those of the schedule, or what a picture's noise depends on."""

import pytest

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings


@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if not preset.changes_picture])
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


def test_presets_of_the_picture_leave_the_schedule_alone():
    found = {name: preset_settings(name) for name, preset in PRESETS.items() if preset.changes_picture}
    assert list(found) == ["PREVIEW", "BALANCED", "FINAL"]
    assert len({tuple(values) for values in found.values()}) == 1, "each undoes the others"
    assert all(SETTINGS[name].effect == "estimator" for name in found["FINAL"])
    assert [values["sample_count"] for values in found.values()] == [32, 256, 2048]
    noise = [values["noise_threshold"] for values in found.values()]
    assert noise == sorted(noise, reverse=True)
    assert all(RenderSettings(**values).denoise == "ON" for values in found.values())


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
    with pytest.raises(SettingsError, match="'Fast'.*FINAL, AUTO, THESIS, UNBATCHED"):
        preset_settings("Fast")
