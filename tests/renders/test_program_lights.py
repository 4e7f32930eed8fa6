"""What programs of lights get to know of the path that aims at them."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import (
    Closure,
    ClosureKind,
    Frame,
    Light,
    LightKind,
    Material,
    Visibility,
    World,
)
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")
LIGHT_PATH = ("camera", "shadow", "diffuse", "glossy", "reflection", "transmission", "length", "depth", "passed")


def emission_of(output: str):
    """A program whose radiance is an output of Light Path."""
    builder = ProgramBuilder()
    value = builder.value("light_path")[LIGHT_PATH.index(output)]
    builder.closure("emission", builder.value("combine_xyz", value, value, value))
    return builder.finish()


def under_a_world_of(output: str, *closures: Closure):
    """A floor that fills the picture under a world whose radiance is an output of Light Path."""
    view = scenes.camera(eye=(0.0, -1.0, 2.0), half_width=0.1)
    floor = (scenes.plane(size=50.0), scenes.IDENTITY, scenes.material(*closures))
    return dataclasses.replace(
        scenes.scene([floor], view=view, frame=Frame(16, 16)), world=World(program=emission_of(output))
    )


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


def test_rays_into_the_world_are_longer_than_any_other(session):
    builder = ProgramBuilder()
    length = builder.value("light_path")[LIGHT_PATH.index("length")]
    far = builder.value("math", MathOperation.GREATER_THAN, 0, length, 1e30, 0.0)
    builder.closure("emission", builder.value("combine_xyz", far, far, far))
    scene = dataclasses.replace(
        under_a_world_of("length", Closure(ClosureKind.DIFFUSE, (1.0,) * 3)), world=World(program=builder.finish())
    )
    assert mean(session, scene, sample_count=64) == pytest.approx(1, rel=0.01)


def test_worlds_meshes_and_lamps_may_all_have_programs(session):
    """Together they light as much as one after the other."""
    above = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2]], np.float32)
    floor = (scenes.plane(size=50.0), scenes.IDENTITY, scenes.diffuse(1.0))
    glow = Material("glow", (), (ClosureKind.EMISSION,), emission_of("depth"))
    lamp = Light("lamp", LightKind.POINT, scenes.translation(0.5, 0.2, 1.0), (2.0,) * 3, program=emission_of("depth"))
    world = World(program=emission_of("depth"))
    view = scenes.camera(eye=(0.0, -1.0, 0.5), half_width=0.1)

    def light(mesh: bool, lamps: bool, sky: bool) -> float:
        panel = (scenes.plane("panel", 0.5), above, glow if mesh else scenes.material())
        made = scenes.scene([floor, panel], view=view, frame=Frame(16, 16), lights=[lamp] if lamps else ())
        return mean(session, dataclasses.replace(made, world=world if sky else World()), sample_count=4096)

    assert light(True, True, True) == pytest.approx(
        light(True, False, False) + light(False, True, False) + light(False, False, True), rel=0.005
    )


def veil(height: float):
    return (
        scenes.plane("veil", 50.0),
        scenes.translation(0, 0, height),
        scenes.material(Closure(ClosureKind.TRANSPARENT, (1.0,) * 3)),
    )


def test_light_knows_what_its_path_has_passed(session):
    view = scenes.camera(eye=(0.0, -1.0, 2.0), half_width=0.1)
    floor = (scenes.plane(size=50.0), scenes.IDENTITY, scenes.diffuse(1.0))
    scene = scenes.scene([floor, veil(1.0)], view=view, frame=Frame(16, 16))
    scene = dataclasses.replace(scene, world=World(program=emission_of("passed")))
    # the camera's ray has passed the veil once; light that is aimed at is not told of the second time, as in Cycles
    assert 1 < mean(session, scene, sample_count=64) < 2
    aimed_at = dataclasses.replace(
        scene, world=dataclasses.replace(scene.world, visibility=Visibility.ALL & ~Visibility.GLOSSY)
    )
    assert mean(session, aimed_at, sample_count=64) == pytest.approx(1, rel=0.02)


def under_a_lamp(lamp: Material, size: float, *veils):
    """A white floor seen from near under a lamp two metres above."""
    above = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2]], np.float32)
    objects = [
        (scenes.plane(size=50.0), scenes.IDENTITY, scenes.diffuse(1.0)),
        (scenes.plane("lamp", size), above, lamp),
        *veils,
    ]
    return scenes.scene(objects, view=scenes.camera(eye=(0.0, -1.0, 0.5), half_width=0.1), frame=Frame(16, 16))


LAMPS = {"even": scenes.emitter(), "length": Material("lamp", (), (ClosureKind.EMISSION,), emission_of("length"))}


@pytest.mark.parametrize("lamp", LAMPS.values(), ids=LAMPS.keys())
def test_surfaces_that_let_all_light_pass_change_nothing(session, lamp):
    """Neither how much light comes from a lamp that rays are aimed at, nor how long it is told that they are."""
    plain = mean(session, under_a_lamp(lamp, 0.5), sample_count=64)
    veils = [veil(height) for height in (0.9, 1.0, 1.5, 1.7)]
    assert plain > 0 and mean(session, under_a_lamp(lamp, 0.5, *veils), sample_count=64) == pytest.approx(
        plain, rel=1e-3
    )


def test_what_only_mirrors_see_is_no_light_to_aim_at(session):
    """Nobody who aims at it sees it, so no triangle is in the table of lights; diffuse surfaces of any roughness meet
    it all the same.
    """
    lamp = Material("lamp", (), (ClosureKind.EMISSION,), emission_of("reflection"))
    assert mean(session, under_a_lamp(lamp, 500.0), sample_count=16) == pytest.approx(1, rel=0.02)


def below_a_plane_that_shines(output: str, aimed: bool):
    """A floor that fills the picture, below a large plane whose radiance is 1 less an output of Light Path.

    `aimed`: whether light is aimed at the plane.
    """
    builder = ProgramBuilder()
    value = builder.value("light_path")[LIGHT_PATH.index(output)]
    radiance = builder.value("math", int(MathOperation.SUBTRACT), False, 1.0, value, 0.0)
    builder.closure("emission", builder.value("combine_xyz", radiance, radiance, radiance))
    shining = Material("shining", kinds=(ClosureKind.EMISSION,), program=builder.finish(), aimed=aimed)
    floor = scenes.plane(size=50.0), scenes.IDENTITY, scenes.material(Closure(ClosureKind.DIFFUSE, (1.0,) * 3))
    above = scenes.plane(size=400.0), scenes.translation(0, 0, 3), shining
    view = scenes.camera(eye=(0.0, -1.0, 2.0), half_width=0.1)
    return scenes.scene([floor, above], view=view, frame=Frame(16, 16))


def test_what_light_is_not_aimed_at_shines_as_the_rays_that_meet_it_say(session):
    # a ray that meets the plane is one of diffuse reflection; where light is aimed at the plane there is no such ray
    aimed_at, left = (below_a_plane_that_shines("diffuse", aimed) for aimed in (True, False))
    assert mean(session, aimed_at, sample_count=64, mis="OFF") > 0.5
    assert mean(session, left, sample_count=64) == 0


@pytest.mark.parametrize("mis", ["ON", "OFF"])
def test_what_light_is_not_aimed_at_shines_as_bright(session, mis):
    assert mean(session, below_a_plane_that_shines("camera", False), sample_count=64, mis=mis) == pytest.approx(1, 0.01)
