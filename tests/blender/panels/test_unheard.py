"""What has no say is grey, with the reason below it; what is not heard of Cycles is not offered."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from raybatch_addon.export.settings import assign_setting, settings_from
from raybatch_addon.ui import panel as ui_panel
from raybatch_addon.ui import render_panels, viewport
from raybatch_addon.ui.heard import why_unheard
from tests.support.blender_builders import material_of
from tests.support.panel_layout import context_of, drawn, layout_of, own_panels

# Settings that are ruled by others: values of these, and what is said of each then
RULED = [
    ({"adaptive_sampling": "OFF"}, ("noise_threshold", "adaptive_samples_min"), "Unused with Adaptive Sampling off"),
    ({"adaptive_sampling": "ON"}, ("error_estimate",), "Implied by Adaptive Sampling"),
    ({"error_target": 0.5}, ("error_estimate",), "Implied by Stop at Error"),
    ({"nee": "OFF"}, ("mis",), "Unused with Light Sampling off"),
    ({"pixel_filter": "BOX"}, ("filter_width",), "Unused with Pixel Filter Box"),
    ({"texture_filter": "OFF"}, ("texture_filter_width",), "Unused with Texture Filter off"),
    ({"denoise": "OFF"}, ("denoise_inputs", "denoise_prefilter", "denoise_quality"), "Unused with Denoise off"),
    ({"denoise": "ON", "denoise_inputs": "NONE"}, ("denoise_prefilter",), "Unused with Passes Color"),
    ({"batching": "OFF"}, ("bucket_selection", "queue_size", "treelet_size"), "Unused with Batching off"),
    ({"batching": "REFERENCE"}, ("geometry_budget", "geometry_store"), "Unused with Batching Reference"),
    ({"treelet_cache": 2**20}, ("queues_per_ray", "treelet_tier_bytes"), "Unused with Cached"),
    ({"treelet_tier_bytes": 2**20}, ("queues_per_ray",), "Unused with Tier Size"),
    ({"top_level_traversal": "SHORT_SEGMENT"}, ("queues_per_ray",), "Unused with Top Level Short Segment"),
    ({"queues_per_ray": 2}, ("ray_storage",), "Unused with Queues a Ray 2"),
    ({"device": "cpu"}, ("top_level_traversal", "register_cap", "block_size"), "Unused on the CPU"),
    ({"device": "cuda:0, cuda:1"}, ("thread_count",), "Unused without the CPU"),
]


@pytest.fixture(autouse=True)
def with_library(monkeypatch):
    """As where Blender has Open Image Denoise."""
    for panels in (render_panels, viewport):
        monkeypatch.setattr(panels, "why_not", lambda _library: "")


def panel_of(name):
    return next(panel for panel in own_panels() if panel.__name__ == name)


@pytest.mark.parametrize("values, names, why", RULED)
def test_a_setting_without_a_say_is_grey_and_the_reason_names_what_rules_it(scene, values, names, why):
    for name, value in values.items():
        assign_setting(scene.raybatch, name, value)
    for name in names:
        assert why_unheard(scene.raybatch, name) == why == why_unheard(settings_from(scene), name)
        layout = layout_of(panel_of(render_panels._panel_name(SETTINGS[name].group)), context_of(scene))
        assert any(each.startswith(name) for each in layout.unheard)
        assert why in " ".join(layout.whys)


def test_what_has_a_say_is_not_grey(scene):
    own = scene.raybatch
    own.adaptive_sampling, own.denoise, own.texture_filter, own.device = "ON", "ON", "FOOTPRINT", "AUTO"
    own.bucket_selection = "LAZY"
    assert [name for name in SETTINGS if why_unheard(own, name)] == ["error_estimate"]
    own.device = "cpu, cuda:0"
    assert not any(why_unheard(own, name) for name in ("register_cap", "thread_count", "top_level_traversal"))
    own.adaptive_sampling = "OFF"
    assert why_unheard(own, "error_estimate") == ""
    assert why_unheard(RenderSettings(denoise="ON", denoise_inputs="NONE"), "denoise_quality") == ""


def test_a_reason_is_said_once_below_all_that_it_holds_for(scene):
    scene.raybatch.batching = "OFF"
    notes = drawn(panel_of("RAYBATCH_RENDER_PT_queues"), context_of(scene))
    assert notes[-1][:2] == ("label", "Unused with Batching off")
    assert [note[0] for note in notes].count("label") == 1
    scene.raybatch.adaptive_sampling = "OFF"
    notes = drawn(panel_of("RAYBATCH_RENDER_PT_sampling"), context_of(scene))
    place = next(i for i, note in enumerate(notes) if note[:2] == ("label", "Unused with Adaptive Sampling off"))
    assert notes[place - 1][2].startswith("adaptive_samples_min") and notes[place + 1][2].startswith("time_limit")


def grey_panels(scene):
    """Each panel where something of it is grey: its name, and the context for it."""
    world, curves = bpy.data.worlds.new("World"), scene.cycles_curves
    light = bpy.data.lights.new("Light", "AREA")
    light.cycles.is_portal = True
    obj = bpy.data.objects.new("Object", bpy.data.meshes.new("Mesh"))
    scene.render.use_motion_blur, curves.shape, scene.render.film_transparent = False, "THICK", False
    scene.raybatch.error_estimate = "ON"
    context = context_of(scene, world=world, light=light, object=obj, material=None, camera=None)
    for method in ("AUTOMATIC", "NONE"):
        world.cycles.sampling_method = method
        yield "RAYBATCH_WORLD_PT_settings", context, {"NONE": "Unused with Sampling None"}.get(method, "Sampling Auto")
    yield "RAYBATCH_LIGHT_PT_settings", context, "Unused with Portal on"
    yield "RAYBATCH_RENDER_PT_curves", context, "Unused with Shape 3D Curves"
    yield "RAYBATCH_OBJECT_PT_motion_blur", context, "Unused with Motion Blur of the scene off"
    yield "RAYBATCH_RENDER_PT_film", context, "Unused with Transparent off"
    yield "RAYBATCH_RENDER_PT_convergence", context, "Implied by Error Estimate"


def test_what_is_grey_in_other_panels_has_its_reason_there(scene):
    for name, context, why in grey_panels(scene):
        layout = layout_of(panel_of(name), context)
        assert layout.unheard and why in " ".join(layout.whys), name


def has_switch(panel):
    """Whether its head has the switch of what is in it, or that of the panel that it lies in."""
    above = getattr(bpy.types, getattr(panel, "bl_parent_id", ""), panel)
    return any(hasattr(each, "draw_header") for each in (panel, above))


def test_no_panel_is_grey_without_a_reason(scene):
    """But for those whose switch is in their head."""
    contexts = [context for _, context, _ in grey_panels(scene)]
    for each in own_panels():
        for context in contexts:
            if not each.poll(context) or has_switch(each):
                continue
            layout = layout_of(each, context)
            assert bool(layout.unheard) == bool(layout.whys), each.__name__
            assert not layout.grey, each.__name__


def test_a_viewport_that_cannot_be_denoised_says_why(scene, monkeypatch):
    monkeypatch.setattr(viewport, "why_not", lambda _library: "the library is not there")
    for is_on in (False, True):
        scene.raybatch_viewport.denoise = is_on
        layout = layout_of(viewport.RAYBATCH_RENDER_PT_viewport, context_of(scene))
        assert ("denoise" in layout.grey) != is_on
        assert any(note[:2] == ("label", "the library is not there") for note in layout.notes)


def test_emission_sampling_is_offered_as_far_as_it_is_heard(scene):
    bpy.ops.mesh.primitive_cube_add()
    material = material_of(bpy.context.object)
    context = context_of(scene, material=material)
    tab = panel_of("RAYBATCH_MATERIAL_PT_settings")
    for chosen, word in (
        ("NONE", ""),
        ("AUTO", ""),
        ("FRONT_BACK", ""),
        ("FRONT", "Front alone"),
        ("BACK", "Back alone"),
    ):
        material.cycles.emission_sampling = chosen
        notes = drawn(tab, context)
        offered = [note[3] for note in notes if note[0] == "choice" and note[2] == "emission_sampling"]
        assert offered == ["NONE", "AUTO", "FRONT_BACK"]
        said = " ".join(note[1] for note in notes if note[0] == "label")
        assert (f"{word} is not heard" in said) == bool(word) and ("not heard" in said) == bool(word)


def test_simplify_is_offered_as_far_as_it_is_heard(scene):
    """Blender's own settings of it, which reach each engine, and not those of Cycles, which a notice names."""
    shown = []
    for each in own_panels():
        if each.__name__.startswith("RAYBATCH_RENDER_PT_simplify") and not each.__name__.endswith("greasepencil"):
            shown += [note[1:] for note in drawn(each, context_of(scene)) if note[0] == "prop"]
    assert {owner for owner, _ in shown} == {"RenderSettings"} and len(shown) >= 6


@pytest.mark.parametrize("name", ["tune", "render_in_new_slot"])
def test_a_button_is_grey_while_a_render_is_under_way_and_says_so(scene, monkeypatch, name):
    app = SimpleNamespace(is_job_running=lambda kind: kind == "RENDER")
    monkeypatch.setattr(ui_panel, "bpy", SimpleNamespace(app=app))
    with pytest.raises(RuntimeError, match="A render is under way"):
        getattr(bpy.ops.raybatch, name)()
