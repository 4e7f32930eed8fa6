"""Renders whose pixels end one by one: the same film under every schedule, in parts and after stops; and the right
mean.
"""

import dataclasses
import itertools

import numpy as np
import pytest

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Frame, World
from raybatch_addon.core.wavefront.adaptive.active_pixels import ActivePixels
from raybatch_addon.core.wavefront.adaptive.looks import Looks
from raybatch_addon.core.wavefront.adaptive.noise import RADIUS
from raybatch_addon.core.wavefront.render import resume
from tests.support import scenes, schedule_scenes
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE
from tests.support.watched_renders import FRAME, SETTINGS, WatchedSession, Watcher, assert_same, rounded_anew, stopping

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
ADAPTIVE = SETTINGS.replace(
    sample_count=40, adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8, thread_count=2
)
LOOKS = [8, 12, 16, 24, 32]
WAYS = {
    "tiny tiles": dict(tile_size=3, thread_count=3),
    "pixel first": dict(sample_order="PIXEL_FIRST", tile_size=9, ray_count=100),
    "few rays": dict(ray_count=37, ray_low_water=0.2, thread_count=1),
    "batched": dict(batching="ON", debug_checks="ON", tile_size=7),
    "by value": dict(batching="ON", ray_storage="DIRECT", queue_size=2, queue_count=3, ray_count=50),
    "paged": dict(debug_checks="ON"),
    "sorted": dict(ray_sort="ON", hit_sort="ON"),
}


def settings_of(way: str) -> dict:
    budget = dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000) if way == "paged" else {}
    return WAYS[way] | budget


def render(session, **changes) -> Film:
    return session.render(scenes.mixed(FRAME), ADAPTIVE.replace(**changes))


def assert_same_film(film: Film, expected: Film) -> None:
    assert np.array_equal(film.counts, expected.counts)
    for mine, theirs in zip((film, *film.halves), (expected, *expected.halves), strict=True):
        assert_same(mine.passes, theirs.passes)


@pytest.fixture(scope="module")
def plain(session) -> Film:
    return render(session)


def test_pixels_end_at_looks_and_the_film_is_the_mean_of_what_each_has(plain):
    counts, reported = plain.counts, plain.statistics["adaptive"]
    assert set(np.unique(counts)) == {*LOOKS, 40}
    assert_same(plain.passes, rounded_anew(plain))
    assert [each["samples"] for each in reported["looks"]] == LOOKS
    assert [each["pixels"] for each in reported["looks"]] == [int((counts > samples).sum()) for samples in LOOKS]
    assert reported["samples_mean"] == counts.mean() and reported["samples_min"] == 8 and reported["threshold"] == 0.1
    assert reported["converged"] == pytest.approx((counts < 40).mean())
    assert plain.statistics["stopped_by"] == "samples" and plain.complete
    assert plain.statistics["samples"] == plain.statistics["rays"]["camera"] == plain.sample_total == counts.sum()
    assert "adaptive_samples_min" not in plain.statistics["auto"]


@pytest.mark.parametrize("way", WAYS)
def test_no_schedule_changes_the_film(session, plain, way):
    film = render(session, **settings_of(way))
    assert_same_film(film, plain)
    assert film.statistics["adaptive"] == plain.statistics["adaptive"]
    assert film.statistics["rays"] == plain.statistics["rays"]


@pytest.mark.parametrize("number", each_of(3, range(6)))
def test_stops_and_snapshots_change_nothing(session, plain, number):
    watched = WatchedSession(session)
    watched.random = np.random.default_rng(number)
    order = ("FRAME_FIRST", "PIXEL_FIRST")[number % 2]
    film = watched.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_order=order, tile_size=5 + number, ray_count=90))
    assert film.complete
    assert_same_film(film, plain)
    assert film.statistics["adaptive"] == plain.statistics["adaptive"]


def test_a_film_that_was_stopped_is_left_as_it_was(session, plain):
    with stopping(120):
        stopped = session.render(scenes.mixed(FRAME), ADAPTIVE.replace(tile_size=9))
    assert not stopped.complete and stopped.resume_state.active.stopped.any()
    before, looks = stopped.resume_state.active.stopped.copy(), list(stopped.resume_state.active.looks)
    for _ in range(2):
        film = session.render(scenes.mixed(FRAME), ADAPTIVE, resume=stopped)
        assert_same_film(film, plain)
    assert np.array_equal(stopped.resume_state.active.stopped, before) and stopped.resume_state.active.looks == looks
    with pytest.raises(RayBatchError, match="other settings"):
        session.render(scenes.mixed(FRAME), ADAPTIVE.replace(noise_threshold=0.2), resume=stopped)


@pytest.mark.parametrize("sample_order", ["FRAME_FIRST", "PIXEL_FIRST"])
def test_lists_that_would_number_too_many_paths_end_rounds(session, plain, sample_order, monkeypatch):
    monkeypatch.setattr(resume, "ITEMS_NUMBERED", 1000)  # of tiles of 100 pixels ten samples
    assert_same_film(render(session, tile_size=10, sample_order=sample_order), plain)


def test_a_threshold_of_0_gives_the_film_of_all_samples(session):
    film = render(session, noise_threshold=0.0, sample_count=9)
    assert_same_film(film, render(session, adaptive_sampling="OFF", error_estimate="ON", sample_count=9))
    assert film.statistics["adaptive"]["converged"] == 0.0 and film.statistics["adaptive"]["looks"] == []


def test_no_look_comes_before_the_least_samples(session):
    film = render(session, adaptive_samples_min=0, sample_count=20)
    assert (film.counts == 20).all() and film.statistics["auto"]["adaptive_samples_min"]["value"] == 32


def test_a_render_ends_when_every_pixel_has(session):
    film = render(session, noise_threshold=1.0)
    assert film.complete and film.statistics["stopped_by"] == "noise"
    assert film.statistics["samples_per_pixel"] == film.counts.max() < 40
    assert film.statistics["adaptive"]["converged"] == 1.0


# --- parts


def test_parts_of_rounds_merge_to_the_film(session, plain):
    ends = [8, 9, 12, 13, 15, 16, 24, 30, 32, 40]
    merged = at_look = render(session, sample_count=8)
    for first, end in itertools.pairwise(ends):
        part = session.render(
            scenes.mixed(FRAME),
            ADAPTIVE.replace(sample_count=end - first, tile_size=3 + end % 9),
            sample_first=first,
            after=at_look,
        )
        merged = merged.merge(part)
        if end in LOOKS:
            at_look = merged
    assert_same_film(merged, plain)


def test_parts_of_the_first_round_need_nothing_else(session, plain):
    parts = [
        session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=n), sample_first=first)
        for first, n in ((0, 3), (3, 4), (7, 1))
    ]
    film = parts[2].merge(parts[0]).merge(parts[1])
    assert_same_film(film, render(session, sample_count=8))


def test_samples_that_need_others_are_refused_with_what_to_do(session, plain):
    def part(first, count, after=None):
        session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=count), sample_first=first, after=after)

    with pytest.raises(RayBatchError, match="samples 3 to 13 .*decides after 8 samples.*adaptive_sampling to OFF"):
        part(3, 10)
    with pytest.raises(RayBatchError, match="from 9 on need the film of samples 0 to 8 .*after="):
        part(9, 2)
    unfinished = render(session, sample_count=8)
    unfinished.complete = False
    for film in (
        plain,  # of too many samples
        unfinished,
        render(session, sample_count=7),  # of too few
        render(session, adaptive_sampling="OFF", sample_count=8),  # without halves
        session.render(scenes.mixed(Frame(20, 20)), ADAPTIVE.replace(sample_count=8)),
    ):
        with pytest.raises(RayBatchError, match="samples 0 to 8 of the same frame"):
            part(8, 2, film)


def test_a_gap_in_the_film_before_is_noticed(session):
    """Samples 8 to 12 are missing, so that the last count is that of a look that came earlier."""
    first = render(session, sample_count=8)
    second = first.merge(
        session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=4), sample_first=8, after=first)
    )
    third = session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=4), sample_first=12, after=second)
    with pytest.raises(RayBatchError, match="samples 0 to 16 of the same frame"):
        session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=4), sample_first=16, after=first.merge(third))


def test_parts_after_every_pixel_has_ended_are_empty_and_shown(session):
    ended = render(session, noise_threshold=1.0)
    assert ended.statistics["stopped_by"] == "noise" and ended.counts.max() < 32
    watcher, reported = Watcher([]), []
    part = session.render(
        scenes.mixed(FRAME),
        ADAPTIVE.replace(noise_threshold=1.0, sample_count=8),
        sample_first=32,
        after=ended,
        observers=[watcher],
        on_progress=reported.append,
    )
    assert part.complete and part.statistics["stopped_by"] == "noise" and not part.counts.any()
    assert len(watcher.got) == 1 and not watcher.got[0].picture.any() and reported[-1].fraction == 1.0
    assert_same_film(ended.merge(part), ended)


def test_a_film_that_would_not_be_looked_at_is_refused(session, plain):
    with stopping(120):
        stopped = session.render(scenes.mixed(FRAME), ADAPTIVE.replace(tile_size=9))
    for changes, more, why in (
        ({}, dict(resume=stopped), "film to resume knows"),
        ({}, dict(), "sample_first is 0"),
        (dict(adaptive_sampling="OFF"), dict(sample_first=8), "adaptive_sampling is OFF"),
    ):
        with pytest.raises(RayBatchError, match=f"after= would not be used: .*{why}"):
            session.render(scenes.mixed(FRAME), ADAPTIVE.replace(**changes), after=plain, **more)


def test_a_part_has_no_error_to_end_at(session):
    with pytest.raises(RayBatchError, match="set error_target to 0"):
        session.render(
            scenes.mixed(FRAME),
            ADAPTIVE.replace(sample_count=2, error_target=0.1),
            sample_first=8,
            after=render(session, sample_count=8),
        )


def test_samples_beyond_31_bits_are_refused(session):
    with pytest.raises(RayBatchError, match="out of range with adaptive sampling: use 0 to 2.31 - 1"):
        session.render(scenes.mixed(FRAME), ADAPTIVE, sample_first=2**31 - 2)


def test_a_border_has_the_samples_of_the_frame_and_ends_as_it_inside(session):
    whole = session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=12))
    x0, y0, x1, y1 = 4, 5, 20, 19
    film = session.render(
        scenes.mixed(dataclasses.replace(FRAME, border=(x0, y0, x1, y1))), ADAPTIVE.replace(sample_count=12)
    )
    mine, theirs = film.counts.reshape(y1 - y0, x1 - x0), whole.counts.reshape(20, 24)[y0:y1, x0:x1]
    inside = np.s_[RADIUS:-RADIUS, RADIUS:-RADIUS]
    assert np.array_equal(mine[inside], theirs[inside]) and len(np.unique(mine[inside])) == 2
    same = mine == theirs
    assert np.array_equal(film.passes["Combined"][same], whole.passes["Combined"][y0:y1, x0:x1][same])


# --- with other settings


def test_the_clock_ends_a_render_at_a_film_of_so_many_samples(session):
    film = render(session, sample_count=10**7, time_limit=0.3, noise_threshold=1e-4)
    assert film.statistics["stopped_by"] == "time"
    samples = film.statistics["samples_per_pixel"]
    assert_same_film(film, render(session, sample_count=samples, noise_threshold=1e-4))


def test_an_error_target_ends_a_render_at_the_same_sample(session):
    films = [render(session, sample_count=4096, noise_threshold=0.03, error_target=0.006, tile_size=n) for n in (0, 6)]
    assert films[0].statistics["error"] == films[1].statistics["error"]
    assert films[0].statistics["stopped_by"] == "error" and films[0].statistics["error"]["reached"]
    assert films[0].counts.min() < films[0].counts.max()
    assert_same_film(*films)


def test_snapshots_report_how_many_samples_each_pixel_has(session, plain):
    watcher = Watcher([5, 16, 33])
    film = session.render(scenes.mixed(FRAME), ADAPTIVE, observers=[watcher])
    assert_same_film(film, plain)
    assert watcher.samples == [5, 16, 33, 40]
    for snapshot in watcher.got:
        assert np.array_equal(snapshot.counts, np.minimum(plain.counts.reshape(20, 24), snapshot.samples))
    last = watcher.got[-1]
    weights = [half.counts.reshape(20, 24, 1) / plain.counts.reshape(20, 24, 1) for half in plain.halves]
    assert last.picture == pytest.approx(sum(w * half for w, half in zip(weights, last.halves, strict=True)), rel=1e-5)


def test_progress_never_goes_back_and_counts_what_is_done(session, plain):
    reported = []
    session.render(
        scenes.mixed(FRAME),
        ADAPTIVE,
        on_progress=lambda each: reported.append(each) if each.stage == "render" else None,
    )
    shares, samples = [each.fraction for each in reported], [each.samples_done for each in reported]
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert samples == sorted(samples) and samples[-1] == plain.counts.mean()


@pytest.mark.parametrize("adaptive", ["ON", "OFF"])
def test_passes_are_means_over_the_samples_of_each_pixel(session, adaptive):
    frame = Frame(24, 20, passes=("Combined", "Depth", "Rays", "Sample Count"))
    film = session.render(scenes.mixed(frame), ADAPTIVE.replace(adaptive_sampling=adaptive, tile_size=11))
    assert film.passes["Sample Count"].shape == (20, 24, 1) and film.passes["Sample Count"].dtype == np.float32
    assert np.array_equal(film.passes["Sample Count"].reshape(-1), film.counts)
    rays = (film.passes["Rays"].astype(float).reshape(-1) * film.counts).round().sum()
    assert rays == film.statistics["rays"]["total"]
    shown = film.merge(Film.empty(frame)).passes
    assert_same(film.passes, shown)
    if adaptive == "OFF":
        assert (film.counts == 40).all()


def test_sums_beyond_the_films_window_are_looked_at_too(session):
    bright = dataclasses.replace(scenes.mixed(FRAME), world=World((1e12, 3e12, 1e12)))
    films = [session.render(bright, ADAPTIVE.replace(sample_count=16, tile_size=size)) for size in (0, 5)]
    assert films[0].counts.min() == 8 < films[0].counts.max()
    assert_same_film(*films)


def looking(film: Film) -> list[str]:
    """Modules of kernels that adaptive sampling alone needs."""
    return [name for name in film.statistics["modules"] if "active" in name or "noise" in name]


def test_off_costs_nothing(session):
    film = render(session, adaptive_sampling="OFF", sample_count=2)
    assert film.halves is None and film.statistics["adaptive"] is None
    assert "adaptive sampling" in film.statistics["left_out"]
    assert not looking(film)
    early = render(session, sample_count=7)  # no look comes
    assert "adaptive sampling" in early.statistics["left_out"] and not looking(early)
    adaptive = render(session, sample_count=8)
    assert adaptive.statistics["schedule"]["bytes_per_path"] == film.statistics["schedule"]["bytes_per_path"]
    assert "adaptive sampling" not in adaptive.statistics["left_out"] and looking(adaptive)


# --- the mean


def by_their_own(self, pictures, samples, device):
    """A look that ends pixels by what their own samples show."""
    for each in pictures:
        first, second = (colors.numpy()[:, :3].sum(1, dtype=float) for colors in each.colors)
        light = (first + second) / 2
        ratio = np.divide(np.abs(first - second) / 2, light, out=np.zeros_like(light), where=light > 0)
        tile = each.rectangle
        error = (ratio**2 * np.minimum(light, 1)).reshape(tile.height, tile.width)
        part = self.stopped[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]
        part[(part == 0) & (error < self.threshold**2)] = samples


def test_rare_bright_light_is_not_lost_as_by_rules_that_look_at_the_pixel_itself(session, monkeypatch):
    """A lamp that paths meet by chance alone: one in some hundreds does, and is bright."""
    scene = scenes.scene(
        [
            (scenes.plane(size=12), scenes.translation(0, 0, -1), scenes.diffuse((0.7, 0.7, 0.7))),
            (scenes.plane("lamp", 0.3), scenes.translation(0, 0, 1), scenes.emitter(40.0)),
        ],
        view=scenes.camera(eye=(0, -6, 3), half_width=0.4),
        frame=Frame(24, 24),
    )
    settings = SETTINGS.replace(
        clamp_indirect=0.0, bounce_max=1, nee="OFF", sample_sequence="INDEPENDENT", kernel_tier="SPECIALISED"
    )
    adaptive = settings.replace(sample_count=256, adaptive_sampling="ON", noise_threshold=0.05, adaptive_samples_min=32)

    def mean(film):
        return film.passes["Combined"][..., :3].mean(dtype=float)

    def found(seeds):
        """Mean over renders of these seeds, its standard error, and the share of the samples."""
        films = [session.render(scene, adaptive.replace(seed=seed)) for seed in seeds]
        means = np.array([mean(film) for film in films]) / true
        share = np.mean([film.statistics["adaptive"]["samples_mean"] for film in films]) / 256
        return means.mean(), means.std(ddof=1) / np.sqrt(len(means)), share

    # with light that is aimed at, a sixteenth of the samples have the same noise
    aimed = settings.replace(nee="ON", sample_sequence="SOBOL", kernel_tier="GENERAL", sample_count=2048)
    true = mean(session.render(scene, aimed))
    brightness, error, share = found(range(64))
    assert error < 0.01 and 0.2 < share < 0.9
    assert abs(brightness - 1) < 3.5 * error
    monkeypatch.setattr(ActivePixels, "look", by_their_own)
    darkened, error, _ = found(range(8))
    assert darkened < 0.9 - 3.5 * error


def test_the_looks_of_these_tests(plain):
    looks = Looks.of(ADAPTIVE)
    assert [looks.first, *(looks.after(samples) for samples in LOOKS[:-1])] == LOOKS
