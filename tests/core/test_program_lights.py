"""What programs of lights are told of the path that aims at them."""

import dataclasses

import pytest
import scenes

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, World
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.shading import nodes  # noqa: F401  (registers ops)
from raybatch_addon.core.shading.nodes.builder import ProgramBuilder

LIGHT_PATH = ("camera", "shadow", "diffuse", "glossy", "reflection", "transmission", "length", "depth", "passed")


def under_a_world_of(output: str, *closures: Closure):
    """A floor that fills the picture under a world whose radiance is an output of Light Path."""
    builder = ProgramBuilder()
    value = builder.value("light_path")[LIGHT_PATH.index(output)]
    builder.closure("emission", builder.value("combine_xyz", value, value, value))
    view = scenes.camera(eye=(0.0, -1.0, 2.0), half_width=0.1)
    floor = (scenes.plane(size=50.0), scenes.IDENTITY, scenes.material(*closures))
    return dataclasses.replace(scenes.scene([floor], view=view, frame=Frame(16, 16)), world=World(program=builder.finish()))


def mean(session, scene, **settings) -> float:
    film = session.render(scene, RenderSettings(bounce_max=1, **settings))
    assert film.statistics["invalid_samples"] == 0
    return float(film.passes["Combined"][..., :3].mean())


def test_light_is_one_scattering_further_than_what_it_lights(session):
    half = (0.5, 0.5, 0.5)
    veil = Closure(ClosureKind.DIFFUSE, half), Closure(ClosureKind.TRANSPARENT, half)
    # what passes straight on sees the world after no scattering: black
    assert mean(session, under_a_world_of("depth", *veil), sample_count=256) == pytest.approx(0.5, rel=0.01)


def test_light_of_programs_over_one_scattering_is_direct(session):
    scene = under_a_world_of("depth", Closure(ClosureKind.DIFFUSE, (1.0,) * 3))
    assert mean(session, scene, sample_count=64, clamp_indirect=0.01) == pytest.approx(1, rel=0.02)
    assert mean(session, scene, sample_count=64, clamp_direct=0.01) < 0.021  # what is aimed at and what is met
