"""Volumes against closed forms: Beer's law, furnaces, slabs, nesting, and films that no schedule changes."""

import dataclasses
import math

import numpy as np
import pytest

import raybatch_addon.core.programs.ops  # noqa: F401  (ops register themselves)
from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Scene, Volume
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

_CLEAR = Closure(ClosureKind.TRANSPARENT, (1.0, 1.0, 1.0))
_NARROW = scenes.camera(eye=(0, -4, 0), half_width=0.01)


def _rgb(x) -> tuple[float, float, float]:
    return tuple(np.broadcast_to(np.asarray(x, float), 3).tolist())


def medium(absorption=0.0, scattering=0.0, emission=0.0, g=0.0) -> Volume:
    """A volume of these coefficients."""
    kinds = {
        ClosureKind.VOLUME_ABSORPTION: absorption,
        ClosureKind.HENYEY_GREENSTEIN: scattering,
        ClosureKind.EMISSION: emission,
    }
    return Volume(tuple(Closure(kind, _rgb(x), mean_cosine=g) for kind, x in kinds.items() if np.any(x)))


def varying(absorption=0.0, scattering=0.0, emission=0.0) -> Volume:
    """The same as a program: each coefficient is times the squared height above -1, over its mean."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    raised = builder.value("math", 0, False, height, 1.0, 0.0)
    factor = builder.value("math", 2, False, builder.value("math", 2, False, raised, raised, 0.0), 0.75, 0.0)
    for name, x in (
        ("volume_absorption", absorption),
        ("volume_henyey_greenstein", scattering),
        ("emission", emission),
    ):
        weight = builder.value("multiply_colors", Value.of(_rgb(x)), builder.value("splat", factor))
        builder.closure(name, weight, *((0.0,) if name == "volume_henyey_greenstein" else ()))
    return Volume(program=builder.finish())


def filled(volume: Volume) -> Material:
    """A material that nobody sees but for its volume."""
    return Material("filled", (_CLEAR,), (ClosureKind.TRANSPARENT,), volume=volume)


def in_box(volume: Volume, view=_NARROW, world=1.0, sun=0.0, lamp=0.0) -> Scene:
    """A cube of `volume` in a world of one colour; lights are there also where they are dark, so that tests share
    kernels.
    """
    boxed = [(scenes.box(), scenes.IDENTITY, filled(volume))]
    lights = [scenes.sun(sun), scenes.area_light(lamp, 1.0, scenes.translation(0, 0, 0.5))]
    return scenes.scene(boxed, world=world, frame=Frame(8, 8), view=view, lights=lights)


def color(film) -> np.ndarray:
    """Float64 [height, width, 3]."""
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].astype(np.float64)


def picture(session, scene, **changes) -> np.ndarray:
    """The picture, float64 [height, width, 3]."""
    settings = dict(sample_count=16, bounce_max=64) | changes
    return color(session.render(scene, RenderSettings(**settings)))


def assert_mean(session, scene, expected, runs=6, **changes) -> None:
    means = np.array([picture(session, scene, seed=seed, **changes).mean((0, 1)) for seed in range(runs)])
    error = means.std(0, ddof=1) / math.sqrt(runs)
    assert np.all(np.abs(means.mean(0) - expected) < 5 * error + 2e-6 * np.abs(expected)), (
        means.mean(0),
        expected,
        error,
    )


def test_beers_law_and_emission(session):
    """An absorbing, emitting cube dims the world behind it, by channel."""
    absorption, emission = np.array([0.2, 0.5, 1.0]), np.array([0.3, 0.2, 0.1])
    expected = np.exp(-2 * absorption) + emission / absorption * (1 - np.exp(-2 * absorption))
    scene = in_box(medium(absorption, emission=emission))
    np.testing.assert_allclose(picture(session, scene, sample_count=1)[4, 4], expected, rtol=2e-6)


@pytest.mark.parametrize("eye, length", [((0, -0.5, 0), 1.5), ((0, 0.999, 0), 0.001), ((0, 3, 0), 0.0)])
def test_cameras_within_volumes(session, eye, length):
    view = scenes.camera(eye=eye, target=(0, 9, 0), half_width=0.001)
    found = picture(session, in_box(medium(1.0), view), sample_count=1)[4, 4]
    np.testing.assert_allclose(found, math.exp(-length), rtol=1e-5)


def test_volumes_that_lie_in_one_another_add_up(session):
    """Beside another, within another, and across its surface; in a world that is filled too."""
    boxes = [
        (scenes.box(size=2.0), scenes.IDENTITY, filled(medium(0.1))),
        (scenes.box("inner", 1.0), scenes.IDENTITY, filled(medium(0.2))),
        (scenes.box("across", 1.0), scenes.translation(0, 0.9, 0), filled(medium(0.4))),
    ]
    scene = dataclasses.replace(
        scenes.scene(boxes, world=1.0, frame=Frame(8, 8), view=_NARROW), lights=in_box(medium(1.0)).lights
    )
    depth = 2 * 0.1 + 1 * 0.2 + 1 * 0.4
    np.testing.assert_allclose(picture(session, scene, sample_count=1)[4, 4], math.exp(-depth), rtol=5e-6)


@pytest.mark.parametrize("depth", [1e-6, 1.0, 1e6])
def test_a_white_furnace(session, depth):
    """What only scatters is not seen in a world of one colour, however thin or dense it is."""
    scene = in_box(medium(scattering=(depth / 2, depth / 4, depth / 8), g=0.3), world=1.0)
    # light does little in the densest one but turn back at its surface
    few = dict(sample_count=4, bounce_max=100_000, roulette_bounce=100_000) if depth < 10 else dict(bounce_max=8)
    found = picture(session, scene, **few)
    if depth < 1e-3:
        np.testing.assert_allclose(found, 1.0, atol=1e-5)
    elif depth < 10:
        assert_mean(session, scene, np.ones(3), **few)
    else:
        assert found.min() >= 0 and found.max() < 50


def test_where_light_scatters_does_not_depend_on_lamps(session):
    """A white furnace is as white if a lamp that hardly shines, to one side, is looked for on the way."""
    scene = in_box(medium(scattering=(2.0, 0.7, 0.2), g=0.3), world=1.0, lamp=1e-7)
    assert_mean(session, scene, np.ones(3), sample_count=256, bounce_max=1000, roulette_bounce=1000)


def test_single_scattering_of_a_sun(session):
    """One scattering of a sun that shines along the view, in a slab: the integral along the ray is known."""
    sigma, height = 0.7, 2.0
    view = scenes.camera(eye=(0, -4, 0), half_width=0.0005)
    scene = in_box(medium(scattering=sigma), view, 0.0, sun=1.0)
    # the sun comes from above, through 1 m at most: light at the middle passes 1 m, then what lies before it
    expected = sigma / (4 * math.pi) * math.exp(-sigma * 1.0) * (1 - math.exp(-sigma * height)) / sigma
    assert_mean(session, scene, np.full(3, expected), bounce_max=0, roulette_bounce=0)


def test_light_that_volumes_scatter_has_passes_of_its_own(session):
    """What the passes of light give together is the picture, and no component of surfaces has any of a volume's."""
    view = scenes.camera(eye=(0, -4, 0), half_width=0.3)
    scene = in_box(medium(0.1, 0.7, 0.2), view, 0.3, lamp=3.0)
    names = ("Combined", "Volume Direct", "Volume Indirect", "Emission", "Environment", "Diffuse Direct")
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=names))
    passes = session.render(scene, RenderSettings(sample_count=16, bounce_max=8)).passes
    seen = sum(passes[name] for name in names[1:5])
    np.testing.assert_allclose(seen, passes["Combined"][..., :3], rtol=1e-5, atol=1e-6)
    assert passes["Volume Direct"].mean() > passes["Volume Indirect"].mean() > 0.01
    assert not passes["Diffuse Direct"].any()


def test_behind_the_last_bounce_in_volumes_surfaces_do_not_scatter(session):
    """Thick fog above a floor is as bright over a white one as over a black one, if light scatters in it once."""

    def over(albedo, **changes):
        floor = scenes.plane(size=40), scenes.translation(0, 0, -1.5), scenes.diffuse(albedo)
        boxed = scenes.box(), scenes.IDENTITY, filled(medium(scattering=200.0))
        scene = scenes.scene([floor, boxed], world=0.0, frame=Frame(8, 8), view=_NARROW, lights=[scenes.sun(1.0)])
        return picture(session, scene, **changes)

    assert np.array_equal(over(0.9, volume_bounce_max=0), over(0.0, volume_bounce_max=0))
    assert over(0.9).mean() > 1.01 * over(0.0).mean()


def test_a_lamp_is_found_by_light_sampling_and_by_chance_alike(session):
    """The left half samples light, the right half meets it by chance; both see the same."""
    scene = in_box(medium(0.3, 0.6, g=0.4), scenes.camera(eye=(0, -4, 0), half_width=0.2), 0.0, lamp=1.0)
    found = [picture(session, scene, seed=seed, sample_count=64, nee="HALF") for seed in range(8)]
    halves = np.array([(each[:, :4].mean(), each[:, 4:].mean()) for each in found])
    error = math.hypot(*halves.std(0, ddof=1)) / math.sqrt(len(halves))
    left, right = halves.mean(0)
    assert left > 0.01 and abs(left - right) < 5 * error, (halves.mean(0), error)


def test_programs_of_volumes_against_closed_forms(session):
    """Transmittance, emission and scattering where the density changes along the ray, which comes from below."""
    view = scenes.camera(eye=(0, 0, -4), half_width=0.001, up=(0, 1, 0))
    total = 2.0  # integral over the cube of 0.75 (z + 1)^2
    scene = in_box(varying((0.2, 0.5, 1.0)), view)
    assert_mean(session, scene, np.exp(-total * np.array([0.2, 0.5, 1.0])))
    scene = in_box(varying(0.5, emission=1.0), view, world=0.0)
    assert_mean(session, scene, np.full(3, (1 - math.exp(-total * 0.5)) / 0.5))
    scene = in_box(varying(scattering=(0.5, 1.0, 1.5)), view)
    assert_mean(session, scene, np.ones(3), bounce_max=1000, roulette_bounce=1000)


def test_the_volume_of_the_world_knows_where_it_is(session):
    """The volume's program sees positions, and those that the world shows directions: fog that lies lower than 1 m."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    factor = builder.value("splat", builder.value("math", int(MathOperation.LESS_THAN), False, height, 1.0, 0.0))
    weight = builder.value("multiply_colors", Value.of((0.5, 0.5, 0.5)), factor)
    builder.closure("volume_absorption", weight)
    view = scenes.camera(eye=(0, 0, 0), target=(0, 0, 1), half_width=0.001, up=(0, 1, 0))
    ceiling = (scenes.plane(size=40), scenes.translation(0, 0, 3), scenes.emitter(1.0))
    scene = scenes.scene([ceiling], world=1.0, frame=Frame(8, 8), view=view, lights=[scenes.sun(0.0)])
    fog = Volume(program=builder.finish())
    scene = dataclasses.replace(scene, world=dataclasses.replace(scene.world, volume=fog))
    assert_mean(session, scene, np.full(3, math.exp(-0.5)))


@pytest.mark.parametrize(
    "volume", [medium(0.1, (0.5, 1.0, 2.0), 0.1), varying(0.1, 0.8, 0.1)], ids=["fixed", "program"]
)
def test_no_schedule_changes_a_film_of_volumes(session, volume):
    scene = in_box(volume, scenes.camera(eye=(0, -4, 0), half_width=0.3), 0.3, lamp=3.0)
    plain = picture(session, scene)
    for changes in ({"tile_size": 3}, {"ray_count": 64}, {"sample_order": "FRAME_FIRST"}, {"batching": "ON"}):
        assert np.array_equal(picture(session, scene, **changes), plain), changes


def test_a_scene_without_volumes_does_without_their_kernels(session):
    from raybatch_addon.core.scene.features import derive_features
    from raybatch_addon.core.wavefront.rays import bytes_per_path

    scene = in_box(medium(1.0))
    clear = dataclasses.replace(
        scene, materials=tuple(dataclasses.replace(each, volume=None) for each in scene.materials)
    )
    with_volumes, without = (derive_features(each, RenderSettings()) for each in (scene, clear))
    assert with_volumes.volumes and not without.volumes
    assert bytes_per_path(with_volumes) > bytes_per_path(without)
    assert "volumes" in without.left_out()


def test_first_samples_know_nothing_of_the_surface_of_a_volume(session):
    """Where sky is seen through a cube of smoke, Depth is as deep as the sky's."""
    depth = []
    for eye in ((0, -4, 0), (0, -4, 40)):
        made = in_box(medium(0.1), scenes.camera(eye=eye, target=(0, 9, eye[2]), half_width=0.01))
        made = dataclasses.replace(made, frame=Frame(8, 8, passes=("Combined", "Depth")))
        depth.append(session.render(made, RenderSettings(sample_count=1)).passes["Depth"])
    assert np.array_equal(*depth)
