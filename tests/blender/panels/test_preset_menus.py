"""The menus of presets: Blender's own mechanism, with files for what the core defines."""

import re
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.export.settings import settings_from
from raybatch_addon.ui import presets
from tests.support.panel_layout import context_of, drawn, own_panels


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_preset_sets_what_the_core_says(scene, name):
    scene.raybatch.warp_count, scene.raybatch.geometry_budget, scene.raybatch.sample_count = 5, "3G", 9
    before = settings_from(scene)
    assert bpy.ops.raybatch.preset(preset=name) == {"FINISHED"}
    assert settings_from(scene) == before.replace(**preset_settings(name))
    kept = ("warp_count", "geometry_budget") if PRESETS[name].changes_picture else ("sample_count",)
    assert all(getattr(settings_from(scene), each) == getattr(before, each) for each in kept)


def files(folder):
    """The files of a menu, by the names that it shows."""
    return {
        bpy.path.display_name(path.name, title_case=False): path
        for each in bpy.utils.preset_paths(folder)
        for path in sorted(Path(each).glob("*.py"))
    }


def test_the_menus_offer_what_users_look_for(scene):
    assert {"Preview", "Balanced", "Final", "Thesis"} <= set(files(presets.RENDER))
    assert {"Automatic", "Thesis", "Unbatched"} <= set(files(presets.BATCHING))
    for group, panel in (("SAMPLING", "RAYBATCH_PT_render_presets"), ("BATCHING", "RAYBATCH_PT_batching_presets")):
        of_group = next(each for each in own_panels() if getattr(each, "group", None) == group)
        assert ("popover", panel, "PRESET") in drawn(of_group, context_of(scene), "draw_header_preset")


@pytest.mark.parametrize("folder", [presets.RENDER, presets.BATCHING])
def test_each_file_of_a_menu_sets_its_preset(scene, folder):
    own_files = {name: path for name, path in files(folder).items() if "raybatch_addon" in str(path)}
    assert own_files
    for path in own_files.values():
        scene.raybatch.sample_count, scene.raybatch.queue_size = 9, 7
        before = settings_from(scene)
        menu = f"RAYBATCH_PT_{folder.rpartition('/')[2]}_presets"
        bpy.ops.script.execute_preset(filepath=str(path), menu_idname=menu)
        named = re.search(r'preset="(\w+)"', path.read_text())[1]
        assert PRESETS[named].label == path.stem
        assert settings_from(scene) == before.replace(**preset_settings(named))


def test_presets_that_denoise_go_without_where_the_library_is_missing(scene, monkeypatch):
    monkeypatch.setattr(presets, "why_not", lambda given: "it is not there")
    bpy.ops.raybatch.preset(preset="FINAL")
    assert settings_from(scene).denoise == "OFF" and settings_from(scene).sample_count == 2048


def test_users_add_presets_of_their_own(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda *_args, path="", **_rest: _made(tmp_path / path))
    scene.raybatch.sample_count, scene.raybatch.geometry_budget, scene.raybatch.seed = 77, "3G", 5
    wanted = settings_from(scene)
    assert bpy.ops.raybatch.render_preset_add(name="Mine") == {"FINISHED"}
    written = next(tmp_path.rglob("Mine.py"))
    scene.raybatch.sample_count, scene.raybatch.geometry_budget, scene.raybatch.seed = 1, "0", 0
    scene.raybatch.device = "cpu"
    bpy.ops.script.execute_preset(filepath=str(written), menu_idname="RAYBATCH_PT_render_presets")
    assert settings_from(scene) == wanted.replace(device="cpu"), "all but the device is kept"


def _made(path):
    path.mkdir(parents=True, exist_ok=True)
    return str(path)


def test_a_preset_is_undone(scene, monkeypatch):
    monkeypatch.setattr(bpy.context.preferences.edit, "use_global_undo", True)
    scene.raybatch.queue_size = 9
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.raybatch.preset(preset="THESIS")
    assert bpy.context.scene.raybatch.queue_size == 64
    bpy.ops.ed.undo_push(message="behind")
    bpy.ops.ed.undo()
    assert bpy.context.scene.raybatch.queue_size == 9


def test_presets_are_of_this_engine(scene):
    scene.render.engine = "BLENDER_WORKBENCH"
    assert not bpy.ops.raybatch.preset.poll()
    for operator in (bpy.types.RAYBATCH_OT_preset, bpy.types.RAYBATCH_OT_keep_choice):
        assert "UNDO" in operator.bl_options
