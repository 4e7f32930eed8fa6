"""Error against samples of whole renders, measured with an implementation of their own, with closed forms and with
halves.
"""

import math

import numpy as np
import pytest

from raybatch_addon.core.convergence.points import ConvergenceRecorder, Reference, fit_slope, noise_floor, rmse, time_to
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.references import reference_of_runs
from tests.twins import float64_tracer

pytestmark = pytest.mark.usefixtures("general_kernels")

BOUNCES, SEEDS = 2, 8
SETTINGS = RenderSettings(
    pixel_filter="BOX",
    bounce_max=BOUNCES,
    roulette_bounce=1,
    sample_sequence="INDEPENDENT",
    sample_count=256,
    thread_count=1,
)
# Student's t with 7 degrees of freedom is within this in 999 of 1000 cases
T_LIMIT = 5.41


@pytest.fixture(scope="module")
def room():
    """A box on a floor before a wall, under a lamp and a blue sky."""
    lamp = np.array([[1, 0, 0, 0.3], [0, -1, 0, -0.2], [0, 0, -1, 2.2]], np.float32)
    wall = np.array([[1, 0, 0, 0], [0, 0, -1, 1.5], [0, 1, 0, 1]], np.float32)
    c, s = math.cos(0.5), math.sin(0.5)
    box = np.array([[c, -s, 0, -0.3], [s, c, 0, 0.3], [0, 0, 1, 0.5]], np.float32)
    return scenes.scene(
        [
            (scenes.plane("floor", 6), scenes.IDENTITY, scenes.diffuse((0.7, 0.6, 0.4))),
            (scenes.box("box", 1.0), box, scenes.diffuse((0.3, 0.5, 0.8))),
            (scenes.plane("wall", 6), wall, scenes.diffuse(0.8)),
            (scenes.plane("lamp", 0.8), lamp, scenes.emitter(6.0)),
        ],
        view=scenes.camera(eye=(0.4, -4, 1.6), target=(0, 0, 0.6), half_width=0.4, aspect=4 / 3),
        frame=Frame(16, 12),
        world=(0.1, 0.15, 0.2),
    )


@pytest.fixture(scope="module")
def truth(room) -> Reference:
    """By the float64 tracer: eight independent pictures show what its own noise is."""
    return reference_of_runs(float64_tracer.render_runs(room, 4096, BOUNCES, runs=8), "float64", 4096)


def recorded(session, scene, **changes):
    """The film and its recorder."""
    recorder = ConvergenceRecorder()
    film = session.render(scene, SETTINGS.replace(**changes), observers=[recorder])
    assert film.statistics["invalid_samples"] == 0
    return film, recorder


def colors(film) -> np.ndarray:
    return film.passes["Combined"][..., :3]


@pytest.fixture(scope="module")
def slopes(session, room, truth):
    """By sequence, those of renders with different seeds."""
    return {
        sequence: [
            fit_slope(recorded(session, room, seed=seed, sample_sequence=sequence)[1].points(truth))
            for seed in range(SEEDS)
        ]
        for sequence in ("INDEPENDENT", "SOBOL")
    }


# --- the tracer that is the truth


def test_the_float64_tracer_sums_the_geometric_series_in_a_closed_box():
    """A box that emits 1 and reflects half. Light from points on its walls varies; of eight pictures the mean is within
    their spread.
    """
    both = scenes.material(Closure(ClosureKind.EMISSION, (1, 1, 1)), Closure(ClosureKind.DIFFUSE, (0.5, 0.25, 0.0)))
    box = scenes.scene([(scenes.box(), scenes.IDENTITY, both)], frame=Frame(4, 4), view=scenes.camera(eye=(0, -0.5, 0)))
    runs = float64_tracer.render_runs(box, 4096, 2, runs=SEEDS).mean(axis=(1, 2))
    expected = [sum(albedo**k for k in range(4)) for albedo in (0.5, 0.25, 0.0)]
    spread = runs.std(axis=0, ddof=1) / math.sqrt(SEEDS)
    assert (spread[:2] < 0.01).all() and spread[2] == 0
    assert (np.abs(runs.mean(axis=0) - expected) <= T_LIMIT * spread).all()


def test_the_float64_tracer_sees_the_world_and_refuses_what_it_does_not_know():
    ball = scenes.scene(
        [(scenes.sphere(segments=8, rings=4), scenes.IDENTITY, scenes.diffuse(1.0))], frame=Frame(4, 4), world=1.0
    )
    # a convex white body in a white world: every path brings exactly 1
    assert np.abs(float64_tracer.render(ball, 4, 1) - 1).max() < 1e-12
    metal = scenes.material(Closure(ClosureKind.METAL, (0.9, 0.9, 0.9)), name="metal")
    for scene, message in (
        (scenes.scene(lights=[scenes.sun()]), "no other lights"),
        (scenes.scene([(scenes.plane(), scenes.IDENTITY, metal)]), "metal is METAL"),
        (scenes.scene(view=scenes.camera(lens_radius=0.1)), "pinhole"),
        (scenes.scene([(scenes.sphere(smooth=True), scenes.IDENTITY, scenes.diffuse())]), "flat"),
    ):
        with pytest.raises(ValueError, match=message):
            float64_tracer.render(scene, 1, 1)


# --- slopes


def test_the_truth_is_fine_enough(truth):
    """The truth's noise is a fraction of what it is to measure: at 256 samples the error is 0.003 (`slopes`)."""
    assert 0 < noise_floor(truth)[0] < 0.001


def test_the_error_of_independent_samples_falls_with_the_root(slopes):
    """The mean over seeds is -0.5 within Student's t of the spread over seeds. What else there is: the truth's noise is
    subtracted to a few percent of itself, which is 7 % of the last point: 1e-3 of slope. The logarithm of a mean square
    over 192 pixels is low by 1 % where pixels have kurtosis 5, at one sample, and less later: 1e-3 of slope."""
    values = np.array([slope.slope for slope in slopes["INDEPENDENT"]])
    error = values.std(ddof=1) / math.sqrt(SEEDS)
    assert abs(values.mean() + 0.5) < T_LIMIT * error + 2e-3 < 0.05
    # what each says of its own uncertainty is what seeds show: chi-squared with 7 degrees of freedom is within 0.6 and
    # 24.3 in 998 of 1000
    spread = math.sqrt(np.mean([slope.spread**2 for slope in slopes["INDEPENDENT"]]))
    assert math.sqrt(0.6 / 7) < values.std(ddof=1) / spread < math.sqrt(24.3 / 7)


def test_the_error_of_low_discrepancy_samples_falls_faster(slopes):
    values = np.array([slope.slope for slope in slopes["SOBOL"]])
    assert -0.5 - values.mean() > T_LIMIT * values.std(ddof=1) / math.sqrt(SEEDS)
    assert sum("steeper" in slope.says for slope in slopes["SOBOL"]) >= SEEDS // 2


def test_no_unbiased_render_is_called_biased(slopes):
    assert not any(slope.flattens for found in slopes.values() for slope in found)


def test_a_biased_film_is_flagged(session, room, truth):
    """Clamping takes light away: the error stops where its share is lost, and halves do not see it."""
    for seed in range(4):
        _film, recorder = recorded(
            session, room, seed=seed, clamp_direct=0.15, clamp_indirect=0.15, error_estimate="ON"
        )
        points = recorder.points(truth)
        slope = fit_slope(points)
        assert slope.flattens and "bias" in slope.says
        assert time_to(points, truth_target := points[-1].relmse / 100, slope) is None and truth_target > 0
        assert recorder.points()[-1].rmse < points[-1].rmse / 2


def test_an_error_against_a_closed_form(session):
    """The irradiance below the centre of a square light (Howell's catalogue, B-3), seen through pixels so small that it
    is constant.
    """
    half, height, radiance = 0.7, 0.9, 3.0
    root = math.sqrt(1 + (half / height) ** 2)
    expected = radiance * 4 * (2 * half / height / root * math.atan(half / height / root) / (2 * math.pi))
    scene = scenes.scene(
        [(scenes.plane(size=4), scenes.IDENTITY, scenes.diffuse(1.0))],
        lights=[scenes.area_light(radiance, 2 * half, scenes.translation(0, 0, height))],
        view=scenes.camera(eye=(0.0, -1e-3, 1.0), half_width=1e-4),
        frame=Frame(16, 16),
    )
    exact = Reference(np.full((16, 16, 3), expected), np.zeros((16, 16, 3)), "closed form")
    slope = fit_slope(recorded(session, scene, bounce_max=0)[1].points(exact))
    # nine points, so Student's t with 7 degrees of freedom
    assert abs(slope.slope + 0.5) < T_LIMIT * slope.spread < 0.2 and not slope.flattens


# --- halves


@pytest.mark.parametrize("sequence", ["INDEPENDENT", "SOBOL"])
def test_halves_give_the_error_against_the_truth(session, room, truth, sequence):
    """In each pixel, (A - B)^2 / 4 and ((A + B) / 2 - truth)^2 less the truth's variance have one mean. Pixels are
    independent, so the mean of their difference over 192 pixels is normal with the spread that they show (their
    channels are not: those are averaged first)."""
    differences, errors = [], []
    for seed in range(4):
        film, recorder = recorded(
            session, room, seed=100 + seed, sample_count=32, sample_sequence=sequence, error_estimate="ON"
        )
        a, b = (half.astype(np.float64) for half in recorder.snapshots[-1].halves)
        error = np.square(colors(film) - truth.picture) - truth.variance
        differences.append((np.square(a - b) / 4 - error).mean(axis=-1).ravel())
        errors.append(error.mean())
        # the estimate that ends a render, and that of the recorder, are one; of float32 pictures
        said, point = film.statistics["error"], recorder.points()[-1]
        assert (said["relmse"], said["rmse"]) == pytest.approx((point.relmse, point.rmse), rel=1e-5)
    for difference in [*differences, np.mean(differences, axis=0)]:
        assert abs(difference.mean()) < 4 * difference.std(ddof=1) / math.sqrt(difference.size)
    spread = np.mean(differences, axis=0).std(ddof=1) / math.sqrt(differences[0].size)
    assert 4 * spread < np.mean(errors)  # so an estimate that were half or twice the error would be seen


def test_odd_counts_of_samples_have_halves_too(session, room):
    film, recorder = recorded(session, room, sample_count=5, error_estimate="ON")
    points = recorder.points()
    assert [p.samples for p in points] == [2, 4, 5] and points[-1].from_halves
    assert film.statistics["error"]["rmse"] == pytest.approx(points[-1].rmse, rel=1e-5)


# --- what recording changes


@pytest.mark.parametrize(
    "changes", [{}, {"error_estimate": "ON", "sample_sequence": "SOBOL"}, {"tile_size": 7, "sample_count": 21}]
)
def test_recording_changes_no_bit_of_the_film(session, room, changes):
    settings = SETTINGS.replace(sample_count=32).replace(**changes)
    recorder = ConvergenceRecorder()
    watched, alone = session.render(room, settings, observers=[recorder]), session.render(room, settings)
    assert [s.samples for s in recorder.snapshots][-2:] == [16, settings.sample_count]
    assert np.array_equal(watched.sums.window, alone.sums.window) and np.array_equal(watched.counts, alone.counts)
    assert colors(watched).tobytes() == colors(alone).tobytes() == recorder.snapshots[-1].picture.tobytes()


def test_snapshots_are_the_pictures_of_shorter_renders(session, room):
    _, recorder = recorded(session, room, sample_count=16)
    assert [s.samples for s in recorder.snapshots] == [1, 2, 4, 8, 16]
    before = None
    for kept in recorder.snapshots:
        shorter = session.render(room, SETTINGS.replace(sample_count=kept.samples))
        assert colors(shorter).tobytes() == kept.picture.tobytes()
        assert kept.rays["camera"] == kept.samples * 16 * 12 and kept.seconds_total > kept.seconds > 0
        assert before is None or (kept.seconds > before.seconds and kept.rays["bounced"] > before.rays["bounced"])
        before = kept


def test_sample_ranges_merge_to_the_pictures_that_are_recorded(session, room):
    _, recorder = recorded(session, room, sample_count=8)
    first = session.render(room, SETTINGS.replace(sample_count=4))
    rest = session.render(room, SETTINGS.replace(sample_count=4), sample_first=4)
    assert colors(first.merge(rest)).tobytes() == recorder.snapshots[-1].picture.tobytes()
    assert rmse(colors(first), recorder.snapshots[-2].picture) == 0
