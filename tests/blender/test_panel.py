"""Settings and panels in Blender."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import general_kernels, reports, sessions
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.settings import BYTES, GROUPS, SETTINGS, RenderSettings
from raybatch_addon.export.passes import (
    CATCHER_PROPERTY,
    LIGHT_PASS_PROPERTIES,
    MATTE_PROPERTIES,
    OWN_PASS_PROPERTIES,
    PASS_PROPERTIES,
    VOLUME_PASS_PROPERTIES,
)
from raybatch_addon.export.settings import assign_setting, settings_from
from raybatch_addon.ui import builtin_panels, last_render, preferences
from raybatch_addon.ui.devices import CHOICE
from raybatch_addon.ui.panel import free_width, label_width
from raybatch_addon.ui.properties import megabytes_name, switch_name
from raybatch_addon.ui.render_panels import shown_name
from tests.support.blender_builders import add_grid
from tests.support.panel_layout import ENGINE, Layout, context_of, drawn, enabled_panels, own_panels


@pytest.mark.parametrize("name", list(SETTINGS))
def test_every_setting_is_a_property_made_from_its_definition(scene, name):
    info = SETTINGS[name]
    prop = scene.raybatch.bl_rna.properties[name]
    assert prop.name == info.label
    assert info.panel_description in prop.description and info.unit in prop.description
    if info.choices:
        assert [(item.identifier, item.name) for item in prop.enum_items] == [choice[:2] for choice in info.choices]
        assert prop.default == info.default
    elif info.unit == BYTES:
        assert prop.default == str(info.default)
        shown = scene.raybatch.bl_rna.properties[megabytes_name(info)]
        assert shown.name == info.label and info.panel_description in shown.description
        assert (shown.hard_min, shown.hard_max) == tuple(np.float32([info.minimum / 1e6, info.maximum / 1e6]))
    elif info.kind is int:
        assert (prop.default, prop.hard_min, prop.hard_max) == (info.default, info.minimum, info.maximum)
    elif info.kind is float:
        assert (prop.default, prop.hard_min, prop.hard_max) == tuple(
            np.float32([info.default, info.minimum, info.maximum])
        )
    else:
        assert prop.default == info.default


def test_settings_of_a_new_scene_are_the_defaults(addon):
    scene = bpy.data.scenes.new("New")
    assert settings_from(scene) == RenderSettings()


@pytest.mark.parametrize("end", ["minimum", "maximum"])
@pytest.mark.parametrize("name", [name for name, info in SETTINGS.items() if info.kind is not str])
def test_the_ends_of_every_range_come_through(scene, name, end):
    before = settings_from(scene)
    others = (
        {"ray_low_water": 0.0}
        if name == "ray_high_water"
        else {"ray_high_water": 1.0}
        if name == "ray_low_water"
        else {}
    )
    ends = {**others, name: SETTINGS[name].kind(getattr(SETTINGS[name], end))}
    for each, value in ends.items():
        assign_setting(scene.raybatch, each, value)
    assert settings_from(scene) == before.replace(**ends)


def test_bytes_are_kept_exactly_and_shown_in_megabytes(scene):
    own = scene.raybatch
    for number, shown in ((0, 0.0), (1, 1e-6), (1_500_000_001, 1500.0), (2**62, 2**62 / 1e6)):
        assign_setting(own, "geometry_budget", number)
        assert settings_from(scene).geometry_budget == number
        assert own.geometry_budget_mb == np.float32(shown)
    for typed, number in ((1.5, 1_500_000), (0.1, 100_000), (1234.567, 1_234_567_000), (1e13, 2**62), (0.0, 0)):
        own.geometry_budget_mb = typed
        assert settings_from(scene).geometry_budget == number, typed
    own.geometry_budget = "512Mi"
    assert settings_from(scene).geometry_budget == 2**29 and own.geometry_budget_mb == np.float32(536.870912)
    own.geometry_budget = "a lot"
    assert own.geometry_budget_mb == 0
    with pytest.raises(SettingsError, match="geometry_budget = 'a lot'"):
        settings_from(scene)


def test_fractions_come_through_as_typed(scene):
    scene.raybatch.filter_width = 1.3
    assert settings_from(scene).filter_width == 1.3


def test_choices_and_devices_by_name(scene):
    scene.raybatch.nee = "HALF"
    for device in ("cpu", "AUTO", "cuda:0"):
        scene.raybatch.device = device
        assert settings_from(scene) == settings_from(scene).replace(nee="HALF", device=device)
    with pytest.raises(TypeError):
        scene.raybatch.nee = "SOMETIMES"


def test_settings_are_copied_with_the_scene_and_kept_in_the_file(scene, tmp_path):
    scene.raybatch.sample_count = 777
    assert scene.copy().raybatch.sample_count == 777
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.context.scene.raybatch.sample_count == 777
    assert bpy.context.scene.render.engine == ENGINE


def test_every_setting_is_in_one_panel(scene):
    shown = []
    for panel in own_panels():
        if panel.__name__.startswith(f"{ENGINE}_RENDER_PT_") and hasattr(panel, "group"):
            shown += [note[2] for note in drawn(panel, context_of(scene)) if note[:2] == ("prop", "RayBatchSettings")]
    own = scene.raybatch
    own.device_choice  # noqa: B018 - the items are there where it is drawn
    shown = [name for name in shown if name != CHOICE]
    expected = []
    for info in SETTINGS.values():
        switch = switch_name(info)
        is_set = not switch or info.is_switch or getattr(own, switch) == (info.auto is None)
        expected += [shown_name(info)] if is_set and info.name != "device" else []
        expected += [switch] if switch and not info.is_switch else []
    expected.remove("denoise_is_on")  # in the header
    assert sorted(shown) == sorted(expected)


def test_panels_of_groups_lie_in_that_of_their_parent(scene):
    panels = {panel.group: panel for panel in own_panels() if hasattr(panel, "group")}
    assert list(panels) == list(GROUPS)
    for name, panel in panels.items():
        assert getattr(panel, "bl_parent_id", None) == (
            panels[GROUPS[name].parent].__name__ if GROUPS[name].parent else None
        )
    of_batching = [panels[name].bl_label for name in GROUPS if GROUPS[name].parent == "BATCHING"]
    assert of_batching == ["Scheduler", "Queues", "Treelets", "Launch"]
    assert panels["BATCHING"].bl_options == {"DEFAULT_CLOSED"}, "the laboratory's settings are out of the way"


def test_panels_are_there_for_this_engine_only(scene):
    for panel in own_panels():
        assert not panel.poll(context_of(scene, engine="CYCLES"))
    sampling = next(panel for panel in own_panels() if panel.__name__ == "RAYBATCH_RENDER_PT_sampling")
    assert sampling.poll(context_of(scene))


def test_the_other_panels_draw_what_exists(scene):
    light = bpy.data.lights.new("Light", "AREA")
    material = bpy.data.materials.new("Material")
    obj = bpy.data.objects.new("Light", light)
    camera = bpy.data.cameras.new("Camera")
    camera.type = "PANO"
    context = context_of(
        scene, object=obj, light=light, camera=camera, world=bpy.data.worlds.new("World"), material=material
    )
    of_mesh = context_of(scene, object=bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh")))
    drawn_properties = {}
    for panel in own_panels():
        if panel.bl_context != "render":
            its_context = of_mesh if panel.__name__ == "RAYBATCH_OBJECT_PT_shadow_terminator" else context
            assert panel.poll(its_context)
            drawn_properties[panel.__name__] = [note[2] for note in drawn(panel, its_context)]
    assert {"use_pass_normal", "use_pass_node_steps"} <= set(drawn_properties["RAYBATCH_VIEWLAYER_PT_passes"])
    assert "visible_glossy" in drawn_properties["RAYBATCH_OBJECT_PT_ray_visibility"]
    assert {"use_strand", "use_volumes"} <= set(drawn_properties["RAYBATCH_VIEWLAYER_PT_filter"])
    assert {"spread", "is_portal"} <= set(drawn_properties["RAYBATCH_LIGHT_PT_settings"])
    of_material = {"displacement_method", "use_transparent_shadow", "emission_sampling"}
    assert of_material <= set(drawn_properties["RAYBATCH_MATERIAL_PT_settings"])
    assert "glossy" in drawn_properties["RAYBATCH_WORLD_PT_ray_visibility"]
    assert "sampling_method" in drawn_properties["RAYBATCH_WORLD_PT_settings"]
    every = set(drawn_properties["RAYBATCH_VIEWLAYER_PT_passes"])
    from_view_layer = {*PASS_PROPERTIES, *LIGHT_PASS_PROPERTIES, *VOLUME_PASS_PROPERTIES, *MATTE_PROPERTIES}
    assert from_view_layer | {*OWN_PASS_PROPERTIES, CATCHER_PROPERTY} <= every, "each pass is offered"
    assert "aovs" in drawn_properties["RAYBATCH_VIEWLAYER_PT_aov"]


def test_parents_of_panels_exist_and_are_enabled(addon):
    enabled = enabled_panels()
    for panel in bpy.types.Panel.__subclasses__():
        if panel.__name__ in enabled and getattr(panel, "bl_parent_id", ""):
            parent = getattr(bpy.types, panel.bl_parent_id)
            assert ENGINE in getattr(parent, "COMPAT_ENGINES", {ENGINE}), (
                f"{panel.__name__} is inside {panel.bl_parent_id}, which is hidden"
            )


def test_builtin_panels_that_apply_are_enabled_and_others_are_not(addon):
    enabled = enabled_panels()
    for name in (
        "RENDER_PT_output",
        "RENDER_PT_format",
        "RENDER_PT_frame_range",
        "RENDER_PT_color_management",
        "RAYBATCH_RENDER_PT_simplify",
        "RAYBATCH_RENDER_PT_simplify_render",
        "RENDER_PT_stereoscopy",
        "VIEWLAYER_PT_layer",
        "DATA_PT_lens",
        "DATA_PT_camera_dof",
        "DATA_PT_EEVEE_light",
        "DATA_PT_spot",
        "DATA_PT_uv_texture",
        "EEVEE_MATERIAL_PT_context_material",
        "EEVEE_MATERIAL_PT_surface",
        "EEVEE_MATERIAL_PT_displacement",
        "EEVEE_MATERIAL_PT_volume",
        "EEVEE_WORLD_PT_surface",
        "EEVEE_WORLD_PT_volume",
        "EEVEE_WORLD_PT_mist",
        "WORLD_PT_context_world",
        "OBJECT_PT_visibility",
        "OBJECT_PT_shading",
        "PARTICLE_PT_render",
        "PARTICLE_PT_hair_shape",
        "DATA_PT_volume_render",
        "TEXTURE_PT_image",
        "RENDER_PT_freestyle",
        "VIEWLAYER_PT_freestyle",
        "MATERIAL_PT_freestyle_line",
    ):
        assert hasattr(bpy.types, name) and name in enabled, name
    for name in ("DATA_PT_light", "VIEWLAYER_PT_eevee_layer_passes_data"):
        assert name not in enabled
    assert not {name for name in enabled if name.startswith(("CYCLES_", "RENDER_PT_eevee", "DATA_PT_lightprobe"))}


def test_the_last_render_is_listed_with_errors_first(scene):
    report = reports.begin("Scene", 7)
    report.warnings.append("object “Flat” is left out " * 5)
    report.errors.append("no camera")
    report.statistics["ViewLayer"] = {
        "seconds": {"total": 2.5, "render": 2.0, "tree": 0.5, "check": 0.001, "build": 0.5},
        "kernels": {"tier": "GENERAL", "why": "they are ready", "specialised_after": None, "compiled_for_next": False},
        "rays": {"total": 4_000_000},
        "device": {"alias": "cpu"},
        "invalid_samples": 3,
    }
    panel = last_render.RAYBATCH_RENDER_PT_last_render
    labels = [(text, icon) for _, text, icon in drawn(panel, context_of(scene))]
    assert labels[0][0] == "Scene, frame 7"
    assert "2.50 s on cpu, 2.00 Mrays/s" in labels[1][0]
    assert labels[2][0] == "Seconds: tree 0.50, render 2.00"
    assert labels[3][0] == "Kernels: general ones; they are ready"
    assert "3 samples" in labels[4][0] and labels[5] == ("as black", "NONE")
    assert labels[6] == ("no camera", "ERROR")
    assert labels[7][1] == "INFO" and labels[8][1] == "BLANK1", "long texts are broken into lines"
    assert drawn(panel, context_of(scene), "draw_header")[0][2] == "ERROR"


def test_the_last_render_shows_the_tree_and_the_counts(scene):
    """Statistics of a real render, so that they are those that the panel expects."""
    sessions.close_all()  # whatever tests rendered before, the tree is built here
    add_grid("Grid", 40)
    scene.raybatch.counters = "ON"
    bpy.ops.render.render()
    lines = last_render.report_lines(reports.last())
    assert len(lines) == 6
    assert re.fullmatch(r"Seconds: \w+ \d+\.\d\d(, \w+ \d+\.\d\d)*", lines[1])
    assert re.fullmatch(r"Kernels: (general|specialised) ones; .+", lines[2])
    assert re.fullmatch(r"Tree: 3,200 triangles, \d+ nodes, 0\.\d MB, built in \d+\.\d\d s", lines[3])
    assert re.fullmatch(r"\d+\.\d node steps, \d+\.\d triangle tests a ray", lines[4])
    assert re.fullmatch(r"Time: \w+ \d+ %(, \w+ \d+ %)*", lines[5]) and "trace" in lines[5]
    labels = [text for _, text, _ in drawn(last_render.RAYBATCH_RENDER_PT_last_render, context_of(scene))]
    width = free_width(context_of(scene))
    assert all(label_width(text) <= width for text in labels), "lines are broken where the panel ends"
    scene.raybatch.counters = "OFF"
    bpy.ops.render.render()
    lines = last_render.report_lines(reports.last())
    assert len(lines) == 4 and lines[3].endswith(" MB, kept")
    scene.raybatch.batching = "REFERENCE"
    bpy.ops.render.render()
    assert len(last_render.report_lines(reports.last())) == 3


def test_the_last_render_shows_geometry_beyond_memory(scene):
    """Statistics of a real render here too: they have other names."""
    add_grid("Grid", 60)
    scene.raybatch.geometry_budget = "200K"
    bpy.ops.render.render()
    report = reports.last()
    assert report.errors == []
    lines = last_render.report_lines(report)
    (tree,) = (line for line in lines if line.startswith("Tree: "))
    assert re.fullmatch(r"Tree: 7,20\d triangles, 0\.\d MB in \d+ pages, (found again|written in .* s)", tree)
    assert any("brought there: " in each for each in lines)
    assert drawn(last_render.RAYBATCH_RENDER_PT_last_render, context_of(scene))


def test_the_preferences_show_how_far_general_kernels_are(addon, monkeypatch):
    monkeypatch.setattr(general_kernels, "_process", SimpleNamespace(is_running=True, progress=(37, 79)))
    layout = Layout()
    own = preferences.RayBatchPreferences
    own.draw(SimpleNamespace(layout=layout, bl_rna=own.bl_rna), None)
    assert "37 of 79 ready" in layout.notes[0][1]
    assert layout.notes[1][1] == preferences.RAYBATCH_OT_compile_general_kernels.bl_idname


def test_kernels_that_others_took_over_from_are_reported():
    kernels = {"tier": "GENERAL", "why": "they are ready", "specialised_after": 12.34, "compiled_for_next": False}
    assert last_render._kernels_line(kernels) == "Kernels: general ones, and after 12.3 s specialised ones"
    kernels |= {"specialised_after": None, "compiled_for_next": True}
    assert last_render._kernels_line(kernels) == (
        "Kernels: general ones; they are ready; specialised ones are compiled for the next render"
    )


def test_work_on_trees_in_words():
    tree = {
        "triangles": 1_234_567,
        "nodes": 210_345,
        "bytes": 96_400_000,
        "trees": 4,
        "built": 1,
        "refitted": 2,
        "seconds": 0.5,
    }
    lines = {1: "built in 0.50 s", 4: "1 built, 2 refitted in 0.50 s"}
    assert last_render._tree_lines(tree) == [f"Tree: 1.2 M triangles, 210 k nodes, 96.4 MB, {lines[4]}"]
    assert last_render._tree_lines({**tree, "trees": 1, "refitted": 0})[0].endswith(lines[1])
    uncounted = {
        "rays": {"closest": [3]},
        "node_steps": "unavailable",
        "triangle_tests": "unavailable",
        "seconds": {"trace": 3.0, "sort": 0.0, "film": 1.0},
    }
    assert last_render._counter_lines(uncounted) == ["Time: trace 75 %, film 25 %"]


def test_cost_passes_are_kept_in_the_file(scene, tmp_path):
    scene.view_layers[0].raybatch.use_pass_rays = True
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    own = bpy.context.scene.view_layers[0].raybatch
    assert own.use_pass_rays and not own.use_pass_node_steps
    for prop in own.bl_rna.properties:
        if prop.identifier not in ("name", "rna_type", "use_pass_sample_count"):
            assert "mean over the samples" in prop.description


def test_there_is_no_list_before_the_first_render(scene):
    reports.clear()
    assert not last_render.RAYBATCH_RENDER_PT_last_render.poll(context_of(scene))


def test_unregistering_removes_everything_and_registering_brings_it_back(addon):
    before = enabled_panels()
    addon.unregister()
    try:
        assert not enabled_panels() - {panel.__name__ for panel in own_panels()}
        assert not [panel for panel in own_panels() if panel.is_registered]
        assert not hasattr(bpy.types.Scene, "raybatch") and not hasattr(bpy.types.ViewLayer, "raybatch")
        assert builtin_panels._added == []
        assert not [name for name in dir(bpy.types) if "raybatch" in name.lower()]
        handlers = [each for each in vars(type(bpy.app.handlers)) if isinstance(getattr(bpy.app.handlers, each), list)]
        assert "load_post" in handlers
        assert not [
            call
            for each in handlers
            for call in getattr(bpy.app.handlers, each)
            if call.__module__.startswith("raybatch_addon")
        ]
    finally:
        addon.register()
    assert enabled_panels() == before
    bpy.context.scene.render.engine = ENGINE
    assert hasattr(bpy.context.scene, "raybatch")


def test_unregistering_gives_back_what_renders_keep(addon, monkeypatch):
    from raybatch_addon.export.images import images

    given_back = []
    monkeypatch.setattr(sessions, "close_all", lambda: given_back.append("sessions"))
    monkeypatch.setattr(images, "forget_images", lambda: given_back.append("images"))
    try:
        addon.unregister()
    finally:
        addon.register()
    assert given_back == ["sessions", "images"]
