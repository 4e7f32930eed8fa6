"""Settings check themselves, and say what would be right."""

import pytest

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.settings import GROUPS, SETTINGS, RenderSettings, parse_setting


def test_text_becomes_the_settings_own_type():
    assert parse_setting("sample_count", "64") == 64
    assert parse_setting("filter_width", "2.5") == 2.5
    assert parse_setting("nee", "half") == "HALF"


@pytest.mark.parametrize(
    ("name", "closest"),
    [
        ("sample_cuont", "sample_count"),
        ("treelet-size", "treelet_size"),
        ("Seed", "seed"),
        ("resolutoin", "resolution"),
    ],
)
def test_a_misspelt_setting_is_answered_with_what_was_meant(name, closest):
    with pytest.raises(SettingsError, match=rf"no setting is called '{name}'; did you mean {closest}( or [a-z_]+)*\?$"):
        parse_setting(name, "1", beside=("resolution",))


def test_a_name_that_is_like_no_other_gets_the_list_alone():
    with pytest.raises(SettingsError, match="no setting is called 'xyz'; the settings are adaptive_samples_min, "):
        RenderSettings().replace(xyz=1)


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


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            dict(treelet_size=10, treelet_size_min=11),
            ["treelet_size_min (11)", "treelet_size (10)", "raise treelet_size"],
        ),
        (
            dict(queue_size=2**20, queue_count=2**12),
            ["queue_size (1048576)", "queue_count (4096)", "4,294,967,296", "set queue_count to 0"],
        ),
        (dict(single_lane="ON", warp_count=2), ["single_lane is ON", "warp_count is 2", "set warp_count to 0 or 1"]),
        (dict(register_cap=65, block_size=1024), ["register_cap (65)", "block_size (1024)", "65,536", "lower one"]),
        (dict(register_cap=66, block_size=992), ["register_cap (66)", "block_size (992)", "steps of 8", "lower one"]),
        (
            dict(batching="REFERENCE", geometry_budget="1M"),
            ["batching is REFERENCE", "geometry_budget (1000000 bytes)", "set geometry_budget to 0"],
        ),
        (
            dict(batching="OFF", geometry_budget=1),
            ["batching is OFF", "geometry_budget (1 bytes)", "batching to AUTO or ON"],
        ),
    ],
)
def test_settings_that_cannot_go_together_say_why_and_what_to_do(settings, words):
    with pytest.raises(SettingsError) as caught:
        RenderSettings(**settings)
    for each in words:
        assert each in str(caught.value)
    for name in settings:  # either alone is fine
        RenderSettings(**{name: settings[name]})


@pytest.mark.parametrize(
    "settings",
    [
        dict(treelet_size=0, treelet_size_min=100),
        dict(treelet_size=5, treelet_size_min=5),
        dict(single_lane="ON", warp_count=1),
        dict(register_cap=64, block_size=1024),
        dict(queue_size=2**20, queue_count=2**11 - 1),
        dict(queue_size=1, queue_count=1),
        dict(batching="ON", geometry_budget=1),
        dict(batching="OFF", geometry_store="DISK"),
        dict(batching="REFERENCE", debug_checks="ON"),
    ],
)
def test_settings_that_can(settings):
    assert RenderSettings(**settings) == RenderSettings().replace(**settings)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("0", 0),
        ("123", 123),
        ("1.5G", 1_500_000_000),
        ("1500MB", 1_500_000_000),
        ("512Mi", 2**29),
        ("0.5 gib", 2**29),
        ("2k", 2000),
        (".25KiB", 256),
        ("1T", 10**12),
        ("4611686018427387904", 2**62),
        ("4194304TiB", 2**62),
        ("7B", 7),
    ],
)
def test_bytes_with_units(text, number):
    assert parse_setting("geometry_budget", text) == number
    assert RenderSettings(geometry_budget=text).geometry_budget == number


@pytest.mark.parametrize(
    "text", ["-1", "1.5", "1.0001K", "G", "1E", "1 2", "1e9", "5000P", "4194305TiB", "1.5 i", "0x10", "", "1,5G", "١"]
)
def test_bytes_that_are_none(text):
    with pytest.raises(SettingsError, match="0 to 4611686018427387904 bytes; 1.5G is 1,500,000,000"):
        parse_setting("geometry_budget", text)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [("register_cap", (0, 16, 255), (1, 15, 256)), ("block_size", (0, 32, 96, 1024), (1, 16, 33, 1056))],
)
def test_ranges_with_gaps(name, good, bad):
    for value in good:
        assert getattr(RenderSettings(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(SettingsError, match=f"{name} = {value} is not valid: it must be 0, or"):
            RenderSettings(**{name: value})


def test_what_lets_raybatch_choose_is_legal_and_the_default():
    chosen = {name for name, info in SETTINGS.items() if info.auto is not None}
    assert {"batching", "treelet_size", "queue_size", "bucket_selection", "geometry_budget", "geometry_store"} <= chosen
    for name in chosen:
        info = SETTINGS[name]
        # one estimator setting alone is chosen, by another of them: the film depends on no device
        assert info.effect == "schedule" or name == "adaptive_samples_min"
        assert info.default == info.auto and info.is_auto(getattr(RenderSettings(), name))
    assert not SETTINGS["bucket_wait_max"].is_auto(0)


def test_every_setting_says_what_it_is():
    for info in SETTINGS.values():
        assert info.label and info.description and info.group in GROUPS and info.effect in ("estimator", "schedule")
        assert info.choices or info.kind is str or info.minimum < info.maximum
