"""Tiles that a GPU reads word by word are those that are copied one by one."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.native.structs import record_type, upload_records
from raybatch_addon.core.scene.description import ImageEncoding
from raybatch_addon.core.shading.images.levels import ImageLevels
from raybatch_addon.core.shading.images.tiled.pictures import TileSource, tiled_picture
from raybatch_addon.core.wavefront.textures import carry
from raybatch_addon.core.wavefront.textures.carry import TileCarrier, TileCopy, carry_tiles_kernel

SLOT = 1024  # bytes
KINDS = [("uint8", 1), ("uint8", 3), ("uint8", 4)]
KINDS += [(dtype, channels) for dtype in ("float16", "float32") for channels in (1, 3, 4)]


def source_of(shapes, dtype, device, staged) -> TileSource:
    """Pictures of random texels, where a GPU would read them; `staged`: it cannot."""
    source, random = TileSource(wp.get_device(device)), np.random.default_rng(1)
    for shape in shapes:
        pixels = random.integers(1, 200, shape).astype(dtype)
        made = tiled_picture(pixels, ImageLevels.NONE, ImageEncoding.LINEAR, SLOT, source.device)
        there = made.read[0]
        if there is None:
            there = wp.array(pixels.reshape(-1).view(np.uint8), device="cpu", copy=False)
        source.place(dataclasses.replace(made, read=[None if staged else there]))
    return source


@pytest.mark.parametrize("staged", [False, True])
@pytest.mark.parametrize("dtype, channels", KINDS)
def test_carried_tiles_are_those_that_are_copied(dtype, channels, staged, device, monkeypatch):
    monkeypatch.setattr(carry, "_THREADS", 100)
    monkeypatch.setattr(carry, "_STAGED_BYTES", 3 * SLOT)
    source = source_of([(37, 45, channels), (64, 33, channels)], dtype, device, staged)
    numbers = np.setdiff1d(np.arange(source.number_count), source.rows)[::-1].copy()
    slots = wp.zeros((len(numbers), SLOT), dtype=wp.uint8, device=device)
    carrier = TileCarrier(source, len(numbers))
    carried = carrier.carry(numbers, slots.ptr + SLOT * np.arange(len(numbers), dtype=np.uint64))
    carrier.wait()
    copied = [(np.zeros(SLOT, np.uint8), np.full(SLOT, 255, np.uint8)) for _ in numbers]
    assert carried == sum(source.copy_tile(int(number), zeros) for number, (zeros, _) in zip(numbers, copied))
    for number, found, (zeros, ones) in zip(numbers, slots.numpy(), copied):
        source.copy_tile(int(number), ones)
        inside = zeros == ones  # the rest is beyond the picture, and may be anything
        assert inside.any() and np.array_equal(found[inside], zeros[inside])


@pytest.mark.parametrize("shift", range(4))
def test_three_bytes_become_four_from_any_address(device, shift):
    random = np.random.default_rng(2)
    memory = random.integers(0, 255, shift + 5 * 11 * 3).astype(np.uint8)
    picture = memory[shift:].reshape(5, 11, 3)
    there, slot = wp.array(memory, device=device), wp.zeros(SLOT, dtype=wp.uint8, device=device)
    copy = np.zeros(1, record_type(TileCopy))
    copy["source"], copy["stride"] = there.ptr + shift + 3 * 8, 3 * 11  # from the eighth column on
    copy["target"], copy["rows"], copy["width"] = slot.ptr, 5, 3 * 3
    copy["stored"], copy["texel"], copy["row_words"], copy["fill"] = 3, 4, 16, 255
    copies = upload_records(copy, TileCopy, wp.get_device(device))
    threads = 100 if wp.get_device(device).is_cuda else 1
    wp.launch(carry_tiles_kernel, threads, [copies, (SLOT // 4).bit_length() - 1, threads], device=device)
    tile = slot.numpy().reshape(16, 16, 4)
    assert np.array_equal(tile[:5, :3, :3], picture[:, 8:]) and (tile[:5, :3, 3] == 255).all()
    assert not tile[5:].any() and not tile[:, 3:].any()
