"""Volumes whose programs give the same everywhere in an object: light in them is that of constant coefficients."""

import dataclasses

import numpy as np
import pytest

import raybatch_addon.core.programs.ops  # noqa: F401  (ops register themselves)
from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.uniform import is_uniform
from raybatch_addon.core.scene.description import Frame, Volume
from tests.renders.volumes.test_volumes import filled, in_box, medium, picture
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def by_color(scattering=0.0) -> Volume:
    """It absorbs the object's colour per metre, and scatters `scattering`."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("object_info")[0])
    builder.closure("volume_henyey_greenstein", Value.of((scattering, scattering, scattering)), 0.0)
    return Volume(program=builder.finish())


def colored(scene, *colors):
    """`scene` with objects of these colours."""
    info = np.zeros((len(scene.instances), 6), np.float32)
    info[:, :3] = colors
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, info=info))


def test_each_object_absorbs_by_its_own_color(session):
    """Two cubes of one material, one behind the other: Beer's law, without noise."""
    boxes = [(scenes.box(), scenes.translation(0, y, 0), filled(by_color())) for y in (0, 3)]
    view = scenes.camera(eye=(0, -4, 0), half_width=0.01)
    colors = np.array([(0.2, 0.5, 1.0), (0.7, 0.1, 0.3)])
    scene = colored(scenes.scene(boxes, world=1.0, frame=Frame(8, 8), view=view, lights=[scenes.sun(0.0)]), *colors)
    found = picture(session, scene, sample_count=1)[4, 4]
    np.testing.assert_allclose(found, np.exp(-2 * colors.sum(0)), rtol=3e-6)


def test_films_are_those_of_constants(session):
    """Light is scattered, aimed at and passed on by the same random numbers."""
    view = scenes.camera(eye=(0, -4, 0), half_width=0.3)
    expected = picture(session, in_box(medium((0.2, 0.5, 1.0), 0.5), view, 0.3, lamp=3.0))
    found = picture(session, colored(in_box(by_color(0.5), view, 0.3, lamp=3.0), (0.2, 0.5, 1.0)))
    assert np.array_equal(found, expected)


def test_beside_a_volume_that_varies(session):
    """Programs that vary make flights of all of them: the same light, with noise."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("position", 0))
    dark = Volume(program=builder.finish())
    boxes = [
        (scenes.box(), scenes.IDENTITY, filled(by_color())),
        (scenes.box("beside"), scenes.translation(9, 0, 0), filled(dark)),
    ]
    view = scenes.camera(eye=(0, -4, 0), half_width=0.01)
    scene = scenes.scene(boxes, world=1.0, frame=Frame(16, 16), view=view, lights=[scenes.sun(0.0)])
    found = picture(session, colored(scene, (0.2, 0.5, 1.0)), sample_count=64)
    error = found.std((0, 1), ddof=1) / 16
    assert np.all(error > 0) and np.all(np.abs(found.mean((0, 1)) - np.exp([-0.4, -1.0, -2.0])) < 5 * error)


def test_ops_that_read_no_more_than_the_object_are_uniform():
    assert is_uniform(("object_info", "object_location", "object_attribute", "math", "color_ramp", "noise_3d"))
    read = ("position", "object_coordinates", "generated", "volume_attribute", "volume_attribute_cubic", "light_path")
    for name in (*read, "attribute"):
        assert not is_uniform(("math", name)), name


def test_coefficients_whose_sum_is_beyond_float32_let_nothing_pass(session):
    """They scatter too, and no sample is lost."""
    builder = ProgramBuilder()
    for name, more in (("volume_absorption", ()), ("volume_absorption", ()), ("volume_henyey_greenstein", (0.0,))):
        builder.closure(name, builder.value("object_info")[0], *more)
    view = scenes.camera(eye=(0, -4, 0), half_width=0.01)
    found = picture(session, colored(in_box(Volume(program=builder.finish()), view, lamp=1.0), (3e38, 3e38, 3e38)))
    assert found.min() >= 0 and found.max() < 1
