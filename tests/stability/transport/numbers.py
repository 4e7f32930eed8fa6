"""Numbers at their ends: sizes of frames, counts of samples, seeds and frame numbers."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import numpy as np

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.description import Frame, Scene
from tests.stability.bench import SETTINGS, Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.lights.form_factors import sphere_form_factor
from tests.support import scenes

U = 2.0**-24
SEED_MAX = 2**31 - 1
SAMPLES_MAX = 2**32
_EXACT = "sums of samples are exact, and a mean is rounded once: no bit may differ"


def _beside_ball(frame: Frame) -> Scene:
    """A white floor next to a black ball in a white world, seen closely: every sample is 0 or 1, with a known mean."""
    ball = (scenes.sphere("ball", 96, 48), scenes.translation(0, 0, 1.5), scenes.material(name="black"))
    floor = (scenes.plane("floor", 8.0), scenes.IDENTITY, scenes.diffuse(1.0))
    view = scenes.camera(eye=(1, -1.5, 1.0), target=(1, 0, 0), half_width=2**-10)
    return scenes.scene([floor, ball], view=view, frame=frame, world=1.0)


MEAN = 1 - sphere_form_factor(1.0, 1.5, 1.0)
# error of the ball's form factor by its flat facets (both directions of 96 parts), and by the window's half width of
# 2^-10 in the camera's distance
MEAN_ERROR = (1 - MEAN) * (2 * (math.pi / 96) ** 2 + 4 * 2.0**-10 * 0.1)
_SHARE = """5 standard errors of a share of n independent samples; the ball's facets, 2 pi^2 / 96^2 of its form factor;
and the change of the form
    factor over the part of the floor that is seen"""


def _share_error(n: int) -> float:
    return 5 * math.sqrt(MEAN * (1 - MEAN) / n) + MEAN_ERROR


def _share(bench: Bench, frame: Frame, **change) -> tuple[float, int]:
    """Mean of the picture, and its number of samples."""
    film = bench.film(_beside_ball(frame), SETTINGS, nee="OFF", bounce_max=1, **change)
    return float(film.passes["Combined"][..., :3].astype(np.float64).mean()), int(film.counts.sum())


@case(
    "one pixel, one sample",
    "numbers",
    "A frame of 1 x 1 with 1 sample, 128 seeds: each is 0 or 1, and their mean the closed form.",
    _SHARE,
)
def one_sample(bench: Bench) -> Outcome:
    seeds = 128
    values = [_share(bench, Frame(1, 1), sample_count=1, seed=seed)[0] for seed in range(seeds)]
    if not set(values) <= {0.0, 1.0}:
        return Outcome(float(np.max(values)), 1.0, 0.0, "a sample that is neither 0 nor 1")
    return Outcome(float(np.mean(values)), MEAN, _share_error(seeds), f"{seeds} seeds")


@case(
    "one pixel, millions of samples",
    "numbers",
    "A frame of 1 x 1 with 1,000,000 independent samples (ten million on CUDA), each 0 or 1: their mean against the "
    "closed form.",
    _SHARE,
)
def millions_of_samples(bench: Bench) -> Outcome:
    mean, count = _share(bench, Frame(1, 1), sample_count=10_000_000 if bench.wp_device.is_cuda else 1_000_000)
    return Outcome(mean, MEAN, _share_error(count), f"{count:,} samples")


@case(
    "one pixel, ten million samples",
    "numbers",
    "A frame of 1 x 1 with 10,000,000 samples of a world of 0.1, which float32 cannot hold: the mean is the float32 "
    "next to 0.1, and the count right.",
    _EXACT,
    traces=False,
    quick=True,
)
def ten_million_samples(bench: Bench) -> Outcome:
    count = 10_000_000
    film = bench.film(scenes.scene(frame=Frame(1, 1), world=0.1), sample_count=count)
    if int(film.counts[0]) != count:
        return Outcome(float(film.counts[0]), count, 0, "samples")
    exact = Fraction(float(np.float32(0.1))) * count
    if float(film.sums.sums()[0, 0]) != float(exact):
        return Outcome(float(film.sums.sums()[0, 0]), float(exact), 0, "sum")
    return Outcome(float(film.passes["Combined"][0, 0, 0]), float(np.float32(0.1)), 0, "mean")


@case(
    "one row of 16384 pixels",
    "numbers",
    "Frames of 16384 x 1 and 1 x 16384 pixels: the mean against the closed form, and neighbours are alike as often as "
    "by chance.",
    _SHARE + ". Neighbours agree with the probability p^2 + (1 - p)^2",
    quick=True,
)
def one_row(bench: Bench) -> Outcome:
    sweep = Sweep()
    for width, height in ((16384, 1), (1, 16384)):
        picture = bench.render(_beside_ball(Frame(width, height)), nee="OFF", bounce_max=1, sample_count=1).reshape(
            -1, 3
        )[:, 0]
        sweep.add(picture.mean(), MEAN, _share_error(len(picture)), f"{width} x {height}")
        alike = MEAN**2 + (1 - MEAN) ** 2
        # pairs overlap: the variance is at most three times that of independent ones
        sweep.add(
            (picture[1:] == picture[:-1]).mean(),
            alike,
            5 * math.sqrt(3 * alike * (1 - alike) / len(picture)) + 2 * MEAN_ERROR,
            f"{width} x {height}, neighbours",
        )
    return sweep.outcome()


@case(
    "parts of a row",
    "numbers",
    "A row of 16384 pixels in four parts, the last one pixel wide: each is the same bits as in the whole.",
    "random numbers are of the pixel in the frame: no bit may differ",
)
def parts_of_a_row(bench: Bench) -> Outcome:
    frame, sweep = Frame(16384, 1), Sweep()
    change = dict(nee="OFF", bounce_max=1, sample_count=2)
    whole = bench.render(_beside_ball(frame), **change)
    for x0, x1 in ((0, 1), (1, 8192), (8192, 16383), (16383, 16384)):
        part = bench.render(_beside_ball(dataclasses.replace(frame, border=(x0, 0, x1, 1))), **change)
        sweep.add((part != whole[:, x0:x1]).sum(), 0, 0, f"{x0} to {x1}; values")
    return sweep.outcome()


@case(
    "corners of a frame of 2^32 pixels",
    "numbers",
    "The first and the last 64 x 64 pixels of a frame of 65536 x 65536: their means against the closed form, and they "
    "are different pictures.",
    _SHARE,
    quick=True,
)
def largest_frame(bench: Bench) -> Outcome:
    sweep, pictures = Sweep(), []
    for x in (0, 65536 - 64):
        picture = bench.render(
            _beside_ball(Frame(65536, 65536, border=(x, x, x + 64, x + 64))), nee="OFF", bounce_max=1
        )
        sweep.add(picture.mean(), MEAN, _share_error(picture[..., 0].size * SETTINGS.sample_count), f"pixels from {x}")
        pictures.append(picture)
    sweep.add(float(np.array_equal(*pictures)), 0, 0, "alike")
    return sweep.outcome()


@case(
    "ends of the range of seeds",
    "numbers",
    "Seeds 0, 1, 2^31 - 2 and 2^31 - 1: means against the closed form, and no two pictures alike.",
    _SHARE,
)
def end_seeds(bench: Bench) -> Outcome:
    sweep, pictures = Sweep(), []
    for seed in (0, 1, SEED_MAX - 1, SEED_MAX):
        picture = bench.render(_beside_ball(Frame(32, 32)), nee="OFF", bounce_max=1, seed=seed)
        sweep.add(picture.mean(), MEAN, _share_error(1024 * SETTINGS.sample_count), f"seed {seed}")
        sweep.add(sum(np.array_equal(picture, other) for other in pictures), 0, 0, f"pictures like that of seed {seed}")
        pictures.append(picture)
    return sweep.outcome()


@case(
    "last sample indices",
    "numbers",
    """The last 16 of 2^32 samples of each pixel, those about 2^31, and low-discrepancy ones likewise: means against the
    closed form. One index more is refused.""",
    _SHARE,
)
def last_samples(bench: Bench) -> Outcome:
    sweep, scene = Sweep(), _beside_ball(Frame(32, 32))
    settings = SETTINGS.replace(**bench.batching, nee="OFF", bounce_max=1)
    for sequence in ("INDEPENDENT", "SOBOL"):
        for first in (0, 2**31 - 8, SAMPLES_MAX - 16):
            film = bench.session.render(scene, settings.replace(sample_sequence=sequence), sample_first=first)
            bench.invalid_samples += film.statistics["invalid_samples"]
            bench.samples += int(film.counts.sum())
            mean = film.passes["Combined"][..., :3].astype(np.float64).mean()
            sweep.add(mean, MEAN, _share_error(int(film.counts.sum())), f"{sequence} from {first}")
    try:
        bench.session.render(scene, settings, sample_first=SAMPLES_MAX - 15)
        sweep.add(0, 1, 0, "refusals of 2^32 + 1")
    except RayBatchError:
        sweep.add(1, 1, 0, "refusals of 2^32 + 1")
    return sweep.outcome()


@case(
    "samples in ranges",
    "numbers",
    "Samples 0 to 17 of a frame in ranges of 1, 6 and 10, merged in any order: the same picture as in one render, bit "
    "for bit.",
    _EXACT,
)
def ranges(bench: Bench) -> Outcome:
    scene, sweep = _beside_ball(Frame(16, 16)), Sweep()
    settings = SETTINGS.replace(**bench.batching, bounce_max=1)
    whole = bench.film(scene, settings, sample_count=17).passes["Combined"]
    parts = [
        bench.session.render(scene, settings.replace(sample_count=count), sample_first=first)
        for first, count in ((0, 1), (1, 6), (7, 10))
    ]
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        a, b, c = (parts[i] for i in order)
        sweep.add((a.merge(b).merge(c).passes["Combined"] != whole).sum(), 0, 0, f"order {order}; values")
    return sweep.outcome()


@case(
    "cancelled at once",
    "numbers",
    "A render that is cancelled before it begins has a finite, empty film; resumed, it is that of one render, bit for "
    "bit.",
    _EXACT,
)
def cancelled_at_once(bench: Bench) -> Outcome:
    scene, settings = _beside_ball(Frame(16, 16)), SETTINGS.replace(**bench.batching, bounce_max=1)
    whole = bench.film(scene, settings).passes["Combined"]
    begun = bench.session.render(scene, settings, cancelled=lambda: True)
    if begun.complete or not np.isfinite(begun.passes["Combined"]).all():
        return Outcome(1, 0, 0, "the film says that it is complete, or is not finite")
    film = bench.session.render(scene, settings, resume=begun)
    return Outcome(float((film.passes["Combined"] != whole).sum()), 0, 0, "values")


@case(
    "no time",
    "numbers",
    "A time limit of 0 s is none: the same bits as without; one of 1 ns gives a valid picture of every pixel, with at "
    "least one sample.",
    _EXACT,
)
def no_time(bench: Bench) -> Outcome:
    scene = _beside_ball(Frame(16, 16))
    whole = bench.render(scene, bounce_max=1)
    if not np.array_equal(bench.render(scene, bounce_max=1, time_limit=0.0), whole):
        return Outcome(1, 0, 0, "a limit of 0 s changes the picture")
    film = bench.film(scene, bounce_max=1, sample_count=4096, time_limit=1e-9)
    picture = film.passes["Combined"][..., :3]
    counts = film.counts
    good = (
        np.isfinite(picture).all()
        and picture.min() >= 0
        and picture.max() <= 1
        and counts.min() >= 1
        and counts.min() == counts.max()
    )
    return Outcome(float(not good), 0, 0, f"{counts.min()} to {counts.max()} samples")


@case(
    "widths of pixel filters and windows",
    "numbers",
    "A white box around the camera in a furnace of 1, with every filter at its least and greatest width, and fields of "
    "view from 1e-6 rad to 179.99 degrees: 1.",
    "one product of 1 with 1 is exact: no bit may differ",
)
def widths(bench: Bench) -> Outcome:
    sweep = Sweep()

    def add(half_width: float, note: str, **change) -> None:
        view = scenes.camera(eye=(0.1, -0.2, 0.3), target=(0.7, 0.5, 0.4), half_width=half_width)
        scene = scenes.scene(
            [(scenes.box("box", 2.0), scenes.IDENTITY, scenes.emitter(1.0))], view=view, frame=Frame(16, 16)
        )
        picture = bench.render(scene, bounce_max=0, **change)
        sweep.add(picture.flat[np.abs(picture - 1).argmax()], 1, 0, note)

    for name in ("BLACKMAN_HARRIS", "GAUSSIAN", "BOX"):
        for width in (0.01, 10.0):
            add(0.5, f"{name} {width:g} pixels", pixel_filter=name, filter_width=width)
    for half_width in (1e-6, 1e-3, 1.0, math.tan(math.radians(179.99 / 2))):
        add(half_width, f"half width {half_width:g}")
    return sweep.outcome()
