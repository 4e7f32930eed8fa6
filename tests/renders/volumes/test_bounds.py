"""Volumes of programs whose bounds are hard to find: without end, far too high, or different for each kind of ray."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.cameras import CameraKind
from raybatch_addon.core.scene.description import Frame, Volume
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import assert_mean, filled, in_box, medium, picture
from tests.stability.volume_scenes import in_grid
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def absorbing(density) -> Volume:
    """A volume that absorbs as much as `density(builder)` says."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("splat", density(builder)))
    return Volume(program=builder.finish())


def test_a_volume_that_only_some_rays_see(session):
    """A cube of 2 m that is dense for camera rays alone."""
    volume = absorbing(lambda builder: builder.value("light_path")[0])
    assert_mean(session, in_box(volume), np.exp(-2.0))


def test_fog_of_the_world_that_thins_out_has_an_end(session):
    """A ray straight up through fog that thins out with height comes back with what passes."""

    def density(builder):
        height = builder.value("separate_xyz", builder.value("volume_position", 0))[2]
        fallen = builder.value("math", 2, False, height, -0.5, 0.0)
        return builder.value("math", 2, False, builder.value("math", 10, False, fallen, 0.0, 0.0), 0.1, 0.0)

    view = scenes.camera(eye=(0, 0, 0), target=(0, 0, 10), up=(0, 1, 0), half_width=0.01)
    made = in_box(Volume(), view)
    made = dataclasses.replace(made, world=dataclasses.replace(made.world, volume=absorbing(density)))
    assert_mean(session, made, np.exp(-0.1 / 0.5))


def layers(density: float) -> Volume:
    """A volume of `density` where |x| is below 0.02 m, and nothing elsewhere in a cube of 2 m."""

    def made(builder):
        x = builder.value("separate_xyz", builder.value("position", 0))[0]
        near = builder.value("math", int(MathOperation.COMPARE), False, x, 0.0, 0.02)
        return builder.value("math", 2, False, near, density, 0.0)

    return absorbing(made)


def test_lamps_are_met_once_behind_more_flights_than_a_path_makes_at_a_time(session):
    """A ray beside a dense layer flies thousands of times through what its bound says, and meets nothing but a lamp."""
    view = scenes.camera(eye=(0.03, 0, -4), target=(0.03, 0, 0), up=(0, 1, 0), half_width=0.001)
    far, near = (in_box(layers(density), view, 0.0, lamp=1.0) for density in (2000.0, 0.0))
    few = dict(sample_count=4, bounce_max=0)
    clear = picture(session, near, **few)
    assert clear.min() > 0.5
    np.testing.assert_allclose(picture(session, far, **few), clear, rtol=1e-5)


def test_shadow_rays_fly_so_often_and_then_arrive(session):
    """A shadow ray through a bound of 100,000 flights, where nothing is, comes to its end with all of its light."""
    floor = scenes.plane(size=4), scenes.translation(0, 0, -1.5), scenes.diffuse(0.8)
    view = scenes.camera(eye=(0.03, -6, -1.4), target=(0.03, 0, -1.5), half_width=0.0001)
    found = []
    for density in (3e5, 0.0):
        boxed = scenes.box(), scenes.IDENTITY, filled(layers(density))
        made = scenes.scene([boxed, floor], world=0.0, frame=Frame(2, 2), view=view, lights=[scenes.sun(1.0)])
        made = dataclasses.replace(made, lights=(*made.lights, *in_box(medium(1.0)).lights[1:]))
        film = session.render(made, RenderSettings(sample_count=1, bounce_max=0))
        found.append(film.passes["Combined"][..., :3].astype(np.float64))
        counts, said = film.statistics["volumes"], " ".join(film.statistics["warnings"])
        assert (counts["shadow_rays_cut"] > 0) == ("shadow rays ended before" in said) == (density > 0)
        assert counts["shadow_rays_cut"] <= counts["shadow_rays"]
    assert found[1].min() > 0.01
    np.testing.assert_allclose(found[0], found[1], rtol=1e-5)


def test_a_detail_of_two_voxels_in_a_large_grid_is_as_dense_as_it_is(session):
    """No point of its cell that is drawn at random may lie in it; its bound is where the grid is largest."""
    made, expected = in_grid(320, ((100, 2, 100.0),))
    assert_mean(session, made, np.full(3, expected), sample_count=64)


def warnings_of(session, scene) -> str:
    return " ".join(session.render(scene, RenderSettings(sample_count=1)).statistics["warnings"])


def test_a_volume_denser_than_any_bound_is_named(session):
    """It is rendered as dense as its bound: 4,096 flights along an edge of a cell of 1/16 m."""
    assert "“filled”: its volume is denser than 6.55e+04 per metre" in warnings_of(session, in_box(layers(1e6)))
    assert "denser" not in warnings_of(session, in_box(layers(6e4)))


def of_the_world(density) -> Volume:
    """A scene in a world of this volume, seen along its axis z."""
    view = scenes.camera(eye=(0, 0, 0), target=(0, 0, 10), up=(0, 1, 0), half_width=0.01)
    made = in_box(Volume(), view)
    return dataclasses.replace(made, world=dataclasses.replace(made.world, volume=absorbing(density)))


def test_fog_that_goes_on_beyond_the_end_of_the_world_is_named(session):
    """Not where it thins out before, and not where it swallows all light before."""

    def fog(density):
        """The same everywhere, by a program that asks where it is."""

        def value(builder):
            height = builder.value("separate_xyz", builder.value("position", 0))[2]
            return builder.value("math", int(MathOperation.MULTIPLY_ADD), False, height, 0.0, density)

        return value

    assert "the world: its volume ends" in warnings_of(session, of_the_world(fog(1e-3)))
    assert "its volume ends" not in warnings_of(session, of_the_world(fog(1.0)))
    assert "its volume ends" not in warnings_of(session, of_the_world(fog(0.0)))


def test_fog_of_a_program_that_is_the_same_everywhere_has_no_end(session):
    def value(builder):
        return builder.value("math", int(MathOperation.ADD), False, 1e-3, 0.0, 0.0)

    assert "its volume ends" not in warnings_of(session, of_the_world(value))


@pytest.mark.parametrize("kind", [CameraKind.EQUIRECTANGULAR, CameraKind.FISHEYE_EQUIDISTANT, CameraKind.MIRROR_BALL])
def test_depth_of_panoramas_is_the_distance(session, kind):
    """Within a sphere around the camera it is the same everywhere, also behind the surface of a volume."""
    ball = scenes.sphere(radius=3.0), scenes.IDENTITY, scenes.diffuse(0.5)
    smoke = scenes.sphere("smoke", radius=1.0), scenes.IDENTITY, filled(medium(0.1))
    view = dataclasses.replace(scenes.camera(eye=(0, 0, 0), target=(0, 1, 0)), kind=kind, window=(0.0, 1.0, 0.0, 1.0))
    for things in ([ball], [ball, smoke]):
        made = scenes.scene(things, world=0.0, frame=Frame(16, 8, passes=("Combined", "Depth")), view=view)
        depth = session.render(made, RenderSettings(sample_count=1)).passes["Depth"]
        seen = depth < 100
        assert seen.mean() > 0.5
        # faces of a polyhedron are a little nearer than its corners
        least = 3 * math.cos(math.pi / 24) * math.cos(math.pi / 48)
        assert depth[seen].max() < 3 * (1 + 1e-5) and depth[seen].min() > least


@pytest.mark.parametrize("size", [0.2, 0.05])
def test_a_volume_far_from_the_origin_takes_no_more_flights(session, size):
    """Its cells are hardly wider there than the steps between points, or less wide."""

    def density(builder):
        x = builder.value("separate_xyz", builder.value("object_coordinates", 0))[0]
        square = builder.value("math", int(MathOperation.MULTIPLY), False, x, x, 0.0)
        scaled = builder.value("math", int(MathOperation.MULTIPLY), False, square, 4 / size**3, 0.0)
        return builder.value("math", int(MathOperation.ADD), False, scaled, 0.5 / size, 0.0)

    films = []
    for far in (0.0, 2e4):
        middle = np.array([far, -0.7 * far, 0.3 * far])
        view = scenes.camera(eye=tuple(middle + (0.05 * size, -2 * size, 0.3 * size)), target=tuple(middle))
        placed = scenes.box("cube", size), scenes.translation(*middle), filled(absorbing(density))
        made = scenes.scene([placed], world=1.0, frame=Frame(16, 16), view=view)
        films.append(session.render(made, RenderSettings(sample_count=256, bounce_max=0)))
    near, far = (film.passes["Combined"][..., :3].mean() for film in films)
    assert abs(far - near) < 0.02 * near < 0.02
    near, far = (film.statistics["rays"]["total"] for film in films)
    assert far < 1.1 * near


def test_a_layer_across_a_ray_is_met_where_another_coordinate_is_large(session):
    """Cells are as fine as elsewhere along the ray, while across it float32 hardly tells them apart."""
    size = 0.01

    def layer(builder):
        y = builder.value("separate_xyz", builder.value("object_coordinates", 0))[1]
        beyond = builder.value("math", int(MathOperation.GREATER_THAN), False, y, 0.1 * size, 0.0)
        return builder.value("math", int(MathOperation.MULTIPLY), False, beyond, 10 / size, 0.0)

    films = []
    for far in (0.0, 2e4):
        view = scenes.camera(eye=(far, -20 * size, 0), target=(far, 0, 0), half_width=0.01)
        placed = scenes.box("cube", size), scenes.translation(far, 0, 0), filled(absorbing(layer))
        made = scenes.scene([placed], world=1.0, frame=Frame(8, 8), view=view)
        films.append(session.render(made, RenderSettings(sample_count=64, bounce_max=0)))
    near, far = (film.passes["Combined"][..., :3].mean() for film in films)
    assert abs(near - math.exp(-4)) < 0.02 and abs(far - math.exp(-4)) < 0.02
