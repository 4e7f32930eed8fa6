"""The streaming schedule: the film of the wavefront, bit for bit, whatever is drawn beside it; and what it refuses."""

import contextlib
import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from checking.films import FilmComparer
from checking.schedules import SeededDraws

from raybatch_addon.core.film import tile
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Method
from raybatch_addon.core.wavefront.plan.schedule import with_schedule
from raybatch_addon.core.wavefront.render import rendering
from raybatch_addon.core.wavefront.streaming import integrator
from raybatch_addon.core.wavefront.streaming.integrator import StreamingIntegrator
from tests.support import feature_scenes, schedule_scenes
from tests.support.watched_renders import assert_same

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")  # for films of the wavefront
# Each kernel takes ten seconds and more to compile: a plain run has two of them
ADAPTIVE = RenderSettings(
    sample_count=12,
    bounce_max=5,
    roulette_bounce=2,
    clamp_indirect=3.0,
    adaptive_sampling="ON",
    noise_threshold=0.3,
    adaptive_samples_min=4,
)
STREAMING = {
    "schedule": "STREAMING",
    "kernel_tier": "SPECIALISED",
    "counters": "OFF",
    "geometry_budget": 0,
    "texture_budget": 0,
    "single_lane": "OFF",
    "register_cap": 0,
    "block_size": 0,
}
DRAWS = {"room": 24, "mixed": 60}  # in a thorough run
KINDS = {
    # veils, instances, mattes, halves; rays wait at treelets. Each tile comes to its end in many rounds
    "room": (schedule_scenes.closed_scene, ADAPTIVE, {"batching": "ON", "tile_size": 7}),
    "mixed": (schedule_scenes.mixed_scene, schedule_scenes.ESTIMATOR, {"batching": "OFF"}),
}


@pytest.fixture(scope="module")
def comparers(session):
    """By name: a comparer with the film of the wavefront, and what is not drawn."""
    # turns without end: pixels end by what others of the frame show, so that no part of it is rendered alone
    return {
        name: (FilmComparer(session, make(), estimator, 10**9), way) for name, (make, estimator, way) in KINDS.items()
    }


@pytest.mark.parametrize("name", KINDS)
def test_the_film_is_that_of_the_wavefront_whatever_is_drawn(comparers, name, examples):
    comparer, way = comparers[name]
    drawn = set()
    for number in range(examples(DRAWS[name])):
        found = comparer.compare_drawn(SeededDraws(number), STREAMING | way)
        assert not found.differs, (number, found.differs, found.settings)
        assert found.statistics["settings"]["schedule"] == "STREAMING"
        drawn.add((found.settings["bucket_selection"], found.settings["debug_checks"]))
    assert len(drawn) > 3


def test_rays_are_counted_as_by_the_wavefront(session, comparers):
    comparer, _ = comparers["mixed"]
    film = session.render(schedule_scenes.mixed_scene(), schedule_scenes.ESTIMATOR.replace(schedule="STREAMING"))
    assert film.statistics["rays"] == comparer.plain.statistics["rays"]


@contextlib.contextmanager
def stopped(after: int, monkeypatch):
    """Tiles are told to stop when they have asked `after` times; launches are as short as can be."""
    render, asked = StreamingIntegrator.render, [0]

    def until(self, state, first, count, stop, most):
        def tells():
            asked[0] += 1
            return stop() or asked[0] > after

        return render(self, state, first, count, tells, most)

    with monkeypatch.context() as patch:
        patch.setattr(rendering, "DRAIN_SECONDS", 1e9)
        patch.setattr(integrator, "LAUNCH_SECONDS", 0.0)
        patch.setattr(StreamingIntegrator, "render", until)
        yield


def test_a_render_that_is_stopped_between_launches_goes_on_to_the_same_film(session, comparers, monkeypatch):
    comparer, _ = comparers["room"]
    settings = ADAPTIVE.replace(schedule="STREAMING", batching="ON", ray_count=24, debug_checks="ON")
    film, stops = None, 0
    for after in (1, 3, 9, 27, 81, 10**9):
        with stopped(after, monkeypatch):
            film = session.render(schedule_scenes.closed_scene(), settings, resume=film)
        stops += not film.complete
        if film.complete:
            break
    assert stops >= 2 and film.complete
    assert_same(film.passes, comparer.plain.passes)


def test_a_render_that_is_given_up_leaves_workers_that_render(session, comparers, monkeypatch):
    comparer, _ = comparers["mixed"]
    settings = schedule_scenes.ESTIMATOR.replace(schedule="STREAMING", batching="OFF", debug_checks="ON", ray_count=16)
    with monkeypatch.context() as patch:
        patch.setattr(rendering, "DRAIN_SECONDS", 0.0)
        patch.setattr(integrator, "LAUNCH_SECONDS", 0.0)
        cut = session.render(schedule_scenes.mixed_scene(), settings, cancelled=lambda: True)
    assert not cut.complete
    film = session.render(schedule_scenes.mixed_scene(), settings)
    assert_same(film.passes, comparer.plain.passes)


def test_samples_beyond_the_window_wait_for_wide_digits(session, monkeypatch):
    """Bright light overflows the film's window: a launch ends, the host makes room, and nothing is lost."""
    monkeypatch.setattr(tile.FilmTiles.__init__, "__defaults__", (8,))
    dark = schedule_scenes.mixed_scene()
    bright = dataclasses.replace(dark, world=dataclasses.replace(dark.world, radiance=(1e12,) * 3))
    estimator = schedule_scenes.ESTIMATOR
    plain = session.render(bright, estimator)
    film = session.render(bright, estimator.replace(schedule="STREAMING"))
    assert len(film.sums.wide) and np.array_equal(plain.sums.wide, film.sums.wide)
    assert_same(film.passes, plain.passes)


# --- what it is not for


@pytest.mark.parametrize(
    ("change", "features", "method", "words"),
    [
        ({}, {}, Method.PAGED, "render a smaller scene"),
        ({"geometry_budget": 1 << 20}, {}, Method.PAGED, "raise geometry_budget"),
        ({"batching": "REFERENCE"}, {}, Method.REFERENCE, "set batching to"),
        ({}, {"fetch_program": ProgramFeatures(("image",))}, Method.UNBATCHED, "use smaller images"),
        (
            {"texture_budget": 1},
            {"fetch_program": ProgramFeatures(("image",))},
            Method.UNBATCHED,
            "raise texture_budget",
        ),
        ({}, {"catchers": True}, Method.UNBATCHED, "make them usual surfaces"),
        ({"counters": "ON"}, {}, Method.BATCHED, "set counters to OFF"),
        ({}, {"passes": ("Combined", "Rays")}, Method.UNBATCHED, "leave out passes"),
    ],
)
def test_what_it_cannot_render_takes_the_wavefront(change, features, method, words):
    settings = RenderSettings(schedule="STREAMING", **change)
    features = dataclasses.replace(derive_features(feature_scenes.lit(), settings), **features)
    taken, warnings = with_schedule(settings, features, method)
    assert taken == settings.replace(schedule="WAVEFRONT") and len(warnings) == 1 and words in warnings[0]
    tiers = settings.replace(treelet_tier_bytes=1 << 20)  # for which the tree was not cut
    assert with_schedule(tiers, features, method)[0] == taken
    assert "treelet_tier_bytes is not used with STREAMING" in with_schedule(tiers, features, method)[1][1]


def test_what_it_can_render_it_renders_by_kernels_of_its_own():
    settings = RenderSettings(schedule="STREAMING")
    features = derive_features(feature_scenes.lit(), settings)
    assert with_schedule(settings, features, Method.BATCHED) == (settings.replace(kernel_tier="SPECIALISED"), [])
    wavefront = RenderSettings()
    assert with_schedule(wavefront, features, Method.PAGED) == (wavefront, [])


def test_the_report_says_why_the_wavefront_renders(session):
    settings = schedule_scenes.ESTIMATOR.replace(schedule="STREAMING", counters="ON", batching="OFF")
    film = session.render(schedule_scenes.mixed_scene(), settings)
    assert [each for each in film.statistics["warnings"] if "schedule is WAVEFRONT, not STREAMING: steps" in each]
    assert film.statistics["settings"]["schedule"] == "WAVEFRONT"


@pytest.mark.thorough
@pytest.mark.parametrize("name", feature_scenes.ALL_FEATURES)
def test_every_feature_is_rendered_alike(session, name):
    """A kernel for each takes minutes in all."""
    scene, changes = feature_scenes.ALL_FEATURES[name]
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, width=8, height=6))
    settings = feature_scenes.SETTINGS.replace(debug_checks="ON", **changes)
    plain = session.render(scene, settings)
    assert_same(session.render(scene, settings.replace(schedule="STREAMING")).passes, plain.passes)


def test_other_renders_import_none_of_it(cpu_compiler):
    code = (
        f"import sys; sys.path[:] = {sys.path!r}\n"
        "from raybatch_addon.core.session import Session\n"
        "from raybatch_addon.core.settings.settings import RenderSettings\n"
        "from tests.support import schedule_scenes\n"
        "session = Session('cpu')\n"
        "for batching in ('AUTO', 'ON'):\n"
        "    settings = RenderSettings(sample_count=1, kernel_tier='GENERAL', batching=batching)\n"
        "    film = session.render(schedule_scenes.closed_scene(), settings)\n"
        "    assert film.statistics['rays']['total'] > 0\n"
        "assert not [name for name in sys.modules if '.streaming' in name]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
