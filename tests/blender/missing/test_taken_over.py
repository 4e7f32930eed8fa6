"""Settings of Cycles and EEVEE as ours."""

import sys

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import missing
from raybatch_addon.core.scene.notice import Notice
from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.export.materials import export_material
from raybatch_addon.export.nodes.collections import Collections
from raybatch_addon.export.settings import settings_from
from raybatch_addon.export.taken_over import take
from raybatch_addon.export.taken_over.rows import CYCLES, EEVEE, ROWS
from raybatch_addon.export.taken_over.take import Difference, differences, passed_over_settings, take_over
from raybatch_addon.ui.before_render.panel import RAYBATCH_RENDER_PT_before_render, RAYBATCH_RENDER_PT_settings_from
from tests.support.panel_layout import context_of, drawn


@pytest.mark.parametrize("engine", [CYCLES, EEVEE])
def test_every_row_names_a_setting_and_a_property(scene, engine):
    for row in ROWS[engine]:
        assert row.setting in SETTINGS and row.value(scene) is not None
    assert len({row.setting for row in ROWS[engine]}) == len(ROWS[engine])


def test_what_differs_is_reported_and_taken_over(scene):
    own = scene.cycles
    own.samples, own.max_bounces, own.sample_clamp_indirect, own.adaptive_threshold = 123, 3, 2.5, 0.02
    own.pixel_filter_type, own.filter_width = "GAUSSIAN", 1.75
    reported = {each.setting: each.theirs for each in differences(scene, CYCLES)}
    assert reported["sample_count"] == 123 and reported["clamp_indirect"] == 2.5
    assert take_over(scene, CYCLES) and not differences(scene, CYCLES)
    settings = settings_from(scene)
    assert (settings.sample_count, settings.bounce_max, settings.clamp_indirect) == (123, 3, 2.5)
    assert (settings.noise_threshold, settings.pixel_filter, settings.filter_width) == (0.02, "GAUSSIAN", 1.75)


def test_exposure_brightens_what_blender_shows(scene, tmp_path):
    scene.world = bpy.data.worlds.new("Sky")
    scene.world.use_nodes = True  # before Blender 5 a choice
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.25, 0.5, 1.0, 1.0)
    scene.cycles.film_exposure, scene.cycles.use_denoising = 2.5, False
    assert [each.setting for each in differences(scene, CYCLES, chosen=True)] == ["exposure"]
    take_over(scene, CYCLES)
    scene.raybatch.sample_count = 1
    image = scene.render.image_settings
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(tmp_path / "picture")
    bpy.ops.render.render(write_still=True)
    (written,) = tmp_path.iterdir()
    loaded = bpy.data.images.load(str(written))
    loaded.colorspace_settings.name = "Non-Color"
    assert tuple(loaded.pixels[:3]) == (0.625, 1.25, 2.5)


def test_a_setting_that_cannot_be_read_is_reported_where_settings_are_compared(scene):
    scene.raybatch.geometry_budget = "abc"
    notes = drawn(RAYBATCH_RENDER_PT_settings_from, context_of(scene))
    assert any("geometry_budget" in note[1] and note[2] == "ERROR" for note in notes)
    with pytest.raises(RuntimeError, match="geometry_budget"):
        bpy.ops.raybatch.settings_from(engine="CYCLES")


def test_another_output_is_a_difference(scene):
    take_over(scene, CYCLES)
    scene.raybatch_export.material_output = EEVEE
    (change,) = take_over(scene, CYCLES)
    assert change.taken(CYCLES) == "Material Output: Cycles, as in Cycles (before: EEVEE)"


def test_limits_by_kind_count_as_far_as_that_of_all(scene):
    scene.cycles.max_bounces = scene.raybatch.bounce_max = 4
    scene.cycles.diffuse_bounces = 6
    assert "diffuse_bounce_max" not in {each.setting for each in differences(scene, CYCLES)}
    scene.cycles.diffuse_bounces = 3
    assert "diffuse_bounce_max" in {each.setting for each in differences(scene, CYCLES)}


def test_values_out_of_our_range_become_its_ends(scene):
    scene.cycles.transparent_max_bounces = 1024
    scene.cycles.adaptive_threshold, scene.cycles.samples = 0, 4096
    take_over(scene, CYCLES)
    assert settings_from(scene).transparent_bounce_max == 1024 and settings_from(scene).noise_threshold == 0.001


@pytest.mark.parametrize(("samples", "threshold"), [(16, 1 / 16), (4096, 0.001)])
def test_a_threshold_of_0_is_one_by_the_samples_in_cycles(scene, samples, threshold):
    scene.cycles.samples, scene.cycles.adaptive_threshold = samples, 0
    take_over(scene, CYCLES)
    assert settings_from(scene).noise_threshold == pytest.approx(threshold)


def test_our_own_exposure_is_no_setting_of_cycles(scene):
    scene.raybatch_export.exposure = 2
    assert passed_over_settings(scene) == []
    scene.cycles.film_exposure = 3
    assert "Exposure: 3 in Cycles, 2 here" in passed_over_settings(scene)[0]


def test_the_button_takes_over_and_eevee_brings_its_outputs(scene):
    scene.eevee.taa_render_samples = 33
    assert bpy.ops.raybatch.settings_from(engine="EEVEE") == {"FINISHED"}
    assert settings_from(scene).sample_count == 33 and scene.raybatch_export.material_output == "EEVEE"


@pytest.mark.parametrize(("engine", "color"), [(CYCLES, (1.0, 0.0, 0.0)), (EEVEE, (0.0, 1.0, 0.0))])
def test_the_output_of_the_engine_counts(scene, engine, color):
    material = bpy.data.materials.new("Both")
    material.use_nodes = True  # before Blender 5 a choice
    tree = material.node_tree
    tree.nodes.clear()
    for target, shown in ((CYCLES, (1, 0, 0, 1)), (EEVEE, (0, 1, 0, 1))):
        output, diffuse = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        output.target = target
        diffuse.inputs["Color"].default_value = shown
        tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    collections = Collections()
    collections.engine = engine
    exported, _ = export_material(material, collections)
    assert exported.closures[0].weight == color


def test_numbers_that_set_no_limit_are_reported_as_no_limit():
    text = Difference("glossy_bounce_max", 4, SETTINGS["glossy_bounce_max"].off).text("CYCLES")
    assert text == "Max Bounces, Glossy: 4 in Cycles, no limit here"
    text = Difference("pixel_filter", "BLACKMAN_HARRIS", "BOX").text("CYCLES")
    assert text == "Pixel Filter: Blackman-Harris in Cycles, Box here"
    assert Difference("time_limit", 0.0, 5.0).text("CYCLES") == "Time Limit: no limit in Cycles, 5 here"
    assert Difference("exposure", 2.0, 1.0).text("CYCLES") == "Exposure: 2 in Cycles, 1 here"


def test_denoising_is_taken_over_with_what_guides_it(scene):
    own, ours = scene.cycles, scene.raybatch
    own.denoising_input_passes, own.denoising_prefilter, own.denoising_quality = "RGB_ALBEDO", "FAST", "BALANCED"
    texts = [each.text(CYCLES) for each in differences(scene, CYCLES) if each.setting.startswith("denoise")]
    assert texts == [
        "Denoise: On in Cycles, Off here",
        "Passes: Albedo in Cycles, Albedo, Normal here",
        "Prefilter: Fast in Cycles, Accurate here",
        "Quality: Balanced in Cycles, High here",
    ]
    take_over(scene, CYCLES)
    assert (ours.denoise, ours.denoise_inputs, ours.denoise_prefilter) == ("ON", "ALBEDO", "FAST")
    own.use_denoising = False
    own.denoising_input_passes = "RGB"
    assert [each.setting for each in differences(scene, CYCLES)] == ["denoise"], "the passes guide nothing"
    take_over(scene, CYCLES)
    assert ours.denoise == "OFF"


def test_denoising_is_not_taken_over_where_its_library_is_missing(scene, tmp_path):
    scene.raybatch.denoise_library = str(tmp_path / "nowhere.so")
    assert "denoise" not in {each.setting for each in differences(scene, CYCLES)}
    take_over(scene, CYCLES)
    assert settings_from(scene).denoise == "OFF"


def test_denoising_of_view_layers_counts_as_a_whole(scene):
    second = scene.view_layers.new("Second")
    second.cycles.use_denoising = False
    take_over(scene, CYCLES)
    assert scene.raybatch.denoise == "ON"
    scene.view_layers[0].cycles.use_denoising = False
    take_over(scene, CYCLES)
    assert scene.raybatch.denoise == "OFF"


def test_nothing_to_do_in_a_panel_is_on_a_command_line(scene, capsys):
    scene.cycles.max_bounces, scene.cycles.use_denoising = 3, False
    (notice,) = passed_over_settings(scene)
    assert notice.remedy.endswith("Before the Render > Settings of Other Engines > Settings From Cycles")
    bpy.ops.raybatch.check_scene()
    notes = drawn(RAYBATCH_RENDER_PT_before_render, context_of(scene))
    texts = " ".join(note[1] for note in notes if note[0] == "label")
    assert "To do: take them over" in texts and "--" not in texts and ".py" not in texts
    missing.print_notices([notice])
    assert capsys.readouterr().err.rstrip().endswith("Settings From Cycles, or -- --raybatch-settings-from cycles)")


def test_what_a_command_line_gives_is_not_reported(scene, monkeypatch):
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 123, 3, False
    titles = [SETTINGS[name].title for name in ("sample_count", "bounce_max")]

    def reported():
        text = " ".join(passed_over_settings(scene))
        return [f"{title}: " in text for title in titles]

    assert reported() == [True, True]
    monkeypatch.setattr(take, "of_command", {"sample_count"})
    assert reported() == [False, True]
    monkeypatch.setattr(take, "of_command", set())
    monkeypatch.setattr(sys, "argv", ["blender", "-b", "--", "--raybatch-set", "bounce_max=9"])
    assert reported() == [True, False]


def test_frames_of_one_render_say_once_what_they_lack(monkeypatch, capsys):
    monkeypatch.setattr(missing, "_printed", set())

    def printed(job, *texts):
        missing.print_new_notices([Notice(text) for text in texts], job)
        return [line.rpartition(": ")[2] for line in capsys.readouterr().err.splitlines()]

    assert printed(1001, "one", "two") == ["one", "two"]
    assert printed(1001, "two", "three") == ["three"]
    assert printed(1002, "two") == ["two"]
