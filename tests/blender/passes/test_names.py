"""The passes that Blender asks for are those that the core has."""

import pytest

pytest.importorskip("bpy")

from raybatch_addon.blender.result import PASSES as result_passes
from raybatch_addon.core.film import PASSES as film_passes
from raybatch_addon.core.film.layout import COST_PASSES
from raybatch_addon.export import passes as asked


def test_passes_of_the_panel_are_those_of_the_film():
    names = {*(asked.PASS_PROPERTIES | asked.LIGHT_PASS_PROPERTIES | asked.OWN_PASS_PROPERTIES).values()}
    names |= {f"{kind}{level:02}" for kind in asked.MATTE_PROPERTIES.values() for level in range(8)}
    names |= {"Combined", *asked.DENOISING_PASSES, *asked.VOLUME_PASS_PROPERTIES.values()}
    assert names == set(film_passes)
    assert tuple(asked.COST_PASS_PROPERTIES.values()) == COST_PASSES
    channels = {name: about[0] for name, about in result_passes.items()}
    assert channels == film_passes | {asked.NOISY_IMAGE: 4}, "a film has one picture; Blender's result keeps both"
