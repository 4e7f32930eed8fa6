"""Where camera rays start."""

import numpy as np
import pytest
import warp as wp
from under_test import DEVICE

from raybatch_addon.core.kernel import KERNEL_OPTIONS
from raybatch_addon.core.wavefront.stages.generate import pixel_in_blocks


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
