"""The panels of time: automatic choices, presets, memory, and settings that do not go together."""

import re
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import reports
from raybatch_addon.blender.devices import DeviceChoice
from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.export.settings import assign_setting, settings_from
from raybatch_addon.ui import choices, last_render, memory
from tests.support.blender_builders import add_grid
from tests.support.panel_layout import ENGINE, context_of, drawn, own_panels

AUTO = {
    "treelet_size": {"value": 4096, "why": "1 MB of nodes and triangles fits the cache"},
    "geometry_budget": {"value": 1_500_000_001, "why": "half of the device's memory"},
    "bucket_selection": {"value": "MOST_FULL", "why": "fewest treelets are brought in"},
    "bucket_wait_max": {"value": 7, "why": "0 is no choice of RayBatch's"},
}


def panel(group):
    return next(each for each in own_panels() if getattr(each, "group", None) == group)


def shown_choices(context):
    """Text and button of each choice that the panels show, by setting."""
    found = {}
    for each in own_panels():
        if hasattr(each, "group"):
            for note in drawn(each, context):
                if note[0] == "operator":
                    _, name, text, button, known = note
                    assert name == "raybatch.keep_choice" and set(vars(button)) <= set(known)
                    found[button.setting] = (text, button)
    return found


@pytest.fixture
def chosen(scene):
    """The scene with a last render in which RayBatch chose settings."""
    report = reports.begin(scene.name, 1)
    report.statistics["Other"] = {"auto": {}}
    report.statistics[scene.view_layers[0].name] = {
        "auto": AUTO,
        "device": {"alias": "cpu"},
        "schedule": {},
        "tree": None,
    }
    return scene


def test_choices_stand_beside_the_settings_that_were_left_open(chosen):
    found = shown_choices(context_of(chosen))
    assert {name: text for name, (text, _) in found.items()} == {
        "treelet_size": "",
        "geometry_budget": "",
        "bucket_selection": "Most Full",
    }
    assert found["treelet_size"][1].why == AUTO["treelet_size"]["why"]
    chosen.raybatch.treelet_size, chosen.raybatch.geometry_budget = 10, "1M"
    assert set(shown_choices(context_of(chosen))) == {"bucket_selection"}


def test_nothing_is_shown_where_nothing_is_known(chosen):
    layer = chosen.view_layers[0].name
    reports.last().statistics[layer] = {"engine": "of an older render"}
    reports.last().statistics[layer].update(device={"alias": "cpu"}, schedule={})
    assert not shown_choices(context_of(chosen))
    reports.last().statistics = {"Gone": {"auto": AUTO, "device": {"alias": "cpu"}, "schedule": {}}}
    assert shown_choices(context_of(chosen)), "a render of another layer is better than none"
    reports.last().statistics = {}
    assert not shown_choices(context_of(chosen))
    reports.begin("Another scene", 1).statistics[layer] = {"auto": AUTO}
    assert not shown_choices(context_of(chosen))
    reports.clear()
    assert not shown_choices(context_of(chosen))


def test_a_choice_is_kept_by_a_click(chosen):
    before = settings_from(chosen)
    for name in ("treelet_size", "geometry_budget", "bucket_selection"):
        button = shown_choices(context_of(chosen))[name][1]
        assert bpy.ops.raybatch.keep_choice(setting=button.setting, value=button.value, why=button.why) == {"FINISHED"}
    assert settings_from(chosen) == before.replace(
        treelet_size=4096, geometry_budget=1_500_000_001, bucket_selection="MOST_FULL"
    )
    assert not shown_choices(context_of(chosen))
    with pytest.raises(RuntimeError, match="queue_size = 'much' is not valid"):
        bpy.ops.raybatch.keep_choice(setting="queue_size", value="much")
    assert settings_from(chosen).queue_size == 0
    description = choices.RAYBATCH_OT_keep_choice.description(bpy.context, button)
    assert button.why in description and "Click" in description


def test_settings_that_do_not_go_together_are_named_in_the_panel(scene):
    def icons():
        return [note[2] for note in drawn(panel("BATCHING"), context_of(scene)) if note[0] == "label"]

    assert not icons()
    scene.raybatch.batching, scene.raybatch.geometry_budget = "OFF", "1M"
    assert icons()[0] == "ERROR" and set(icons()[1:]) == {"BLANK1"}
    text = " ".join(note[1] for note in drawn(panel("BATCHING"), context_of(scene)) if note[0] == "label")
    assert "set geometry_budget to 0, or batching to AUTO or ON" in text
    assert memory.estimate_lines(context_of(scene)) == []


def test_a_budget_that_means_no_number_is_reported_where_it_stands(scene):
    def labels():
        return [note for note in drawn(panel("MEMORY"), context_of(scene)) if note[0] == "label"]

    scene.raybatch.geometry_budget = "1.5G"
    assert "ERROR" not in [icon for _, _, icon in labels()]
    scene.raybatch.geometry_budget = "a lot"
    notes = labels()
    assert notes[0][2] == "ERROR"
    assert "geometry_budget = 'a lot' is not valid: it must be 0 to" in " ".join(note[1] for note in notes)


def test_memory_before_the_first_render(scene):
    add_grid("Grid", 100)
    reports.clear()
    scene.raybatch.ray_count = 1_000_000
    lines = memory.estimate_lines(context_of(scene))
    path_bytes = int(re.fullmatch(r"Rays: 1,000,000 x (\d+) bytes, \d+ MB", lines[0])[1])
    assert 60 < path_bytes < 400
    # 20,000 triangles and 10,201 vertices: corners, positions, normals; and their tree
    assert lines[1] == "Geometry: 1.08 MB, trees: 900 KB"
    assert (
        lines[2] == f"On the device about {(path_bytes * 10**6 + 1_982_412 + 0.5e6) // 10**6:.0f} MB"
        and len(lines) == 3
    )
    scene.raybatch.geometry_budget = "100K"
    assert memory.estimate_lines(context_of(scene))[2] == "Of the trees 100 KB on the device, 800 KB behind it"
    labels = [note[1] for note in drawn(panel("MEMORY"), context_of(scene)) if note[0] == "label"]
    assert " ".join(labels) == " ".join(memory.estimate_lines(context_of(scene)))


def test_a_device_that_is_not_known_is_not_guessed(scene, monkeypatch):
    reports.clear()
    scene.raybatch.device = "AUTO"
    monkeypatch.setattr(memory, "device_choices", lambda: None)
    assert memory.estimate_lines(context_of(scene)) == ["Memory is estimated once the devices are known"]
    of_gpu = DeviceChoice("cuda:0", "NVIDIA H100, 80 GiB", "")
    monkeypatch.setattr(memory, "device_choices", lambda: (of_gpu,))
    assert memory.estimate_lines(context_of(scene))[0].startswith("Rays: 4,194,304 x ")
    scene.raybatch.device = "cuda:3"
    assert memory.estimate_lines(context_of(scene))[0].startswith("Rays: 4,194,304 x ")


def test_the_last_render_makes_the_estimate_better(scene):
    scene.raybatch.device = "AUTO"
    tree = {"triangles": 10**6, "bytes": 10**8}
    reports.begin(scene.name, 1).statistics[scene.view_layers[0].name] = {
        "device": {"alias": "cuda:0"},
        "schedule": {"workers": 1, "ray_count": 1000, "bytes_per_path": 150},
        "tree": tree,
    }
    lines = memory.estimate_lines(context_of(scene))
    assert lines == [
        "Rays: 1,000 x 150 bytes, 150 KB",
        "Geometry: 54.0 MB, trees: 100 MB",
        "On the device about 154 MB",
    ]
    scene.raybatch.device = "cpu"  # the last render says nothing about another device
    assert memory.estimate_lines(context_of(scene))[1] == "Geometry: 0 bytes, trees: 0 bytes"


def test_real_statistics_are_what_the_panel_takes_them_for(scene):
    add_grid("Grid", 40)
    scene.raybatch.device = "cpu"
    bpy.ops.render.render()
    lines = memory.estimate_lines(context_of(scene))
    assert len(lines) == 3 and lines[0].startswith("Rays: ") and "trees: " in lines[1]
    for name, (text, _) in shown_choices(context_of(scene)).items():
        assert bool(text) == bool(SETTINGS[name].choices)


def test_the_last_render_shows_batching():
    from raybatch_addon.core.measure.batching import BatchingTotals
    from raybatch_addon.ui.last_render import _batching_lines

    totals = BatchingTotals(finished=10, treelet_visits=28, rays_queued=19, block_count=12_345, blocks_short=3)
    assert _batching_lines(totals.report()) == [
        "Batched: 2.8 treelets, 1.9 times queued a ray",
        "The 12.3 k blocks of queues ran out 3 times",
    ]
    totals = BatchingTotals(finished=10, pages_loaded=355, bytes_copied=23_100_000_000, resident_peak=1_499_000_000)
    assert _batching_lines(totals.report())[1:] == [
        "Geometry on the device 1,499 MB at most; brought there: 355 pages, 23.10 GB"
    ]
    assert _batching_lines(None) == []


@pytest.mark.parametrize("is_rendered, said", [(True, "Being rendered"), (False, "No picture was finished")])
def test_a_render_that_is_not_over_has_no_warnings_yet(scene, monkeypatch, is_rendered, said):
    monkeypatch.setattr(last_render, "bpy", SimpleNamespace(app=SimpleNamespace(is_job_running=lambda _: is_rendered)))
    reports.begin(scene.name, 1)
    shown = next(each for each in own_panels() if each.__name__ == "RAYBATCH_RENDER_PT_last_render")
    assert [note[1] for note in drawn(shown, context_of(scene)) if note[0] == "label"] == [
        f"{scene.name}, frame 1",
        said,
    ]


def test_values_in_words():
    assert choices.value_text(SETTINGS["treelet_bytes"], 65_536) == "65.5 kB"
    assert (
        choices.value_text(SETTINGS["ray_sort"], "ON") == "On"
        and choices.value_text(SETTINGS["ray_count"], 4194304) == "4,194,304"
    )
    assert choices.value_text(SETTINGS["device"], "cuda:0") == "cuda:0"


def test_assigned_values_are_those_of_settings(scene):
    for name, info in SETTINGS.items():
        assign_setting(scene.raybatch, name, info.default)
    assert scene.render.engine == ENGINE
