"""Letters and ticks of the plots that Blender shows."""

import itertools
import math

import numpy as np
import pytest

from raybatch_addon.convergence.plot import SLOT_COLORS
from raybatch_addon.convergence.plotting import letters
from raybatch_addon.convergence.plotting.axes import LogAxis, number_text, seconds_text
from raybatch_addon.convergence.plotting.raster import Canvas
from raybatch_addon.convergence.records import RunStore


def test_text_is_readable_on_the_pane():
    """Contrast of letters, and of every slot's colour, against the pane (WCAG 2.1: 4.5 for text, 3 for what is
    drawn).
    """
    from raybatch_addon.convergence import plot

    def luminance(color):
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color]
        return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))

    def contrast(a, b):
        light, dark = sorted((luminance(a), luminance(b)), reverse=True)
        return (light + 0.05) / (dark + 0.05)

    for color in (plot._TEXT, plot._DIM_TEXT, *SLOT_COLORS):
        assert contrast(color, plot._PANE) > 4.5 and contrast(color, plot._BACKGROUND) > 4.5
    assert len(set(SLOT_COLORS)) == len(SLOT_COLORS) == len(RunStore()._slots)


def test_ticks_are_round_and_do_not_touch():
    for low, high in ((1e-5, 1e2), (0.9, 1.1), (3, 4), (1e-30, 1e30), (20, 7000), (1e-3, 1e7)):
        axis = LogAxis(low, high, 0, 300)
        for ticks, room in ((axis.ticks(20), 20), (axis.time_ticks(60), 60)):
            places = [axis.at(t) for t in ticks]
            assert places == sorted(places) and all(0 <= place <= 300 for place in places)
            assert all(b - a >= room - 1e-9 for a, b in itertools.pairwise(places)), (low, high, ticks)
    assert LogAxis(1e-4, 1, 0, 300).ticks(20) == pytest.approx(
        [m * 10.0**d for d in range(-4, 0) for m in (1, 2, 5)] + [1]
    )
    assert LogAxis(1e-4, 1, 0, 300).ticks(30) == pytest.approx([1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1])
    assert LogAxis(0.5, 4000, 0, 300).time_ticks(50) == [1, 10, 60, 600, 3600]


def test_axes_hold_what_they_are_made_around():
    for values in ([1.0], [1e-5, 3e4], [0.0, -1.0, math.nan, math.inf], [5.0, 5.0]):
        axis = LogAxis.around(values, 10, 210, 10.0)
        assert axis.high / axis.low >= 10 * (1 - 1e-9)
        for value in values:
            if value > 0 and math.isfinite(value):
                assert 10 < axis.at(value) < 210
    assert axis.at(0.0) == 10


def test_labels():
    assert [number_text(v) for v in (1, 0.5, 0.001, 1e-4, 2.5e-7, 999, 1000, 2.5e6, 1e12, 1e15)] == [
        "1",
        "0.5",
        "0.001",
        "1e-4",
        "2.5e-7",
        "999",
        "1k",
        "2.5M",
        "1T",
        "1e15",
    ]
    assert [seconds_text(v) for v in (1e-6, 0.02, 1.5, 59, 60, 600, 3600, 86400, 864_000, 3.2e10)] == [
        "1 us",
        "20 ms",
        "1.5 s",
        "59 s",
        "1 min",
        "10 min",
        "1 h",
        "1 d",
        "10 d",
        "1,014 years",
    ]


# --- the canvas


def test_lines_cover_as_much_as_they_are_long_and_wide():
    """A line of length l and width w with round ends has the area l w + pi w^2 / 4; smooth edges keep it, within the
    rim's rounding.
    """
    for ends in (((20.5, 20.5), (80.5, 20.5)), ((15, 10), (70, 90)), ((30, 80), (31, 20))):
        canvas = Canvas(100, 100, (0, 0, 0))
        canvas.line(ends, (1, 1, 1), 6.0)
        length = math.dist(*ends)
        assert canvas.pixels[..., 0].sum() == pytest.approx(length * 6 + math.pi * 9, rel=0.02)
    canvas.line([(-50, -50), (150, 150)], (1, 0, 0), clip=(40, 40, 60, 60))
    assert not canvas.pixels[:20, :20, 0].any() and canvas.pixels[50, 50, 0] > 0.9


def test_dashes_leave_half_of_a_line():
    solid, dashed = Canvas(220, 20, (0, 0, 0)), Canvas(220, 20, (0, 0, 0))
    solid.line([(10, 10), (210, 10)], (1, 1, 1), 1.0)
    dashed.line([(10, 10), (210, 10)], (1, 1, 1), 1.0, dash=10)
    round_ends = 10 * math.pi / 4  # of ten dashes, each a disc of diameter 1
    assert dashed.pixels[..., 0].sum() == pytest.approx(solid.pixels[..., 0].sum() / 2 + round_ends, rel=0.05)


@pytest.mark.parametrize("letter", sorted(letters._STROKES))
def test_every_letter_is_made_of_points_of_the_grid(letter):
    for stroke in letters.strokes_of(letter):
        assert len(stroke) >= 2 and all(0 <= x <= 4 and 0 <= y <= 8 for x, y in stroke)


def test_letters_differ_and_unknown_ones_are_boxes():
    def mask(text):
        canvas = Canvas(30, 30, (0, 0, 0))
        canvas.text(4, 8, text, 12, (1, 1, 1))
        return canvas.pixels[..., 0]

    known = [letter for letter in letters._STROKES if letter not in " x×jloOl0"]
    masks = {letter: mask(letter).tobytes() for letter in known}
    assert len(set(masks.values())) == len(known)
    assert mask("ß").any() and np.array_equal(mask("ß"), mask("ü"))
    assert not mask(" ").any()


def test_text_beyond_the_edges_is_cut():
    canvas = Canvas(40, 12, (0, 0, 0))
    for x, y in ((-20, 3), (30, 3), (5, -6), (5, 9), (-500, 500)):
        canvas.text(x, y, "Wide text", 8, (1, 1, 1))
    canvas.rectangle(-5, -5, 3, 3, (1, 0, 0))
    assert canvas.pixels[0, 0, 0] == 1 and np.isfinite(canvas.pixels).all()
