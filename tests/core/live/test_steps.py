"""How a live picture grows: sides of pixels, counts of samples, and frames of coarse pixels."""

from itertools import pairwise

import numpy as np
import pytest

from raybatch_addon.core.live.steps import COARSEST, FIRST_SECONDS, UNKNOWN, Pace, coarse
from raybatch_addon.core.scene.description import Frame, Scene
from tests.support.scenes import camera


def test_sides_halve_from_the_finest_that_comes_in_time():
    pace = Pace()
    assert pace.divisors(500_000) == [UNKNOWN, 2, 1]
    pace.note(500_000, 1.0)  # a slow machine
    found = pace.divisors(500_000)
    assert found[-1] == 1 and all(a == 2 * b for a, b in pairwise(found))
    assert pace.seconds(500_000 / found[0] ** 2) <= FIRST_SECONDS
    assert pace.seconds(500_000 / (found[0] / 2) ** 2) > FIRST_SECONDS
    pace.note(500_000, 1000.0)
    assert pace.divisors(500_000)[0] == COARSEST
    pace.note(500_000, 0.01)
    assert pace.divisors(500_000) == [1]


def test_marks_hold_all_powers_of_two_and_the_end():
    pace = Pace()
    assert pace.marks(100, 1000) == [1, 2, 4, 8, 16, 32, 64, 100]
    pace.note(1000, 0.6)
    assert pace.marks(5, 1000) == [1, 2, 3, 4, 5]
    assert pace.marks(5, 1000, powers_alone=True) == [1, 2, 4, 5]
    pace.note(1000, 0.0)  # a sample is free: more pictures would only cost
    assert len(pace.marks(1000, 1000)) < 80
    assert pace.marks(1, 1000) == [1]


@pytest.mark.parametrize("side", [1, 2, 3, 8])
def test_coarse_pixels_lie_where_the_fine_ones_do(side):
    whole = Scene(camera(half_width=0.5, aspect=2.0), Frame(97, 41, border=(10, 5, 50, 41)))
    small = coarse(whole, side)
    left, right, bottom, _ = whole.camera.window
    step = (right - left) / 97
    assert np.isclose((small.camera.window[1] - small.camera.window[0]) / small.frame.width, step * side)
    assert small.camera.window[0] == left and small.camera.window[2] == bottom
    x0, y0, x1, y1 = small.frame.border
    assert x0 * side <= 10 and y0 * side <= 5 and x1 * side >= 50 and y1 * side >= 41
    assert small.frame.width * side >= 97 and x1 <= small.frame.width and y1 <= small.frame.height
