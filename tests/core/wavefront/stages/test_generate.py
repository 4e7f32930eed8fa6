"""Where camera rays start."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.wavefront.stages.generate import pixel_in_blocks, pixel_sample
from raybatch_addon.core.wavefront.stages.work import TileWork
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def places(width: int, height: int, result: wp.array(dtype=wp.vec2i)):
    result[wp.tid()] = pixel_in_blocks(wp.tid(), width, height)


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (16, 24), (19, 13), (7, 30), (30, 7), (128, 3)])
def test_every_pixel_of_a_tile_is_walked_once_and_neighbours_are_near(size):
    width, height = size
    result = wp.zeros(width * height, dtype=wp.vec2i, device=DEVICE)
    wp.launch(places, width * height, [width, height, result], device=DEVICE)
    walked = result.numpy()
    assert len({tuple(place) for place in walked.tolist()}) == width * height
    assert walked.min() >= 0 and (walked.max(0) < size).all()
    if width >= 8 and height >= 8:
        assert np.ptp(walked[:64], axis=0).tolist() == [7, 7]


@wp.kernel(**KERNEL_OPTIONS)
def meanings(work: TileWork, numbers: wp.array(dtype=wp.uint32), result: wp.array2d(dtype=wp.int64)):
    i = wp.tid()
    found = pixel_sample(work, numbers[i])
    result[i, 0] = wp.int64(found.x)
    result[i, 1] = wp.int64(found.y)
    result[i, 2] = wp.int64(found.index)
    result[i, 3] = wp.int64(found.sample)


@pytest.mark.parametrize("pixel_first", [0, 1])
@pytest.mark.parametrize(
    "sample_first, sample_count, base",
    [(0, 5, 0), (7, 100, 33), (3, 2**32 - 3, 2**33 + 1), (0, 2**32, 0), (9, 2**31, 2**32 - 50)],
)
def test_the_number_of_a_path_gives_its_pixel_and_sample(pixel_first, sample_first, sample_count, base):
    work = TileWork()
    work.x, work.y, work.width, work.height, work.frame_width = 100, 50, 19, 13, 1000
    work.sample_first, work.sample_count, work.pixel_first, work.item_base = (
        sample_first,
        sample_count,
        pixel_first,
        base,
    )
    last = min(19 * 13 * sample_count - base, 2**32) - 1
    numbers = sorted({n for n in (0, 1, 2, 63, 64, 65, 246, 247, 248, 1000, 2**31, last - 1, last) if n <= last})
    result = wp.zeros((len(numbers), 4), dtype=wp.int64, device=DEVICE)
    wp.launch(
        meanings, len(numbers), [work, wp.array(np.array(numbers, np.uint32), device=DEVICE), result], device=DEVICE
    )
    walked = wp.zeros(19 * 13, dtype=wp.vec2i, device=DEVICE)
    wp.launch(places, 19 * 13, [19, 13, walked], device=DEVICE)
    for number, found in zip(numbers, result.numpy().tolist()):
        pixel, sample = divmod(base + number, sample_count) if pixel_first else divmod(base + number, 19 * 13)[::-1]
        x, y = walked.numpy()[pixel].tolist()
        assert found == [100 + x, 50 + y, y * 19 + x, sample_first + sample], number
