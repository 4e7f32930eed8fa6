"""Pictures in tiles as they wait in the host's memory."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.scene.description import ImageEncoding
from raybatch_addon.core.shading.images.image_upload import ImageCache
from raybatch_addon.core.shading.images.levels import ImageLevels, coarser_levels
from raybatch_addon.core.shading.images.textures import Texels
from raybatch_addon.core.shading.images.tiled.look_up import COLUMN_SHIFT, KIND_MASK, ROW_SHIFT
from raybatch_addon.core.shading.images.tiled.pictures import TiledImage, tile_bits

KINDS = [
    (np.uint8, 1),
    (np.uint8, 3),
    (np.uint8, 4),
    (np.float16, 1),
    (np.float16, 3),
    (np.float32, 1),
    (np.float32, 4),
]


def picture(dtype, channels, height=77, width=141):
    values = np.random.default_rng(3).random((height, width, channels)) * (255 if dtype == np.uint8 else 2)
    return values.astype(dtype)


def uploaded(*images):
    return ImageCache().upload(images, wp.get_device("cpu"))


def pieces(source, entry, channels, dtype):
    """The picture of an entry, put together from its tiles."""
    columns_bits = (int(entry["texels"]) >> COLUMN_SHIFT) & KIND_MASK
    row_bits = int(entry["texels"]) >> ROW_SHIFT
    high, wide = 1 << row_bits, 1 << columns_bits
    height, width = int(entry["height"]), int(entry["width"])
    whole = np.zeros((-(-height // high) * high, -(-width // wide) * wide, channels), dtype)
    number = int(entry["address"]) // 8
    for y in range(0, height, high):
        for x in range(0, width, wide):
            number += 1
            slot = np.zeros(source.slot_bytes, np.uint8)
            source.copy_tile(number, slot)
            size = high * wide * channels * np.dtype(dtype).itemsize
            whole[y : y + high, x : x + wide] = slot[:size].view(dtype).reshape(high, wide, channels)
    return whole[:height, :width]


@pytest.mark.parametrize("dtype, channels", KINDS, ids=str)
def test_tiles_hold_the_texels_of_their_picture(dtype, channels):
    pixels = picture(dtype, channels)
    done = uploaded(TiledImage("tiled", pixels, slot_bytes=1024))
    stored = 4 if channels == 3 and dtype != np.uint8 else channels
    (entry,) = done.tiled.entries
    back = pieces(done.tiled, entry, stored, dtype)
    assert np.array_equal(back[..., :channels], pixels) and (stored == channels or np.all(back[..., 3] == 1))
    assert done.table.entries.numpy()[0]["texels"] == int(Texels.MISSING)  # for who cannot wait


@pytest.mark.parametrize("kind", [each for each in Texels if each is not Texels.MISSING])
def test_a_tile_fills_its_slot(kind):
    columns, rows = tile_bits(kind, 1 << 16)
    texel = {Texels.BYTE: 1, Texels.HALF: 2, Texels.HALF4: 8, Texels.FLOAT4: 16}.get(kind, 4)
    assert texel << columns + rows == 1 << 16 and columns - rows in (0, 1)


def test_large_levels_are_in_tiles_and_small_ones_whole():
    pixels = picture(np.uint8, 4, 128, 256)
    levels = coarser_levels(pixels, ImageEncoding.SRGB, ImageLevels.PLAIN)
    done = uploaded(TiledImage("tiled", pixels, ImageEncoding.SRGB, levels=ImageLevels.PLAIN, slot_bytes=4096))
    entries = done.tiled.entries
    tiled = entries["texels"] > KIND_MASK
    assert tiled.tolist() == [True, True, True] + [False] * 6 and entries[0]["tile_first"] == 1
    for entry, level in zip(entries[1:3], levels):
        assert np.array_equal(pieces(done.tiled, entry, 4, np.uint8), level)
    assert done.bytes - done.level_bytes < 1000 and done.level_bytes == sum(each.nbytes for each in levels[2:])
    assert done.tiled.tile_count == 32 + 8 + 2 and done.tiled.number_count == 32 + 8 + 2 + 3


def test_a_frozen_picture_is_kept_and_a_small_one_is_whole():
    cache, device = ImageCache(), wp.get_device("cpu")
    pixels = picture(np.float16, 4)
    pixels.flags.writeable = False
    image = TiledImage("tiled", pixels, levels=ImageLevels.PLAIN, slot_bytes=1024)
    first = cache.upload([image], device)
    again = cache.upload([image], device)
    assert first.keep[0] is again.keep[0]
    small = cache.upload([TiledImage("small", pixels[:4, :4], slot_bytes=1024)], device)
    assert small.tiled is None and small.table.entries.numpy()[0]["texels"] == int(Texels.HALF4)
