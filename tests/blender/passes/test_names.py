"""The passes that Blender asks for are those that the core has."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender.result import register_passes
from raybatch_addon.core.film import PASSES as film_passes
from raybatch_addon.core.film.layout import COST_PASSES
from raybatch_addon.core.scene.passes import CATCHER_PASS, CATCHER_SHADOWS, GUIDE_PASSES, MATTE_KINDS, letters_of
from raybatch_addon.export import passes as asked
from raybatch_addon.export.scene import export_scene


def test_passes_of_the_panel_are_those_of_the_film():
    names = {*(asked.PASS_PROPERTIES | asked.LIGHT_PASS_PROPERTIES | asked.OWN_PASS_PROPERTIES).values()}
    names |= {f"{kind}{level:02}" for kind in asked.MATTE_PROPERTIES.values() for level in range(8)}
    names |= {"Combined", *GUIDE_PASSES, *asked.VOLUME_PASS_PROPERTIES.values()}
    names |= {CATCHER_PASS, CATCHER_SHADOWS}
    assert names == set(film_passes)
    assert tuple(asked.COST_PASS_PROPERTIES.values()) == COST_PASSES
    assert {name: len(letters_of(name)) for name in film_passes} == film_passes


def test_kinds_of_mattes_and_earlier_names_are_those_of_the_core_s_passes():
    assert tuple(asked.MATTE_PROPERTIES.values()) == MATTE_KINDS
    assert set(asked._EARLIER_NAMES) - {"Volume Color"} < set(film_passes)


def test_passes_are_those_of_cycles_but_for_those_that_are_reported(scene):
    """With everything on that either can be asked for, of Cycles."""
    from cycles.engine import list_render_passes

    layer = scene.view_layers[0]
    scene.raybatch.denoise, scene.cycles.use_denoising = "ON", True
    for owner in (layer, layer.cycles):
        for prop in owner.bl_rna.properties:
            name = prop.identifier
            if name.startswith(("use_pass_", "pass_", "denoising_store")) and prop.type == "BOOLEAN":
                if name not in ("use_pass_cryptomatte_accurate", "use_pass_grease_pencil"):
                    setattr(owner, name, True)
    for kind, name in (("COLOR", "Tint"), ("VALUE", "Wear")):
        aov = layer.aovs.add()
        aov.type, aov.name = kind, name
    layer.lightgroups.add(name="Key")
    registered = []
    engine = SimpleNamespace(register_pass=lambda *given: registered.append((given[2], given[4], given[5])))
    register_passes(engine, scene, layer)
    of_cycles = set(list_render_passes(scene, layer))
    reported = {name for name, *_ in of_cycles - set(registered)}
    assert {name for name, *_ in set(registered) - of_cycles} <= reported, "no letters or kinds of our own"
    assert reported <= {
        "Render Time",
        "Volume Scatter",
        "Volume Transmit",
        "Volume Majorant",
        "Denoising Specular Albedo",
        "Denoising Roughness",
    }
    found = " ".join(export_scene(bpy.context.evaluated_depsgraph_get()).warnings)
    assert all(name in found for name in reported)
