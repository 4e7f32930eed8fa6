"""The passes that Blender asks for are those that the core has."""

import pytest

pytest.importorskip("bpy")

from raybatch_addon.core.film import PASSES as film_passes
from raybatch_addon.core.film.layout import COST_PASSES
from raybatch_addon.core.scene.passes import AOV_COLOR, AOV_VALUE, GUIDE_PASSES, LIGHT_GROUP, MATTE_KINDS, letters_of
from raybatch_addon.export import passes as asked


def test_passes_of_the_panel_are_those_of_the_film():
    names = {*(asked.PASS_PROPERTIES | asked.LIGHT_PASS_PROPERTIES | asked.OWN_PASS_PROPERTIES).values()}
    names |= {f"{kind}{level:02}" for kind in asked.MATTE_PROPERTIES.values() for level in range(8)}
    names |= {"Combined", *asked.DENOISING_PASSES, *asked.VOLUME_PASS_PROPERTIES.values()}
    names |= {asked.CATCHER_PASS, asked.CATCHER_SHADOWS}
    assert names == set(film_passes)
    assert tuple(asked.COST_PASS_PROPERTIES.values()) == COST_PASSES
    assert {name: len(letters_of(name)) for name in film_passes} == film_passes


def test_names_and_beginnings_are_the_core_s():
    """The exporter has its own, as it must not import the core where the add-on is registered."""
    assert asked.DENOISING_PASSES == GUIDE_PASSES
    assert asked.LIGHT_GROUP == LIGHT_GROUP
    assert asked.AOV_BEGINNINGS == {"COLOR": AOV_COLOR, "VALUE": AOV_VALUE}
    assert tuple(asked.MATTE_PROPERTIES.values()) == MATTE_KINDS
    assert set(asked._EARLIER_NAMES) - {"Volume Color"} < set(film_passes)
