"""Levels of images: means of light over the areas of their texels, and look-ups of them."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import Image, ImageEncoding
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.image_upload import ImageCache, device_bytes_of
from raybatch_addon.core.shading.images.levels import FilteredImage, ImageLevels, coarser_levels, level_sizes
from raybatch_addon.core.shading.images.textures import (
    Extension,
    ImageTable,
    Interpolation,
    footprint_level,
    sample_level,
)
from tests.support.under_test import DEVICE

RNG = np.random.default_rng(11)
LINEAR, SRGB = ImageEncoding.LINEAR, ImageEncoding.SRGB
# A level in float32 has at most 12 means behind it, each of a few roundings of 2**-24
ROUNDING = 1e-5


def overlap_means(values, size):
    """Means of `values` [n, ...] over `size` equal parts of the interval that they divide, float64."""
    n = len(values)
    edges = np.linspace(0, n, size + 1)
    sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, 0, dtype=float)])
    whole = np.minimum(edges.astype(int), n - 1)
    rest = (edges - whole).reshape(-1, *[1] * (values.ndim - 1))
    return np.diff(sums[whole] + rest * values[whole], axis=0) * (size / n)


def decoded(x):
    return np.where(x < 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def reference(light):
    """Levels of linear light [height, width, channels], each of the one before."""
    made = []
    for width, height in level_sizes(light.shape[1], light.shape[0]):
        light = overlap_means(light, height)
        light = overlap_means(light.swapaxes(0, 1), width).swapaxes(0, 1)
        made.append(light)
    return made


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (7, 5), (1, 13), (601, 9), (30, 1)])
@pytest.mark.parametrize("channels", [1, 4])
def test_a_texel_of_a_level_is_the_mean_of_its_area(size, channels):
    height, width = size
    pixels = RNG.random((height, width, channels)).astype(np.float32)
    made = coarser_levels(pixels, LINEAR, ImageLevels.PLAIN)
    assert [each.shape[1::-1] for each in made] == level_sizes(width, height)
    for own, expected in zip(made, reference(pixels)):
        assert own.dtype == np.float32 and np.allclose(own, expected, rtol=0, atol=ROUNDING)
    if made:
        assert made[-1].shape == (1, 1, channels) and np.allclose(made[-1], pixels.mean((0, 1)), atol=ROUNDING)


def test_levels_of_bytes_are_the_nearest_bytes_to_the_mean_light():
    pixels = RNG.integers(0, 256, (37, 64, 4)).astype(np.uint8)
    for own, light in zip(coarser_levels(pixels, LINEAR, ImageLevels.PLAIN), reference(pixels / 255)):
        assert own.dtype == np.uint8 and np.abs(own - 255 * light).max() <= 0.5 + 255 * ROUNDING
    light = pixels / 255
    light[..., :3] = decoded(light[..., :3])
    for own, mean in zip(coarser_levels(pixels, SRGB, ImageLevels.PLAIN), reference(light)):
        roots = np.concatenate([np.sqrt(mean[..., :3]), mean[..., 3:]], 2)  # finer steps where it is dark
        assert np.abs(own - 255 * roots).max() <= 0.5 + 255 * ROUNDING


def test_alpha_is_divided_out_before_light_is_meant():
    alpha = RNG.integers(0, 3, (8, 8, 1)) / 2.0
    colors = RNG.random((8, 8, 3))
    pixels = np.concatenate([colors * alpha, alpha], 2).astype(np.float32)
    expected = reference(np.concatenate([decoded(colors) * alpha, alpha], 2))
    for own, light in zip(coarser_levels(pixels, SRGB, ImageLevels.DIVIDED), expected):
        assert np.allclose(own, light, atol=ROUNDING)


def test_half_precision_stays_half_precision():
    pixels = RNG.random((6, 6, 4)).astype(np.float16)
    made = coarser_levels(pixels, LINEAR, ImageLevels.PLAIN)
    assert {each.dtype.name for each in made} == {"float16"}
    assert np.allclose(made[-1], pixels.astype(float).mean((0, 1)), atol=2.0**-11)


# --- on the device


@wp.struct
class Asked:
    image: int
    level: int
    interpolation: int
    extension: int
    divide: int


@wp.kernel(**KERNEL_OPTIONS)
def probe_level(table: ImageTable, uv: wp.array(dtype=wp.vec2), asked: Asked, out: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    out[i] = sample_level(table, asked.image, asked.level, uv[i], asked.interpolation, asked.extension, asked.divide)


@wp.kernel(**KERNEL_OPTIONS)
def probe_footprint(table: ImageTable, area: wp.array(dtype=wp.vec2), image: int, level: wp.array(dtype=int)):
    i = wp.tid()
    level[i] = footprint_level(table, image, wp.vec2(0.3, 0.4), area[i][0], area[i][1])


def uploaded(*images):
    return ImageCache().upload(images, DEVICE)


def look_up(images, uv, level, interpolation=Interpolation.CLOSEST, divide=False, image=0):
    asked = Asked()
    asked.image, asked.level, asked.interpolation = image, level, int(interpolation)
    asked.extension, asked.divide = int(Extension.REPEAT), int(divide)
    uv = wp.array(np.asarray(uv, np.float32).reshape(-1, 2), dtype=wp.vec2, device=DEVICE)
    out = wp.empty(len(uv), dtype=wp.vec4, device=DEVICE)
    wp.launch(probe_level, len(uv), [images.table, uv, asked], [out], device=DEVICE)
    return out.numpy().astype(float)


def centres(width, height):
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.stack([x, y], -1).reshape(-1, 2)


@pytest.mark.parametrize("encoding", [LINEAR, SRGB])
@pytest.mark.parametrize("dtype", [np.uint8, np.float16, np.float32])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_look_up_gives_the_linear_light_of_a_level(encoding, dtype, channels):
    pixels = RNG.random((10, 13, channels))
    pixels = (255 * pixels).astype(np.uint8) if dtype is np.uint8 else pixels.astype(dtype)
    images = uploaded(FilteredImage("filtered", pixels, encoding))
    light = pixels.astype(float) / (255 if dtype is np.uint8 else 1)
    if encoding is SRGB:
        light[..., :3] = decoded(light[..., :3])
    # a root of a byte is off by half a step, and its square by as much times twice itself
    step = 1.01 / 255 if dtype is np.uint8 else 2.0**-11
    for level, ((width, height), mean) in enumerate(zip(level_sizes(13, 10), reference(light)), 1):
        found = look_up(images, centres(width, height), level)[:, : min(channels, 3)]
        assert np.allclose(found, mean[..., : min(channels, 3)].reshape(-1, min(channels, 3)), rtol=0, atol=step)


def test_levels_are_interpolated_in_linear_light():
    pixels = np.zeros((2, 4, 1), np.uint8)
    pixels[:, 2:] = 255
    between = look_up(uploaded(FilteredImage("edge", pixels, SRGB)), [(0.5, 0.5)], 1, Interpolation.LINEAR)
    assert between[0, :3] == pytest.approx(0.5, abs=1e-6)


def test_level_0_and_images_without_levels_are_the_image_itself():
    pixels = RNG.integers(0, 256, (9, 6, 4)).astype(np.uint8)
    images = uploaded(FilteredImage("filtered", pixels, SRGB), Image("plain", pixels, SRGB))
    uv = RNG.uniform(-1, 2, (200, 2))
    itself = look_up(images, uv, 0, Interpolation.LINEAR)
    assert np.array_equal(itself, look_up(images, uv, 0, Interpolation.LINEAR, image=1))
    assert np.array_equal(itself, look_up(images, uv, 3, Interpolation.LINEAR, image=1))
    assert not np.array_equal(itself, look_up(images, uv, 3, Interpolation.LINEAR))


def test_tiles_have_levels_of_their_own():
    tiles = tuple((number, np.full((4, 4, 1), value, np.uint8)) for number, value in ((1001, 51), (1012, 204)))
    images = uploaded(FilteredImage("tiles", None, LINEAR, tiles))
    found = look_up(images, [(0.5, 0.5), (1.5, 1.5), (1.5, 0.5)], 9)
    assert np.allclose(found[:, 0], (0.2, 0.8, 1)) and np.allclose(found[:, 1], (0.2, 0.8, 0))  # the last is missing


def test_the_level_has_texels_of_the_footprints_area():
    images = uploaded(
        FilteredImage("wide", np.zeros((64, 256, 1), np.uint8), LINEAR), Image("plain", np.zeros((8, 8, 1)))
    )
    texel = 1 / (64 * 256)
    asked = [
        (0, 0.99),
        (texel, 0),
        (texel, 0.99),
        (4 * texel, 0),
        (8 * texel, 0.49),
        (8 * texel, 0.51),
        (1e30, 0.5),
        (np.nan, 0),
        (np.inf, 0.9),
        (-1, 0.5),
    ]
    area, level = wp.array(asked, dtype=wp.vec2, device=DEVICE), wp.zeros(len(asked), dtype=int, device=DEVICE)
    wp.launch(probe_footprint, len(asked), [images.table, area, 0], [level], device=DEVICE)
    assert level.numpy().tolist() == [0, 0, 0, 1, 1, 2, 8, 0, 8, 0]
    wp.launch(probe_footprint, len(asked), [images.table, area, 1], [level], device=DEVICE)
    assert not level.numpy().any()


def test_levels_take_a_third_of_memory_and_images_without_them_none():
    pixels = freeze(np.zeros((64, 64, 4), np.uint8))
    plain, filtered = uploaded(Image("plain", pixels)), uploaded(FilteredImage("filtered", pixels))
    assert plain.level_bytes == 0 and filtered.level_bytes == 4 * sum(4**k for k in range(6))
    assert filtered.bytes - plain.bytes == pytest.approx(filtered.level_bytes, abs=6 * 64)
    assert device_bytes_of([FilteredImage("filtered", pixels)]) == 4 * 64 * 64 + filtered.level_bytes


def test_a_picture_without_levels_is_not_taken_for_one_with_them():
    pixels, cache = freeze(RNG.integers(0, 256, (8, 8, 4)).astype(np.uint8)), ImageCache()
    both = cache.upload([Image("plain", pixels), FilteredImage("filtered", pixels)], DEVICE)
    again = cache.upload([FilteredImage("filtered", pixels)], DEVICE)
    assert both.level_bytes == again.level_bytes > 0
    assert {each.ptr for each in again.keep} <= {each.ptr for each in both.keep}
    assert cache.upload([Image("plain", pixels)], DEVICE).level_bytes == 0
