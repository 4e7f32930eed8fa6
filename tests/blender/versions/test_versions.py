"""Files that older versions saved open with the settings that they had."""

import json
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.core.version import VERSION
from raybatch_addon.export.settings import settings_from
from raybatch_addon.ui import migration
from tests.blender.versions import save
from tests.support.panel_layout import context_of, drawn, own_panels

FOLDER = Path(__file__).parent
VERSIONS = sorted(path.stem for path in FOLDER.glob("*.blend"))
# What migrations make of the values in the files
MIGRATED = {"0.1.0": {"device": "cuda:0"}}

needs_blender_5 = pytest.mark.skipif(bpy.app.version < (5, 2), reason="Blender 5.2 saved the files")


def test_each_version_has_its_file():
    assert {"0.1.0", VERSION} <= set(VERSIONS), "make that of a new version: python -m tests.blender.versions.save"


@needs_blender_5
@pytest.mark.parametrize("version", VERSIONS)
def test_a_file_of_each_version_means_what_it_meant(addon, version):
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{version}.blend"))
    scene = bpy.context.scene
    meant = meant_by(version)
    groups = meant.pop("groups", {})
    settings = settings_from(scene)
    expected = meant | MIGRATED.get(version, {})
    assert {name: getattr(settings, name) for name in expected} == expected
    same = [name for name in meant if name in SETTINGS and meant[name] == SETTINGS[name].default]
    assert not same, "the file tells them apart"
    assert scene.render.engine == "RAYBATCH" and scene.raybatch.version == VERSION
    assert scene.view_layers[0].raybatch.use_pass_rays and not scene.view_layers[0].raybatch.use_pass_node_steps
    assert scene.raybatch_export.exposure == 2 and scene.raybatch_viewport.samples == 33
    assert {name: save.values_of(save.groups_of(scene)[name]) for name in groups} == groups


def meant_by(version):
    return json.loads((FOLDER / f"{version}.json").read_text(encoding="utf-8"))


def test_the_file_of_this_version_has_every_property(addon, scene):
    meant = meant_by(VERSION)
    groups = meant.pop("groups")
    assert set(meant) == set(SETTINGS)
    assert {name: list(values) for name, values in groups.items()} == {
        name: [prop.identifier for prop in save.kept_properties(group)] for name, group in save.groups_of(scene).items()
    }
    assert {"raybatch_checkpoint", "raybatch_convergence", "raybatch_export", "raybatch_viewport"} < set(groups)
    same = [
        (name, prop)
        for name, group in save.groups_of(bpy.data.scenes.new("New")).items()
        for prop, value in save.values_of(group).items()
        if groups[name][prop] == value
    ]
    assert same == [("view_layer", "use_pass_node_steps")], "the file tells them apart"


@pytest.mark.parametrize(
    ("before", "after"),
    [("cuda", "cuda:0"), ("CPU", "cpu"), (" auto ", "AUTO"), ("", "AUTO"), ("CUDA:1", "cuda:1"), ("cuda:3", "cuda:3")],
)
def test_devices_get_the_names_of_the_list(scene, before, after):
    scene.raybatch.device, scene.raybatch.version = before, ""
    migration.migrate(scene)
    assert (scene.raybatch.device, scene.raybatch.version) == (after, VERSION)


def test_migrations_happen_once_and_in_order(scene, monkeypatch):
    called = []
    changes = [migration.Migration(each, lambda _own, each=each: called.append(each)) for each in ("0.1.5", "0.2.0")]
    monkeypatch.setattr(migration, "MIGRATIONS", tuple(changes))
    scene.raybatch.version = ""
    migration.migrate(scene)
    migration.migrate(scene)
    assert called == ["0.1.5", "0.2.0"]
    scene.raybatch.version = "0.1.7"
    migration.migrate(scene)
    assert called[2:] == ["0.2.0"]


def test_a_file_that_is_open_where_the_addon_is_enabled_is_migrated(addon, scene):
    scene.raybatch.device, scene.raybatch.version = "cuda", ""
    migration.unregister()
    migration.register()
    assert scene.raybatch.device == "cuda:0"


def test_the_version_is_kept_in_the_file(scene, tmp_path):
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    assert scene.raybatch.version == VERSION


def test_settings_of_a_newer_version_are_left_alone_and_reported(scene, capsys):
    scene.raybatch.version, scene.raybatch.device = "99.1", "CPU"
    before = settings_from(scene)
    migration._opened()
    assert (scene.raybatch.version, scene.raybatch.device) == ("99.1", "CPU")
    assert "saved by RayBatch 99.1" in capsys.readouterr().err
    panel = next(each for each in own_panels() if each.__name__ == "RAYBATCH_RENDER_PT_before_render")
    text = " ".join(note[1] for note in drawn(panel, context_of(scene)) if note[0] == "label")
    assert "saved by RayBatch 99.1" in text and "Update RayBatch" in text
    assert settings_from(scene) == before


def test_versions_are_compared_by_their_numbers():
    assert migration.numbers("0.10.0") > migration.numbers("0.9.9") > migration.numbers("0.9")
