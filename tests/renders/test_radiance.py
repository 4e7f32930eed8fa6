"""Whole renders against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Light, LightKind, Visibility
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes


@pytest.fixture(autouse=True)
def kernels(request):
    """General ones; in a thorough run those of each scene: lights of each kind alone, closures alone."""
    if not request.config.option.thorough:
        request.getfixturevalue("general_kernels")


def color(film) -> np.ndarray:
    """Float64 [height, width, 3]."""
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].astype(np.float64)


def mean_and_error(session, scene, runs=8, **changes) -> tuple[float, float]:
    """Mean of the picture over seeds, and the standard error of it."""
    base = RenderSettings(sample_count=32, sample_sequence="INDEPENDENT").replace(**changes)
    means = [color(session.render(scene, base.replace(seed=seed))).mean() for seed in range(runs)]
    return float(np.mean(means)), float(np.std(means, ddof=1) / math.sqrt(runs))


def assert_within_4_sigma(session, scene, expected, **changes):
    mean, error = mean_and_error(session, scene, **changes)
    # float32 throughput: a few roundings a bounce
    assert abs(mean - expected) < 4 * error + 1e-6 * expected, (mean, expected, error)


# --- white furnace


@pytest.mark.parametrize("smooth", [False, True])
def test_a_white_sphere_in_a_white_world_is_invisible(session, smooth):
    scene = scenes.scene([(scenes.sphere(smooth=smooth), scenes.IDENTITY, scenes.diffuse(1.0))], world=1.0)
    picture = color(session.render(scene, RenderSettings(sample_count=16, nee="OFF", bounce_max=64)))
    if not smooth:
        assert np.abs(picture - 1).max() <= 4 * np.finfo(np.float32).eps
    else:  # directions below an interpolated normal's triangle are lost: never above 1
        assert picture.max() <= 1 + 1e-6 and picture.mean() > 0.98


def test_a_white_furnace_with_light_sampling(session):
    """A sphere inside a glowing box: light found by both strategies sums to 1."""
    shell = scenes.box(size=8)
    scene = scenes.scene(
        [
            (scenes.sphere(segments=24, rings=12), scenes.IDENTITY, scenes.diffuse(1.0)),
            # seen by all rays there are; what it says of others chooses the kernels of the lamp below
            (shell, scenes.IDENTITY, scenes.emitter(1.0), Visibility.ALL & ~Visibility.VOLUME_SCATTER),
        ],
        frame=Frame(16, 16),
        view=scenes.camera(eye=(0, -3, 0)),
    )
    assert_within_4_sigma(session, scene, 1.0, bounce_max=32)
    assert_within_4_sigma(session, scene, 1.0, bounce_max=32, nee="OFF")
    assert_within_4_sigma(session, scene, 1.0, bounce_max=32, mis="OFF")


def test_energy_in_a_closed_grey_box_sums_the_geometric_series(session):
    """Inside a closed box that emits 1 and reflects half, radiance is 1 + 1/2 + 1/4 + ..."""
    both = scenes.material(Closure(ClosureKind.EMISSION, (1, 1, 1)), Closure(ClosureKind.DIFFUSE, (0.5, 0.5, 0.5)))
    scene = scenes.scene(
        [(scenes.box(), scenes.IDENTITY, both)], frame=Frame(8, 8), view=scenes.camera(eye=(0, -0.5, 0))
    )
    for bounces in (0, 1, 3):
        expected = sum(0.5**k for k in range(bounces + 2))
        assert_within_4_sigma(session, scene, expected, bounce_max=bounces)
    assert_within_4_sigma(session, scene, 2.0, bounce_max=60, roulette_bounce=0)


# --- irradiance on a white floor, seen from above the centre


def floor_seen_closely(light: Light):
    view = scenes.camera(eye=(0.0, -1e-3, 1.0), half_width=1e-4)
    return scenes.scene(
        [(scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0))], frame=Frame(8, 8), lights=[light], view=view
    )


def parallel_rectangle_irradiance(radiance: float, half: float, height: float) -> float:
    """Irradiance of a square light above its centre (configuration factor B-3 of Howell's catalogue, four corners)."""
    a = half / height
    root = math.sqrt(1 + a * a)
    corner = 2 * a / root * math.atan(a / root) / (2 * math.pi)
    return math.pi * radiance * 4 * corner


def test_irradiance_under_an_area_light(session):
    # the camera would see the light's back from above it, which is dark
    light = scenes.area_light(radiance=3.0, size=1.4, matrix=scenes.translation(0, 0, 0.9))
    assert_within_4_sigma(session, floor_seen_closely(light), parallel_rectangle_irradiance(3.0, 0.7, 0.9) / math.pi)


def test_irradiance_under_a_disk_light(session):
    light = Light("disk", LightKind.ELLIPSE, scenes.translation(0, 0, 0.8), (2.0,) * 3, size=(1.0, 1.0))
    expected = math.pi * 2.0 * 0.5**2 / (0.5**2 + 0.8**2)
    assert_within_4_sigma(session, floor_seen_closely(light), expected / math.pi)


def test_irradiance_under_a_point_light(session):
    light = Light("point", LightKind.POINT, scenes.translation(0.6, 0, 0.8), (5.0,) * 3)
    assert_within_4_sigma(session, floor_seen_closely(light), 5.0 * 0.8 / math.pi)


def test_irradiance_under_a_sphere_light(session):
    """A sphere of radiance L and radius r in full view: pi L (r/d)^2 cos (Lambert)."""
    radius, distance = 0.3, 1.0
    intensity = 5.0
    light = Light(
        "ball",
        LightKind.POINT,
        scenes.translation(0, 0, distance),
        (intensity,) * 3,
        radius=radius,
        soft_falloff=False,
        visibility=Visibility.ALL & ~Visibility.CAMERA,
    )
    radiance = intensity / (math.pi * radius**2)
    assert_within_4_sigma(session, floor_seen_closely(light), radiance * (radius / distance) ** 2)


def test_irradiance_under_a_spot_light(session):
    inside = Light("spot", LightKind.SPOT, scenes.translation(0, 0, 0.8), (5.0,) * 3, angle=math.radians(60))
    assert_within_4_sigma(session, floor_seen_closely(inside), 5.0 / 0.64 / math.pi)
    beside = dataclasses.replace(inside, transform=scenes.translation(0.8, 0, 0.8))
    mean, _ = mean_and_error(session, floor_seen_closely(beside), runs=2)
    assert mean == 0.0


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.5])
def test_irradiance_under_a_sun(session, angle):
    """Strength is the irradiance of a surface that faces the sun; a wide sun straight above still gives all of it."""
    light = scenes.sun(2.5, angle)
    mean, error = mean_and_error(session, floor_seen_closely(light))
    # The floor at its centre sees all of the disk of directions whose projected area the strength is spread over
    half = angle / 2
    expected = 2.5 if angle == 0 else None
    if expected is None:
        solid = 2 * math.pi * (1 - math.cos(half))
        radiance_low, radiance_high = 2.5 / solid, 2.5 / (math.pi * math.sin(half) ** 2)
        irradiance = math.pi * math.sin(half) ** 2
        assert radiance_low * irradiance - 4 * error <= mean * math.pi <= radiance_high * irradiance + 4 * error
    else:
        assert abs(mean * math.pi - expected) < 1e-5 * expected


def test_irradiance_under_an_emissive_triangle_mesh(session):
    lamp = scenes.plane("lamp", 1.4)
    down = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.9]], np.float32)
    base = floor_seen_closely(scenes.sun(0.0))
    scene = scenes.scene(
        [
            (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0)),
            (lamp, down, scenes.emitter(3.0), Visibility.ALL & ~Visibility.CAMERA),
        ],
        frame=Frame(8, 8),
        view=base.camera,
    )
    expected = parallel_rectangle_irradiance(3.0, 0.7, 0.9) / math.pi
    assert_within_4_sigma(session, scene, expected)
    assert_within_4_sigma(session, scene, expected, nee="OFF", sample_count=128)
    assert_within_4_sigma(session, scene, expected, nee="HALF", sample_count=64)
    assert_within_4_sigma(session, scene, expected, mis="OFF")
    assert_within_4_sigma(session, scene, expected, mis="OFF", nee="HALF", sample_count=64)


def test_all_ways_to_find_light_agree(session):
    """A rough metal and a floor under a sun, a sphere, an area light and a glowing mesh, with and without either."""
    point = Light("ball", LightKind.POINT, scenes.translation(-0.8, 0, 0.9), (0.4,) * 3, radius=0.3, soft_falloff=False)
    down = np.array([[1, 0, 0, 0.9], [0, -1, 0, 0], [0, 0, -1, 0.8]], np.float32)
    scene = scenes.scene(
        [
            (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(0.7)),
            (
                scenes.sphere(segments=24, rings=12, radius=0.4),
                scenes.translation(0, 0, 0.4),
                scenes.material(Closure(ClosureKind.METAL, (0.9,) * 3, 0.4)),
            ),
            (scenes.plane("lamp", 0.6), down, scenes.emitter(3.0)),
        ],
        lights=[scenes.sun(1.0, 0.5), scenes.area_light(2.0, 0.8, scenes.translation(0, 0.6, 1.2)[:3]), point],
        frame=Frame(16, 16),
        view=scenes.camera(eye=(0, -3, 1.5), target=(0, 0, 0.3)),
        world=0.1,
    )
    (both, error), *others = (
        mean_and_error(session, scene, bounce_max=2, sample_count=64, **change)
        for change in ({}, {"mis": "OFF"}, {"nee": "OFF"}, {"mis": "OFF", "nee": "HALF"})
    )
    for mean, spread in others:
        assert abs(mean - both) < 4 * math.hypot(error, spread) + 1e-6 * both


# --- refraction and reflection


def test_a_mirror_shows_what_is_behind_the_viewer(session):
    mirror = scenes.material(Closure(ClosureKind.GLOSSY, (0.8, 0.8, 0.8)))
    wall = scenes.plane("wall", 20)
    facing = np.array([[1, 0, 0, 0], [0, 0, 1, -6], [0, -1, 0, 0]], np.float32)  # at y = -6, behind the camera
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 0]], np.float32)
    scene = scenes.scene(
        [(scenes.plane("mirror", 4), upright, mirror), (wall, facing, scenes.emitter(1.5))],
        view=scenes.camera(eye=(0, -1, 0)),
        frame=Frame(8, 8),
    )
    picture = color(session.render(scene, RenderSettings(sample_count=4)))
    assert np.allclose(picture, 0.8 * 1.5, rtol=1e-5)


@pytest.mark.parametrize("ior", [1.0, 1.33, 1.5, 2.4])
def test_a_glass_pane_reflects_and_passes_what_fresnel_says(session, ior):
    """Straight onto smooth glass: R of the light comes from the camera's side, the rest from behind."""
    glass = scenes.material(Closure(ClosureKind.GLASS, (1, 1, 1), roughness=0.0, ior=ior))
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]], np.float32)
    lamp = np.array([[1, 0, 0, 0], [0, 0, -1, 3], [0, 1, 0, 0]], np.float32)
    scene = scenes.scene(
        [(scenes.plane("pane", 4), upright, glass), (scenes.plane("lamp", 40), lamp, scenes.emitter(1.0))],
        view=scenes.camera(eye=(0, -1, 0), half_width=0.01),
        frame=Frame(8, 8),
    )
    reflectance = ((ior - 1) / (ior + 1)) ** 2
    assert_within_4_sigma(session, scene, 1 - reflectance, sample_count=256)


def test_snell_bends_rays_through_a_slab(session):
    """Looking obliquely into a glass half space, an emitter below the surface appears where Snell's law puts it."""
    ior, depth, angle = 1.5, 1.0, math.radians(50)
    offset = depth * math.tan(math.asin(math.sin(angle) / ior))
    glass = scenes.material(Closure(ClosureKind.GLASS, (1, 1, 1), roughness=0.0, ior=ior))
    lamp = scenes.plane("lamp", 0.05)
    eye = (-math.sin(angle) * 3, 0, math.cos(angle) * 3)
    view = scenes.camera(eye=eye, half_width=0.002)

    def brightness(x):
        scene = scenes.scene(
            [
                (scenes.plane("water", 8), scenes.IDENTITY, glass),
                (lamp, scenes.translation(x, 0, -depth), scenes.emitter(1.0)),
            ],
            view=view,
            frame=Frame(4, 4),
        )
        return color(session.render(scene, RenderSettings(sample_count=64, bounce_max=2))).mean()

    assert brightness(offset) > 0.8
    assert brightness(offset + 0.05) == brightness(offset - 0.05) == 0.0


def test_transparent_surfaces_dim_light_and_shadows_in_proportion(session):
    veil = scenes.material(Closure(ClosureKind.TRANSPARENT, (0.5, 0.5, 0.5)))
    view = scenes.camera(eye=(0.0, -1e-3, 0.3), half_width=1e-3)
    floor = (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0))
    veils = [(scenes.plane(f"veil {i}", 4), scenes.translation(0, 0, 0.5 + 0.1 * i), veil) for i in range(3)]
    scene = scenes.scene([floor, *veils], lights=[scenes.sun(2.0)], view=view, frame=Frame(8, 8))
    assert_within_4_sigma(session, scene, 2.0 / math.pi / 8)
    few = RenderSettings(sample_count=4, transparent_bounce_max=2)
    assert color(session.render(scene, few)).max() == 0.0  # three veils are more than two
    # a mesh of which one triangle is clear, and the other black
    view, aside = scenes.camera(eye=(0.5, -0.501, 0.3), target=(0.5, -0.5, 0)), scenes.translation(9, 9, 0)
    for slots, radiance in ([0, 1], 1.0 / math.pi), ([1, 0], 0.0):
        half = dataclasses.replace(scenes.plane("half", 4), triangle_slot=np.array(slots, np.int32))
        objects = [floor, (half, veils[0][1], veil), (scenes.plane("aside"), aside, scenes.diffuse(0.0))]
        scene = scenes.scene(objects, lights=[scenes.sun(2.0)], view=view, frame=Frame(2, 2))
        assert mean_and_error(session, scene)[0] == pytest.approx(radiance, rel=1e-5)


def test_a_transparent_film_has_alpha_where_the_world_shows(session):
    frame = Frame(32, 32, transparent=True)
    scene = scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse(0.5))], frame=frame, world=1.0)
    picture = session.render(scene, RenderSettings(sample_count=16)).passes["Combined"]
    assert picture[16, 16, 3] == 1.0 and picture[0, 0].tolist() == [0, 0, 0, 0]
    assert picture[16, 16, :3].mean() == pytest.approx(0.5, abs=0.02)
    edge = picture[..., 3]
    assert ((edge > 0) & (edge < 1)).any()


def test_visibility_hides_objects_from_the_rays_that_are_named(session):
    def looked_at(visibility):
        return scenes.scene(
            [
                (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0)),
                (scenes.plane("lid", 4), scenes.translation(0, 0, 0.5), scenes.diffuse(0.0), visibility),
            ],
            view=scenes.camera(eye=(0.0, -1e-3, 0.3), half_width=1e-3),
            frame=Frame(4, 4),
            lights=[scenes.sun(1.0)],
        )

    few = RenderSettings(sample_count=4)
    assert color(session.render(looked_at(Visibility.ALL), few)).max() == 0
    assert color(session.render(looked_at(Visibility.ALL & ~Visibility.SHADOW), few)).min() == pytest.approx(
        1 / math.pi, rel=1e-4
    )


def test_clamping_bounds_one_lights_contribution(session):
    scene = floor_seen_closely(scenes.sun(100.0))
    few = RenderSettings(sample_count=4)
    assert color(session.render(scene, few.replace(clamp_direct=2.0))).max() == pytest.approx(2.0, rel=1e-6)
    assert color(session.render(scene, few.replace(clamp_indirect=2.0))).max() == pytest.approx(100 / math.pi, rel=1e-4)


def test_depth_position_and_normal_are_those_of_the_surface(session):
    frame = Frame(9, 9, passes=("Combined", "Depth", "Normal", "Position"))
    scene = scenes.scene(
        [(scenes.plane(size=1.0), scenes.IDENTITY, scenes.diffuse())],
        frame=frame,
        view=scenes.camera(eye=(0, 0, 3), up=(0, 1, 0)),
    )
    passes = session.render(scene, RenderSettings(sample_count=2, pixel_filter="BOX")).passes
    assert passes["Depth"][4, 4, 0] == pytest.approx(3.0, rel=1e-6) and passes["Depth"][0, 0, 0] == pytest.approx(1e10)
    assert passes["Normal"][4, 4].tolist() == [0, 0, 1]
    assert np.abs(passes["Position"][4, 4]).max() < 0.3 and passes["Position"][4, 4, 2] == 0


@pytest.mark.parametrize("bounce_max", [0, 2])
@pytest.mark.parametrize("veil_count", [1, 4, 8])
def test_an_invisible_veil_changes_nothing(session, bounce_max, veil_count):
    """Fully transparent surfaces lie between floor and light, as many as may be passed: both strategies pass them."""
    veil = scenes.material(Closure(ClosureKind.TRANSPARENT, (1, 1, 1)))
    view = scenes.camera(eye=(0.0, -1e-3, 0.2), half_width=1e-4)
    floor = (scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0))
    veils = [(scenes.plane(f"veil {i}", 8), scenes.translation(0, 0, 0.3 + 0.05 * i), veil) for i in range(veil_count)]
    light = scenes.area_light(radiance=3.0, size=1.4, matrix=scenes.translation(0, 0, 0.9))
    scene = scenes.scene([floor, *veils], lights=[light], view=view, frame=Frame(8, 8))
    expected = parallel_rectangle_irradiance(3.0, 0.7, 0.9) / math.pi
    for nee in ("ON", "OFF"):
        assert_within_4_sigma(session, scene, expected, nee=nee, bounce_max=bounce_max, sample_count=64)


def test_the_far_clip_plane_stays_behind_a_veil(session):
    veil = scenes.material(Closure(ClosureKind.TRANSPARENT, (1, 1, 1)))
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]], np.float32)
    lamp = upright.copy()
    lamp[1, 3] = 8
    scene = scenes.scene(
        [(scenes.plane("veil", 40), upright, veil), (scenes.plane("lamp", 40), lamp, scenes.emitter(1.0))],
        view=scenes.camera(eye=(0, -1, 0), clip_end=5.0),
        frame=Frame(4, 4),
    )
    assert color(session.render(scene, RenderSettings(sample_count=2))).max() == 0.0


METAL = Closure(ClosureKind.METAL, (0.9, 0.9, 0.9), roughness=0.7)
LAMBERT = Closure(ClosureKind.DIFFUSE, (0.8, 0.8, 0.8))


@pytest.mark.parametrize("closure, kind", [(METAL, Visibility.GLOSSY), (LAMBERT, Visibility.DIFFUSE)])
@pytest.mark.parametrize("by_mesh", [False, True])
def test_a_light_lights_only_the_lobes_whose_rays_see_it(session, closure, kind, by_mesh):
    def lit(visibility, *closures):
        down = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.9]], np.float32)
        base = floor_seen_closely(
            dataclasses.replace(scenes.area_light(3.0, 1.4, scenes.translation(0, 0, 0.9)), visibility=int(visibility))
        )
        floor = (scenes.plane(size=4), scenes.IDENTITY, scenes.material(*closures))
        lamp = (scenes.plane("lamp", 1.4), down, scenes.emitter(3.0), visibility)
        return scenes.scene(
            [floor, lamp] if by_mesh else [floor],
            lights=() if by_mesh else base.lights,
            view=base.camera,
            frame=Frame(8, 8),
        )

    hidden = Visibility.ALL & ~Visibility.CAMERA & ~kind
    only = Visibility.SHADOW | kind
    full, _ = mean_and_error(session, lit(Visibility.ALL & ~Visibility.CAMERA, closure), sample_count=512)
    assert full > 0.05
    for nee in ("ON", "OFF"):
        assert mean_and_error(session, lit(hidden, closure), runs=2, nee=nee)[0] == 0.0
        assert mean_and_error(session, lit(only, closure), nee=nee, sample_count=512)[0] == pytest.approx(
            full, rel=0.01
        )
    # in a mixture the other lobe stays lit
    other = LAMBERT if closure is METAL else METAL
    alone, _ = mean_and_error(session, lit(Visibility.ALL & ~Visibility.CAMERA, other), sample_count=512)
    mixed, _ = mean_and_error(session, lit(hidden, closure, other), sample_count=512)
    assert mixed == pytest.approx(alone, rel=0.02)


def test_all_objects_hidden_from_one_kind_of_ray(session):
    scene = scenes.scene(
        [(scenes.plane(size=2), scenes.IDENTITY, scenes.diffuse(1.0), Visibility.ALL & ~Visibility.GLOSSY)], world=1.0
    )
    picture = color(session.render(scene, RenderSettings(sample_count=4)))
    assert np.abs(picture - 1).max() < 1e-6
