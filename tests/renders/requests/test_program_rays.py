"""Rays that programs ask for, in whole renders: closed forms, and the same film under any schedule."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.inputs.ray_inputs import INSIDE, ONLY_LOCAL, ROUNDED, SAMPLES_SHIFT
from raybatch_addon.core.scene.description import CameraKind, Closure, ClosureKind, Frame, Material, Mesh
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.watched_renders import stopping

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

SETTINGS = RenderSettings(sample_count=4, bounce_max=0, nee="OFF")


def shows(make, samples=32, bits=0) -> Material:
    """A material that emits what `make(builder, bits)` gives."""
    builder = ProgramBuilder()
    value = make(builder, bits | samples << SAMPLES_SHIFT)
    builder.closure("emission", value if value.width == 3 else builder.value("splat", value))
    return Material("shows", (), (ClosureKind.EMISSION,), builder.finish())


def occlusion(distance):
    return lambda b, bits: b.value("ambient_occlusion", b.value("normals")[0], distance, bits, -1, -1)


def bevel(radius):
    return lambda b, bits: b.value("bevel", b.value("normals")[0], radius, ROUNDED | bits, -1, -1)


def from_above(half_width=0.1, height=0.4, frame=(16, 16)):
    view = scenes.camera(eye=(0, 0, height), half_width=half_width, up=(0.0, 1.0, 0.0))
    return {"view": dataclasses.replace(view, kind=CameraKind.ORTHOGRAPHIC), "frame": Frame(*frame)}


def picture(session, scene, settings=SETTINGS):
    film = session.render(scene, settings)
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].astype(float)


def between(material, ceiling=None):
    """A floor at 0 under a ceiling at 0.5, seen from between them."""
    floor = (scenes.plane(size=200.0), scenes.IDENTITY, material)
    above = (scenes.plane("ceiling", size=200.0), scenes.translation(0, 0, 0.5), ceiling or scenes.diffuse())
    return scenes.scene([floor, above], **from_above())


def test_the_share_of_a_floor_under_a_ceiling_is_known(session):
    """Cosines of directions have squares that are spread evenly: those below height / distance escape."""
    seen = picture(session, between(shows(occlusion(1.0), samples=64)))
    assert seen.mean() == pytest.approx(0.25, abs=0.002)
    assert 0.0 < seen.std() < 0.05  # a picture of samples, not of a constant


@pytest.mark.thorough
def test_only_the_object_itself_hides_where_that_is_asked_for(session):
    floor = shows(occlusion(1.0), bits=ONLY_LOCAL)
    np.testing.assert_array_equal(picture(session, between(floor)), 1.0)
    # inside: under the floor nothing is
    below = shows(occlusion(1.0), bits=INSIDE)
    np.testing.assert_array_equal(picture(session, between(below)), 1.0)


@pytest.mark.thorough
def test_rays_of_the_object_alone_pass_others(session):
    """A mesh of two sheets with a sheet of another object between them."""
    low, high = scenes.plane(size=200.0), scenes.plane(size=200.0)
    count = len(low.positions)
    positions = np.concatenate([low.positions, high.positions + np.float32([0, 0, 0.5])])
    both = Mesh("both", positions, np.concatenate([low.triangles, high.triangles + count]))
    between_them = (scenes.plane("other", size=200.0), scenes.translation(0, 0, 0.45), scenes.diffuse())
    scene = scenes.scene(
        [(both, scenes.IDENTITY, shows(occlusion(1.0), samples=64, bits=ONLY_LOCAL)), between_them], **from_above()
    )
    assert picture(session, scene).mean() == pytest.approx(0.25, abs=0.002)


def wedge(angle=np.pi / 2) -> Mesh:
    """Two large faces that meet in the y axis, one of them the half plane z = 0, x < 0, seen from above."""
    far = 50.0
    down = np.array([np.cos(angle), 0, -np.sin(angle)]) * far
    corners = [(-far, -far, 0), (0, -far, 0), (0, far, 0), (-far, far, 0), down + (0, -far, 0), down + (0, far, 0)]
    triangles = [(0, 1, 2), (0, 2, 3), (1, 4, 5), (1, 5, 2)]
    return Mesh("wedge", np.array(corners, np.float32), np.array(triangles, np.int32))


def rounded_normal(x: float, radius: float) -> np.ndarray:
    """The normal at (x, 0, 0) on the wedge, x < 0: the mean of those within the radius, weighed by their distance."""
    steps = (np.arange(400) + 0.5) / 400 * 2 - 1
    u, v = (radius * each for each in np.meshgrid(steps, steps))
    r = np.hypot(u, v)
    weight = np.where(r < radius, (radius - r) ** 3, 0.0)
    flat = weight[x + u < 0].sum()
    # on the other face, a point is `s` from the edge
    s = radius * (np.arange(400) + 0.5) / 400
    s, w = np.meshgrid(s, radius * steps)
    r = np.sqrt(x * x + s * s + w * w)
    turned = 0.5 * np.where(r < radius, (radius - r) ** 3, 0.0).sum()
    normal = np.array([turned, 0.0, flat])
    return normal / np.linalg.norm(normal)


def test_a_rounded_edge_has_the_mean_normal_of_what_is_near(session):
    radius = 0.1
    scene = scenes.scene(
        [(wedge(), scenes.IDENTITY, shows(bevel(radius), samples=128))], **from_above(0.12, frame=(12, 12))
    )
    found = picture(session, scene, SETTINGS.replace(sample_count=8, pixel_filter="BOX"))
    width = 0.24 / 12
    for column in range(6):
        x = -0.12 + (column + 0.5) * width
        normal = found[:, column].mean(0)
        expected = rounded_normal(x, radius) if x > -radius else np.array([0, 0, 1.0])
        # pixels have a width
        assert np.abs(normal - expected).max() < (0.02 if x > -radius else 1e-6), (column, normal, expected)


@pytest.mark.thorough
@pytest.mark.parametrize("radius", [0.0, -1.0, 1e-30, 1e18, 1e30])
def test_radii_without_use_leave_an_edge_as_it_is(session, radius):
    """None, hardly any, and one whose square is beyond float32."""
    scene = scenes.scene([(wedge(), scenes.IDENTITY, shows(bevel(radius), samples=4))], **from_above(frame=(6, 6)))
    found = picture(session, scene)[:, :2]
    assert np.isfinite(found).all() and (np.linalg.norm(found, axis=-1) <= 1 + 1e-5).all()
    if radius != 1e18:
        np.testing.assert_allclose(found, np.broadcast_to([0.0, 0.0, 1.0], found.shape), atol=1e-6)


def mixed(frame=(20, 14)):
    """Two kinds of requests, one that depends on the other, behind a veil and on mirrored instances."""

    def both(b, bits):
        rounded = b.value("bevel", b.value("normals")[0], 0.4, ROUNDED | bits, -1, -1)
        seen = b.value("ambient_occlusion", rounded, 1.5, bits, -1, -1)
        return b.value("multiply_colors", b.value("splat", seen), (0.9, 0.7, 0.4))

    def diffuse():
        builder = ProgramBuilder()
        builder.closure("diffuse", both(builder, 3 << SAMPLES_SHIFT), (0.0, 0.0, 0.0))
        return Material("dirt", (), (ClosureKind.DIFFUSE,), builder.finish())

    def veil():
        builder = ProgramBuilder()
        seen = builder.value("splat", occlusion(0.5)(builder, 2 << SAMPLES_SHIFT | ONLY_LOCAL))
        builder.closure("transparent", seen)
        return Material("veil", (), (ClosureKind.TRANSPARENT,), builder.finish())

    box, dirt = scenes.box(size=0.8), diffuse()
    mirrored = scenes.translation(-0.8, 0.1, 0.1)
    mirrored[0, 0] *= -1
    return scenes.scene(
        [
            (box, scenes.translation(0.7, 0, 0), dirt),
            (box, mirrored, dirt),
            (scenes.sphere("ball", 12, 6, 0.4, smooth=True), scenes.translation(0, -0.6, -0.2), dirt),
            (scenes.plane(size=6.0), scenes.translation(0, 0, -0.5), dirt),
            (scenes.plane("veil", size=1.2), scenes.look_at((0.3, -2.0, 0.2), (0, -4, 0)), veil()),
        ],
        view=scenes.camera(eye=(0, -4, 1)),
        frame=Frame(*frame, passes=("Combined", "Ambient Occlusion"), occlusion_distance=1.5),
        world=0.5,
        lights=[scenes.sun(2.0, 0.1, scenes.look_at((1.5, -2.0, 2.0), (0, 0, 0)))],
    )


def test_the_pass_shows_how_open_a_floor_is(session):
    """Under a pane that lets a part of the light pass, and a ceiling above it."""
    tint = (0.2, 0.5, 0.8)
    pane = Material("pane", (Closure(ClosureKind.TRANSPARENT, tint),), (ClosureKind.TRANSPARENT,))
    floor = (scenes.plane(size=200.0), scenes.IDENTITY, scenes.diffuse())
    above = [
        (scenes.plane(name, size=200.0), scenes.translation(0, 0, height), material)
        for name, height, material in (("pane", 0.5, pane), ("ceiling", 0.8, scenes.diffuse()))
    ]
    scene = scenes.scene([floor, *above], **from_above())
    passes = ("Combined", "Ambient Occlusion")
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=passes, occlusion_distance=1.0))
    film = session.render(scene, SETTINGS.replace(sample_count=64))
    expected = 0.25 + (0.64 - 0.25) * np.array(tint)
    np.testing.assert_allclose(film.passes["Ambient Occlusion"].mean((0, 1)), expected, atol=0.004)


PATHS = RenderSettings(sample_count=2, bounce_max=3, roulette_bounce=2)


def same(film, plain) -> None:
    assert film.statistics["invalid_samples"] == 0
    for name in ("Combined", "Ambient Occlusion"):
        np.testing.assert_array_equal(film.passes[name], plain.passes[name])


@pytest.fixture(scope="module")
def plain(session):
    film = session.render(mixed(), PATHS.replace(batching="OFF"))
    assert all(film.passes[name][..., :3].std() > 0.05 for name in ("Combined", "Ambient Occlusion"))
    return film


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change",
    [
        {"batching": "ON", "treelet_size": 16},
        {"batching": "ON", "ray_count": 100, "queue_size": 8},
        {"tile_size": 8, "thread_count": 2},
        {"batching": "ON", "treelet_size": 16, "geometry_budget": 20_000, "geometry_store": "HOST"},
        {"ray_sort": "ON", "sample_order": "FRAME_FIRST", "ray_count": 64},
    ],
)
def test_any_schedule_gives_the_same_film(session, plain, change):
    same(session.render(mixed(), PATHS.replace(**change)), plain)


@pytest.mark.thorough
def test_requests_take_part_in_resuming(session, plain):
    settings = PATHS.replace(tile_size=9, ray_count=60, thread_count=1)
    with stopping(40):
        stopped = session.render(mixed(), settings)
    assert not stopped.complete
    same(session.render(mixed(), settings, resume=stopped), plain)
