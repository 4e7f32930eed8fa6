"""How single settings are shown: checkboxes, what is automatic, devices, and names that are not cut off."""

import re
from types import SimpleNamespace
from unittest import mock

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import devices, reports
from raybatch_addon.core.settings.settings import BYTES, GROUPS, SETTINGS
from raybatch_addon.export.settings import assign_setting, settings_from
from raybatch_addon.ui import render_panels
from raybatch_addon.ui.choices import value_text
from raybatch_addon.ui.devices import choices_for, draw_devices
from raybatch_addon.ui.panel import fitting_lines, free_width, label_width
from raybatch_addon.ui.properties import switch_name
from tests.support.panel_layout import FIRST_WIDTH, Layout, Measured, context_of, drawn, own_panels

SWITCHES = [name for name, info in SETTINGS.items() if info.is_switch]
NUMBERS = [name for name, info in SETTINGS.items() if switch_name(info) and not info.is_switch]


@pytest.mark.parametrize("name", SWITCHES)
def test_what_is_on_or_off_is_a_checkbox(scene, name):
    box = switch_name(SETTINGS[name])
    for wanted in ("ON", "OFF", "ON"):
        setattr(scene.raybatch, box, wanted == "ON")
        assert getattr(settings_from(scene), name) == wanted == getattr(scene.raybatch, name)
    setattr(scene.raybatch, name, "OFF")
    assert getattr(scene.raybatch, box) is False


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_that_may_be_left_open_have_a_checkbox(scene, name):
    info, own = SETTINGS[name], scene.raybatch
    reports.clear()
    box = switch_name(info)
    rests = info.auto if info.auto is not None else info.off
    is_open = info.auto is not None  # what the box says where the number is left open
    assert getattr(own, box) == is_open and getattr(settings_from(scene), name) == rests == info.default
    setattr(own, box, not is_open)
    assert getattr(settings_from(scene), name) == info.start != rests
    assert getattr(own, box) != is_open
    setattr(own, box, is_open)
    assert getattr(settings_from(scene), name) == rests


def test_a_number_begins_with_what_was_chosen_in_the_last_render(scene):
    report = reports.begin(scene.name, 1)
    report.statistics[scene.view_layers[0].name] = {
        "auto": {"treelet_size": {"value": 1234, "why": "it fits"}, "tile_size": {"value": 96, "why": "few pixels"}},
        "device": {"alias": "cpu"},
        "schedule": {},
        "tree": None,
    }
    texts = {}

    class Noted(Layout):
        def column(self, heading="", **_options):
            return Noted(self.notes)

        row = box = column

        def prop(self, owner, name, text=None, **options):
            texts[name] = text

    for panel in own_panels():
        if hasattr(panel, "group"):
            panel.draw(type("Self", (), {"layout": Noted(), "group": panel.group})(), context_of(scene))
    assert texts["treelet_size_is_auto"] == "Auto, 1,234" and texts["tile_size_is_auto"] == "Auto, 96 px"
    assert texts["ray_count_is_auto"] == "Auto"
    scene.raybatch.treelet_size_is_auto = False
    assert settings_from(scene).treelet_size == 1234


def cut_off(scene, info):
    layout = Measured()
    region = SimpleNamespace(width=FIRST_WIDTH)
    render_panels._draw_setting(layout.column(), context_of(scene, region=region), info)
    return layout.cut


@pytest.mark.parametrize("name", [name for name in SETTINGS if name != "device"])
def test_names_and_values_fit_the_panel_at_its_first_width(scene, name):
    reports.clear()
    info, own = SETTINGS[name], scene.raybatch
    assert cut_off(scene, info) == []
    for identifier, _, _ in info.choices:
        setattr(own, name, identifier)
        assert cut_off(scene, info) == []
    if info.kind is not str and switch_name(info):
        setattr(own, switch_name(info), info.auto is None)
        assert cut_off(scene, info) == []


def chosen_values(info):
    if info.choices:
        return [identifier for identifier, _, _ in info.choices if identifier != info.auto]
    if info.unit == BYTES:
        return [1_000, 999_949, 65_536, 123_456_789, 12_345_678_901, 999_000_000_000]
    return [8, 2_048] if info.unit == "pixels" else [8, 999_999, 4_194_304, 268_435_456]


@pytest.mark.parametrize("name", [name for name, info in SETTINGS.items() if info.auto is not None])
def test_what_was_chosen_fits_beside_auto(scene, name):
    info, own = SETTINGS[name], scene.raybatch
    if name == "device":
        return
    assign_setting(own, name, info.auto)
    for value in chosen_values(info):
        report = reports.begin(scene.name, 1)
        report.statistics[scene.view_layers[0].name] = {"auto": {name: {"value": value, "why": "it fits"}}}
        assert cut_off(scene, info) == [], value
        notes = drawn_setting(scene, info)
        (button,) = [note[3] for note in notes if note[0] == "operator"]
        assert (button.setting, button.value, button.shown) == (name, str(value), value_text(info, value))
    reports.clear()


def drawn_setting(scene, info):
    layout = Layout()
    render_panels._draw_setting(layout, context_of(scene), info)
    return layout.notes


def test_the_layout_notes_what_is_cut_off(scene):
    layout = Measured()
    layout.label("a name that is far too long for a panel of this width")
    layout.row().split(factor=0.5).operator("raybatch.keep_choice", text="Specialised kernels")
    assert [text.split(":")[0] for text in layout.cut] == [
        "a name that is far too long for a panel of this width",
        "Specialised kernels",
    ]


def test_names_of_panels_fit():
    for group in GROUPS.values():
        assert label_width(group.label) <= 150


def test_the_panel_speaks_of_auto_and_the_command_line_of_numbers():
    for info in SETTINGS.values():
        if info.kind is str:
            continue
        assert "{" not in info.description + info.panel_description
        if info.auto is not None or info.off is not None:
            rest = f"{info.off if info.auto is None else info.auto:g}"
            assert re.search(rf"\b{rest}\b", info.description), "what the number means that stands for it"
            assert not re.search(rf"\b{rest}\b", info.panel_description)
            assert ("Auto" if info.auto is not None else "off") in info.panel_description
        else:
            assert info.description == info.panel_description


def test_other_numbers_than_0_say_what_is_automatic():
    for info in SETTINGS.values():
        if info.kind is int and info.auto is not None:
            assert info.start not in (None, info.auto)
        if info.off is not None:
            assert info.start not in (None, info.off) and info.default == info.off


def test_devices_are_a_list_with_names_and_memory(scene, monkeypatch):
    found = (
        devices.DeviceChoice("AUTO", "Auto (NVIDIA H100)", ""),
        devices.DeviceChoice("cpu", "CPU, AMD EPYC, 24 GiB", ""),
        devices.DeviceChoice("cuda:0", "NVIDIA H100, 80 GiB", ""),
    )
    monkeypatch.setattr("raybatch_addon.ui.devices.device_choices", lambda: found)
    own = scene.raybatch
    for name in ("AUTO", "cpu", "cuda:0"):
        own.device_choice = name
        assert own.device == name == own.device_choice
    own.device = "cuda:7"
    assert [each.label for each in choices_for("cuda:7")][-1] == "cuda:7: not on this computer"
    assert own.device_choice == "cuda:7", "a file from another computer keeps what it says"
    own.device_choice = "cpu"
    assert own.device == "cpu"


def test_devices_are_ticked_to_share_each_picture(scene, monkeypatch):
    names = ("AUTO", "cpu", "cuda:0", "cuda:1")
    found = tuple(devices.DeviceChoice(name, f"label of {name}", "") for name in names)
    monkeypatch.setattr("raybatch_addon.ui.devices.device_choices", lambda: found)
    own = scene.raybatch
    ticks = (
        ("cuda:1", "cuda:1"),
        ("cuda:0", "cuda:0,cuda:1"),  # in their order, whichever was ticked first
        ("cpu", "cpu,cuda:0,cuda:1"),
        ("cpu", "cuda:0,cuda:1"),
        ("cuda:0", "cuda:1"),
        ("cuda:1", "AUTO"),
    )
    own.device = "AUTO"
    for name, expected in ticks:
        bpy.ops.raybatch.share_device(name=name)
        assert own.device == own.device_choice == expected
    own.device = "ALL"
    assert choices_for("ALL")[-1].label == "All CUDA devices" and own.device_choice == "ALL"
    bpy.ops.raybatch.share_device(name="cuda:1")
    assert own.device == "cuda:0"
    assert choices_for("cuda:0, cuda:1")[-1].label == "Together: cuda:0, cuda:1"
    assert choices_for("cuda:0,cuda:7")[-1].label == "cuda:0,cuda:7: not on this computer"
    own.device = "cuda:0,cuda:1"
    shown, layout = [], mock.MagicMock()
    layout.column().row().prop_enum.side_effect = lambda owner, name, value: shown.append(value)
    draw_devices(layout, bpy.context)
    assert shown == [*names, "cuda:0,cuda:1"]
    ticked = [call.kwargs["depress"] for call in layout.column().row().operator.call_args_list]
    assert ticked == [False, True, True], "not AUTO, nor what stands for the choice as a whole"


def test_the_devices_of_this_computer_are_named(scene):
    devices._found.cache_clear()
    auto, cpu, *_ = devices._found()
    assert (auto.name, cpu.name) == ("AUTO", "cpu")
    assert cpu.label.startswith("CPU, ") and cpu.label.endswith(" GiB") and auto.label.startswith("Auto (")


@pytest.mark.parametrize(
    ("model", "shown"),
    [
        ("Intel(R) Xeon(R) Platinum 8488C", "Intel Xeon Platinum 8488C"),
        ("Intel(R) Core(TM) i7-8700K CPU @ 3.70GHz", "Intel Core i7-8700K"),
        ("AMD Ryzen 9 7950X 16-Core Processor", "AMD Ryzen 9 7950X"),
    ],
)
def test_processors_are_named_shortly(model, shown):
    assert " ".join(devices._NOISE.sub(" ", model).split()) == shown


@pytest.mark.parametrize("width", [120, 180, 300, 700])
def test_lines_are_broken_at_every_width(scene, width):
    report = reports.begin("Scene", 7)
    report.warnings.append("the material “" + "Wallpaper" * 9 + "” of 12 objects has a node that is not supported, OSL")
    region = type("Region", (), {"width": width})()
    context = context_of(scene, region=region)
    panel = next(each for each in own_panels() if each.__name__ == "RAYBATCH_RENDER_PT_last_render")
    texts = [note[1] for note in drawn(panel, context) if note[0] == "label"]
    assert "".join("".join(texts).split()).removeprefix("Scene,frame7") == "".join(report.warnings[0].split()), (
        "nothing is left out"
    )
    assert all(label_width(text) <= free_width(context) for text in texts)


def test_lines_take_words_as_they_fit():
    assert fitting_lines("one two  three", 7, len) == ["one two", "three"]
    assert fitting_lines("abcdefgh ij", 3, len) == ["abc", "def", "gh", "ij"]
    assert fitting_lines("", 3, len) == [""]
    assert fitting_lines("a b", 0, len) == ["a", "b"]
