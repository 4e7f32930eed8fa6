"""Images filtered over the footprints of paths, from settings to the film."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.footprints import filtered_scene
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Image, ImageEncoding, Material, Mesh
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.levels import level_sizes
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.core.wavefront.rays import bytes_per_path, needed_arrays
from tests.support import scenes
from tests.support.images import textured_scenes
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")  # of what is not filtered
OFF = RenderSettings(sample_count=4, bounce_max=3, seed=5)
FILTERED = OFF.replace(texture_filter="FOOTPRINT", texture_filter_width=1.0)
SQUARES = np.where((np.arange(64)[:, None] // 32 + np.arange(64) // 32) % 2, 235, 20).astype(np.uint8)[..., None]


def textured(kind="diffuse") -> Material:
    builder = ProgramBuilder()
    place = (len(textured_scenes.images()), Interpolation.LINEAR, Extension.REPEAT, Projection.FLAT, 0)
    color, _ = builder.value("image", *place, builder.value("uv", -1, 0))
    builder.closure(kind, color, *([(0.0, 0.0, 0.0)] if kind == "diffuse" else []))
    kinds = (ClosureKind.DIFFUSE if kind == "diffuse" else ClosureKind.EMISSION,)
    return Material("textured", (), kinds, builder.finish())


def floor(repeats, size=12.0) -> Mesh:
    plane = scenes.plane(size=size)
    uvs = plane.positions[:, :2] * np.float32(repeats / size)
    return dataclasses.replace(plane, corner_uvs=uvs[plane.triangles])


def room(repeats=40, kind="diffuse"):
    """A textured floor below a mirror ball and a glossy one; the floor shows a square many times.

    Materials and images of a textured room come with it, so that its kernels are those of tests of images in tiles.
    """
    unseen = textured_scenes.room()
    mirror = scenes.material(Closure(ClosureKind.METAL, (0.9,) * 3, roughness=0.0), name="mirror")
    gloss = scenes.material(Closure(ClosureKind.METAL, (0.9,) * 3, roughness=0.4), name="gloss")
    balls = [scenes.sphere(name, 16, 8, smooth=True) for name in ("mirror", "gloss")]
    scene = scenes.scene(
        [
            (floor(repeats), scenes.translation(0, 0, -1), textured(kind)),
            (balls[0], scenes.translation(-1.1, 0, 0), mirror),
            (balls[1], scenes.translation(1.1, 0, 0), gloss),
        ],
        view=scenes.camera(eye=(0.3, -5, 1.6), half_width=0.55),
        frame=Frame(24, 20),
        lights=[scenes.sun(2.0, 0.1)],
        world=(0.1, 0.15, 0.25),
    )
    images = (*unseen.images, Image("squares", SQUARES, ImageEncoding.LINEAR))
    return dataclasses.replace(scene, materials=scene.materials + unseen.materials, images=images)


def picture_of(film):
    return film.passes["Combined"][..., :3].astype(float)


def bytes_of_levels(image: Image) -> int:
    pictures = [image.pixels] if image.tiles is None else [pixels for _, pixels in image.tiles]
    sizes = [(each, level_sizes(each.shape[1], each.shape[0])) for each in pictures]
    # on a GPU a color of three channels takes the place of four
    channels = {3: 4} if DEVICE != "cpu" else {}
    texels = [(channels.get(each.shape[2], each.shape[2]) * each.itemsize, levels) for each, levels in sizes]
    return sum(width * height * size for size, levels in texels for width, height in levels)


@pytest.fixture(scope="module")
def filtered(session):
    return session.render(room(), FILTERED)


def test_statistics_report_levels_and_look_ups(session, filtered):
    reported = filtered.statistics["images"]
    # each material but the metals filters its own; what is distorted looks up two more by what an image says
    assert (reported["filtered_look_ups"], reported["other_look_ups"]) == (1 + 5, 2)
    assert reported["level_bytes"] == sum(4**k for k in range(6)) + sum(map(bytes_of_levels, textured_scenes.images()))
    assert filtered.statistics["invalid_samples"] == 0
    plain = session.render(room(), OFF).statistics
    assert plain["images"].keys() == {"count", "bytes"} and "levels of images" in plain["left_out"]
    assert "levels of images" not in filtered.statistics["left_out"]


def test_a_path_keeps_its_cone_in_eight_bytes_and_none_where_nothing_is_filtered():
    off, on = (derive_features(filtered_scene(room(), each), each) for each in (OFF, FILTERED))
    assert bytes_per_path(on) == bytes_per_path(off) + 8
    assert needed_arrays(on)["cone"] and not needed_arrays(off)["cone"]
    bare = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())])
    assert filtered_scene(bare, FILTERED).materials == bare.materials
    assert not derive_features(filtered_scene(bare, FILTERED), FILTERED).texture_levels


@pytest.mark.parametrize(
    "change",
    each_of(
        4,
        [
            dict(thread_count=3, tile_size=7),
            dict(tile_size=5),
            dict(ray_count=37),
            dict(sample_order="PIXEL_FIRST"),
            dict(batching="ON", treelet_size=8),
            dict(ray_sort="ON"),
        ],
    ),
    ids=str,
)
def test_schedules_do_not_change_the_film(session, filtered, change):
    film = session.render(room(), FILTERED.replace(**change))
    assert np.array_equal(film.passes["Combined"], filtered.passes["Combined"])


def test_films_of_sample_ranges_merge_to_that_of_all(session, filtered):
    parts = [session.render(room(), FILTERED.replace(sample_count=2), sample_first=first) for first in (0, 2)]
    assert np.array_equal(parts[0].merge(parts[1]).passes["Combined"], filtered.passes["Combined"])


@pytest.mark.thorough  # many samples
def test_far_squares_have_their_mean_brightness_and_no_noise(session):
    far = dataclasses.replace(room(4000, "emission"), lights=(), frame=Frame(24, 20))
    one = OFF.replace(sample_count=1, bounce_max=0)
    off, on = (
        picture_of(session.render(far, each))
        for each in (one, one.replace(texture_filter="FOOTPRINT", texture_filter_width=1.0))
    )
    shown = off[:6]  # the floor alone, seen from above: the bottom rows come first
    assert shown.std() > 0.2 and on[:6].std() < 0.01
    assert on[:6].mean() == pytest.approx(0.5, abs=0.01)


def test_an_image_that_is_seen_large_is_the_same_to_the_bit(session):
    near = room(0.05)  # a texel is many pixels wide
    one = OFF.replace(bounce_max=0, roulette_bounce=0)  # the kernels are those of all others here
    off, on = (
        session.render(near, each) for each in (one, one.replace(texture_filter="FOOTPRINT", texture_filter_width=1.0))
    )
    assert np.array_equal(off.passes["Combined"], on.passes["Combined"])


def test_a_narrow_filter_comes_near_to_none(session):
    rendered = [
        picture_of(session.render(room(), FILTERED.replace(sample_count=16, texture_filter_width=width)))
        for width in (4.0, 1.0, 0.01)
    ]
    off = picture_of(session.render(room(), OFF.replace(sample_count=16)))
    wide, whole, narrow = (np.sqrt(np.mean((picture - off) ** 2)) for picture in rendered)
    assert narrow < 0.2 * whole < 0.2 * wide


def test_general_kernels_are_refused_with_the_reason(session):
    film = session.render(room(), FILTERED.replace(kernel_tier="GENERAL", sample_count=1))
    assert any("Texture Filter at Footprint" in warning for warning in film.statistics["warnings"])
