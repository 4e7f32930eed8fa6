"""Settings check themselves, and say what would be right."""

import pytest

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings import SETTINGS, RenderSettings, parse_setting


def test_text_becomes_the_settings_own_type():
    assert parse_setting("sample_count", "64") == 64
    assert parse_setting("filter_width", "2.5") == 2.5
    assert parse_setting("nee", "half") == "HALF"


@pytest.mark.parametrize("name", [name for name, info in SETTINGS.items() if info.kind is not str])
def test_numbers_outside_their_range_are_refused_with_the_range(name):
    info = SETTINGS[name]
    for bad in (info.minimum - 1, info.maximum + (1 if info.kind is int else info.maximum), "nan", "inf", "", "abc"):
        with pytest.raises(SettingsError, match=f"{name}.*must be") as caught:
            RenderSettings().replace(**{name: bad})
        assert info.range_text() in str(caught.value)
    for good in (info.minimum, info.maximum):
        parse_setting(name, str(good))


@pytest.mark.parametrize("name", [name for name, info in SETTINGS.items() if info.choices])
def test_unknown_choices_are_refused_with_the_choices(name):
    with pytest.raises(SettingsError) as caught:
        parse_setting(name, "SOMETHING")
    assert all(identifier in str(caught.value) for identifier, _, _ in SETTINGS[name].choices)


def test_a_fraction_is_no_count():
    with pytest.raises(SettingsError):
        parse_setting("sample_count", "1.5")
    with pytest.raises(SettingsError):
        RenderSettings(sample_count=1.5)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(SettingsError, match="sample_count"):
        RenderSettings().replace(samples=3)


def test_water_marks_in_the_wrong_order_are_refused():
    with pytest.raises(SettingsError, match="ray_low_water"):
        RenderSettings(ray_low_water=0.9, ray_high_water=0.5)


def test_every_setting_says_what_it_is():
    for info in SETTINGS.values():
        assert info.label and info.description and info.group and info.effect in ("estimator", "schedule")
        assert info.choices or info.kind is str or info.minimum < info.maximum
