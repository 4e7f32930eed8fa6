"""Image look-ups agree with Cycles, whatever the image's kind and the coordinates."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import Image, ImageEncoding
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.image_upload import ImageCache, halved
from raybatch_addon.core.shading.images.textures import Extension, ImageTable, Interpolation, sample_image
from tests.support.under_test import DEVICE

MAGENTA = (1, 0, 1, 1)
RNG = np.random.default_rng(7)
# Points up to 25 texels from the origin are rounded by 1e-6 of a texel on each axis, and decoding has slopes up to 2.3
ROUNDING = 5e-6
BYTES = RNG.integers(0, 256, (5, 7, 4)).astype(np.uint8)


@wp.struct
class Asked:
    image: int
    interpolation: int
    extension: int
    divide: int


@wp.kernel(**KERNEL_OPTIONS)
def probe(table: ImageTable, uv: wp.array(dtype=wp.vec2), asked: Asked, out: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    out[i] = sample_image(table, asked.image, uv[i], asked.interpolation, asked.extension, asked.divide)


def look_up(
    images, uv, interpolation=Interpolation.LINEAR, extension=Extension.REPEAT, divide=False, image=0, budget=None
):
    """Values at `uv` [n, 2], as float64 [n, 4], and the upload's warnings."""
    uploaded = ImageCache().upload(images if isinstance(images, (list, tuple)) else [images], DEVICE, budget)
    asked = Asked()
    asked.image, asked.interpolation, asked.extension, asked.divide = (
        image,
        int(interpolation),
        int(extension),
        int(divide),
    )
    uv = np.asarray(uv, np.float32).reshape(-1, 2)
    out = wp.empty(len(uv), dtype=wp.vec4, device=DEVICE)
    wp.launch(probe, len(uv), [uploaded.table, wp.array(uv, dtype=wp.vec2, device=DEVICE), asked], [out], device=DEVICE)
    return out.numpy().astype(float), uploaded.warnings


def points(count=500, low=-2.5, high=3.5):
    return RNG.uniform(low, high, (count, 2)).astype(np.float32)


# --- a plain reference


def texel_index(i, size, extension):
    """Texel at index `i`, and whether there is one."""
    if extension == Extension.REPEAT:
        return i % size, np.ones(i.shape, bool)
    if extension == Extension.MIRROR:
        m = i % (2 * size)
        return np.minimum(m, 2 * size - 1 - m), np.ones(i.shape, bool)
    return np.clip(i, 0, size - 1), (i >= 0) & (i < size) if extension == Extension.CLIP else np.ones(i.shape, bool)


def weights(interpolation, t):
    if interpolation == Interpolation.CLOSEST:
        return [(0, np.ones_like(t))]
    if interpolation == Interpolation.LINEAR:
        return [(0, 1 - t), (1, t)]
    return [
        (-1, (1 - t) ** 3 / 6),
        (0, (3 * t**3 - 6 * t**2 + 4) / 6),
        (1, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6),
        (2, t**3 / 6),
    ]


def reference(pixels, uv, interpolation, extension):
    """Look-up in `pixels`, floats [h, w, 4], written plainly."""
    size = np.array(pixels.shape[1::-1])
    shift = 0.0 if interpolation == Interpolation.CLOSEST else 0.5
    at = uv.astype(float) * size - shift
    base = np.floor(at).astype(int)
    total = np.zeros((len(uv), 4))
    for dy, wy in weights(interpolation, (at - base)[:, 1]):
        for dx, wx in weights(interpolation, (at - base)[:, 0]):
            x, in_x = texel_index(base[:, 0] + dx, size[0], extension)
            y, in_y = texel_index(base[:, 1] + dy, size[1], extension)
            total += (wx * wy * in_x * in_y)[:, None] * pixels[y, x]
    return total


def decoded(x):
    return np.where(x < 0.04045, np.maximum(x, 0) / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


# --- tests


@pytest.mark.parametrize("extension", Extension)
@pytest.mark.parametrize("interpolation", Interpolation)
def test_every_interpolation_with_every_extension(interpolation, extension):
    pixels = RNG.random((5, 7, 4)).astype(np.float32)
    uv = points()
    away = np.abs(uv * (7, 5) - np.rint(uv * (7, 5))).min(1) > 1e-4  # rounding decides at edges of texels
    values, warnings = look_up(Image("i", pixels), uv, interpolation, extension)
    assert warnings == []
    assert np.abs(values - reference(pixels.astype(float), uv, interpolation, extension))[away].max() < ROUNDING


@pytest.mark.parametrize("dtype", ["uint8", "float16", "float32"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_every_kind_of_pixels(dtype, channels):
    pixels = BYTES[..., :channels] if dtype == "uint8" else RNG.normal(0, 1, (6, 3, channels)).astype(dtype)
    full = pixels / 255.0 if dtype == "uint8" else pixels.astype(float)
    if channels == 1:
        full = np.repeat(full, 3, 2)
    if channels < 4:
        full = np.concatenate([full, np.ones((*full.shape[:2], 1))], 2)
    uv = points()
    values, _ = look_up(Image("i", pixels), uv)
    assert np.abs(values - reference(full, uv, Interpolation.LINEAR, Extension.REPEAT)).max() < 2e-5


@pytest.mark.parametrize("divide", [False, True])
@pytest.mark.parametrize("encoding", list(ImageEncoding))
@pytest.mark.parametrize("extension", list(Extension))
@pytest.mark.parametrize("interpolation", list(Interpolation))
def test_opaque_bytes_without_alpha_are_the_same_texels_to_the_bit(interpolation, extension, encoding, divide):
    opaque = BYTES.copy()
    opaque[..., 3] = 255
    uv = points()
    with_alpha, without = (
        look_up(Image("i", pixels, encoding), uv, interpolation, extension, divide)[0]
        for pixels in (opaque, opaque[..., :3])
    )
    assert np.array_equal(with_alpha, without)


def test_every_byte_is_its_255th_part():
    ramp = np.arange(256, dtype=np.uint8).reshape(1, 256, 1)
    uv = np.column_stack([(np.arange(256) + 0.5) / 256, np.full(256, 0.5)])
    expected = np.arange(256, dtype=np.float32) * np.float32(1 / 255)
    for channels in (1, 3, 4):
        values, _ = look_up(Image("i", np.repeat(ramp, channels, 2)), uv, Interpolation.CLOSEST)
        assert np.array_equal(values[:, 0], expected) and np.array_equal(values[:, 2], expected)


def test_opaque_bytes_take_three_bytes_on_a_cpu_and_four_on_a_gpu():
    pixels = np.zeros((16, 16, 3), np.uint8)
    taken = ImageCache().upload([Image("i", pixels)], DEVICE).keep[0]
    assert taken.capacity == 16 * 16 * (4 if wp.get_device(DEVICE).is_cuda else 3)


def test_srgb_is_decoded_after_interpolation_and_alpha_stays():
    uv = points()
    values, _ = look_up(Image("i", BYTES, ImageEncoding.SRGB), uv)
    stored = reference(BYTES / 255.0, uv, Interpolation.LINEAR, Extension.REPEAT)
    assert np.abs(values[:, :3] - decoded(stored[:, :3])).max() < ROUNDING
    assert np.abs(values[:, 3] - stored[:, 3]).max() < ROUNDING


def test_alpha_is_divided_out_before_decoding():
    pixels = BYTES.copy()
    pixels[..., :3] = pixels[..., :3].astype(int) * pixels[..., 3:] // 255
    pixels[0, 0] = pixels[0, 1] = pixels[1, 0] = pixels[1, 1] = 0
    uv = np.concatenate([points(), [[1 / 7, 1 / 5]]])
    values, _ = look_up(Image("i", pixels, ImageEncoding.SRGB), uv, divide=True)
    stored = reference(pixels / 255.0, uv, Interpolation.LINEAR, Extension.REPEAT)
    usual = stored[:, 3] > 1e-3
    expected = decoded(stored[:, :3] / np.where(usual, stored[:, 3], 1)[:, None])
    assert np.abs(values[:, :3] - expected)[usual].max() < 2e-5
    assert np.all(values[-1] == 0)


def test_tiles():
    one, two, three = (np.full((2, 2, 4), v, np.uint8) for v in (51, 102, 153))
    image = Image("udim", tiles=((1001, one), (1012, two), (1002, three)))
    uv = [(0.5, 0.5), (1.5, 1.5), (1.5, 0.5), (0.5, 1.5), (2.5, 0.5), (-0.5, 0.5), (-1.5, 0.5)]
    uv += [(0.5, -2), (10.5, 0.5), (0.5, 3.0), (1e9, 1e30)]
    values, _ = look_up([Image("other", BYTES), image], uv, image=1)
    assert np.allclose(values[:3, 0], (0.2, 0.4, 0.6))
    assert np.allclose(values[5, 0], 0.2)  # truncation: Cycles too uses the first tile
    assert np.all(values[[3, 4, 6, 7, 8, 9, 10]] == MAGENTA)


@pytest.mark.parametrize("interpolation", Interpolation)
@pytest.mark.parametrize("extension", Extension)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (4096, 2)])
def test_any_coordinate_gives_a_finite_value(interpolation, extension, size):
    special = [0, -0.0, 1, -1, 0.5, 1e-45, -1e-45, 1e7, -1e7, 1e7 + 1, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan]
    special += [2**31, -(2**31), 2**24 + 2.0]
    uv = [(u, v) for u in special for v in special]
    values, _ = look_up(Image("i", np.full((size[1], size[0], 4), 0.25, np.float32)), uv, interpolation, extension)
    assert np.all(np.isfinite(values)) and values.min() >= 0 and values.max() <= 0.2500001
    if extension != Extension.CLIP:
        assert np.allclose(values, 0.25)
    tiles, _ = look_up(Image("i", tiles=((1001, BYTES), (1055, BYTES))), uv, interpolation, extension)
    assert np.all(np.isfinite(tiles))


def test_missing_images_are_magenta():
    assert np.all(look_up([], [(0.5, 0.5)])[0] == MAGENTA)
    assert np.all(look_up(Image("i", BYTES), [(0.5, 0.5)], image=-1)[0] == MAGENTA)
    assert np.all(look_up(Image("i"), [(0.5, 0.5)])[0] == MAGENTA)
    values, warnings = look_up(Image("Empty", np.zeros((0, 3, 4), np.uint8)), [(0.5, 0.5)])
    assert np.all(values == MAGENTA) and "“Empty”" in warnings[0] and "no pixels" in warnings[0]
    values, warnings = look_up(Image("Odd", np.zeros((2, 2, 4), np.int64)), [(0.5, 0.5)])
    assert np.all(values == MAGENTA) and "“Odd”" in warnings[0]
    values, warnings = look_up(Image("Tiles", tiles=((1, BYTES), (1001, BYTES), (99999, BYTES))), [(0.5, 0.5)])
    assert np.all(np.isfinite(values)) and len(warnings) == 2 and "tile 99999" in warnings[1]


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_texels_that_are_not_finite_are_black_and_counted(dtype):
    pixels = np.ones((4, 4, 4), dtype)
    pixels[1, 2, 0], pixels[3, 3, 3], pixels[0, 0] = np.inf, np.nan, -np.inf
    values, warnings = look_up(
        Image("Sky", pixels), [((x + 0.5) / 4, (y + 0.5) / 4) for y in range(4) for x in range(4)]
    )
    assert "“Sky”" in warnings[0] and warnings[0].count("3 texels") == 1
    assert (
        np.all(np.isfinite(values))
        and np.count_nonzero(np.all(values == 0, 1)) == 3
        and np.count_nonzero(np.all(values == 1, 1)) == 13
    )
    assert np.isinf(pixels[1, 2, 0])  # the caller's array is unchanged


def test_extreme_texels_stay_finite():
    pixels = np.full((2, 2, 4), 3e38, np.float32)
    pixels[0, :, 3] = 1e-42
    for divide in (False, True):
        for interpolation in Interpolation:
            assert np.all(np.isfinite(look_up(Image("i", pixels), points(), interpolation, divide=divide)[0]))


def test_images_too_large_are_scaled_down_and_named():
    large, small = (
        Image("Large", np.full((256, 512, 4), 100, np.uint8)),
        Image("Small", np.full((64, 64, 4), 50, np.uint8)),
    )
    values, warnings = look_up([large, small], points(), image=0, budget=100_000)
    assert np.allclose(values[:, 0], 100 / 255)
    assert len(warnings) == 1 and "“Large”" in warnings[0] and "512 x 256 to 128 x 64" in warnings[0]
    cache = ImageCache()
    assert cache.upload([large, small], DEVICE, 100_000).bytes < 100_000 + 1000
    assert cache.upload([large, small], DEVICE, 0).bytes > 0  # as small as it can be, without an error


def test_halving_takes_means_and_keeps_odd_edges():
    pixels = np.arange(15, dtype=np.float32).reshape(3, 5, 1)
    assert np.allclose(halved(pixels)[..., 0], [[3, 5, 6.5], [10.5, 12.5, 14]])
    assert halved(np.full((3, 1, 4), 255, np.uint8)).tolist() == [[[255] * 4]] * 2
    assert np.all(np.isfinite(halved(np.full((2, 2, 1), 3e38, np.float32))))


def test_pictures_are_kept_while_their_arrays_are_the_same():
    cache = ImageCache()
    pixels = freeze(np.full((8, 8, 4), 9, np.uint8))
    first = cache.upload([Image("a", pixels)], DEVICE)
    second = cache.upload([Image("b", BYTES), Image("a", pixels), Image("again", pixels)], DEVICE)
    assert any(each is first.keep[0] for each in second.keep) and len(second.keep) == 2
    third = cache.upload([Image("a", pixels.copy())], DEVICE)
    assert third.keep[0] is not first.keep[0] and cache.device_bytes == third.keep[0].size * 4
    cache.clear()
    assert cache.device_bytes == 0


def test_pixels_that_may_change_are_checked_and_uploaded_again():
    cache = ImageCache()
    pixels = np.full((4, 4, 4), 0.5, np.float32)
    assert cache.upload([Image("a", pixels)], DEVICE).warnings == []
    pixels[1, 2] = np.nan
    second = cache.upload([Image("a", pixels)], DEVICE)
    assert "1 texels are infinite or not a number" in second.warnings[0]
    assert np.isfinite(second.keep[0].numpy()).all()


def test_arrays_that_may_not_be_written_can_be_uploaded():
    pixels = np.full((2, 2, 4), 51, np.uint8)
    pixels.flags.writeable = False
    assert np.allclose(look_up(Image("i", pixels), [(0.5, 0.5)])[0], 0.2)
    uv = points()
    assert np.array_equal(look_up(Image("i", np.asfortranarray(BYTES)), uv)[0], look_up(Image("i", BYTES), uv)[0])


def test_pixels_anywhere_in_memory_can_be_uploaded():
    flat = np.zeros(BYTES.size + 3, np.uint8)
    odd = flat[3:].reshape(BYTES.shape)
    odd[:] = BYTES
    uv = points()
    assert np.array_equal(look_up(Image("i", odd), uv)[0], look_up(Image("i", BYTES), uv)[0])
