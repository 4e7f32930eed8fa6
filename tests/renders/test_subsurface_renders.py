"""Random walks below surfaces in whole renders: any schedule, and what lies inside."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, Frame, Material
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.stages.limits import half_seed
from tests.support import scenes
from tests.support.feature_scenes import MEDIUM
from tests.support.running.shares import each_of
from tests.support.watched_renders import stopping

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

WHITE = (1.0, 1.0, 1.0)
WAX = Material(
    "wax", (MEDIUM, Closure(K.DIELECTRIC, (0.5, 0.5, 0.5), 0.3, 1.4)), (K.SUBSURFACE, K.DIFFUSE, K.DIELECTRIC)
)
VEIL = Material(
    "veil", (Closure(K.TRANSPARENT, (0.5, 0.6, 0.7)), Closure(K.DIFFUSE, (0.2, 0.2, 0.2))), (K.TRANSPARENT, K.DIFFUSE)
)
SETTINGS = RenderSettings(sample_count=3, bounce_max=4, roulette_bounce=2)


def wax(*objects):
    """A ball of wax with a box in it, over a floor, behind a veil; with two balls more of one mesh."""
    ball, small = scenes.sphere(segments=16, rings=8), scenes.sphere("small", 8, 4, 0.4)
    return scenes.scene(
        [
            (ball, scenes.IDENTITY, WAX),
            (scenes.box(size=0.6), scenes.IDENTITY, VEIL),
            (small, scenes.translation(1.2, -0.5, 0.4), WAX),
            (small, scenes.translation(-1.2, -0.5, 0.2), WAX),
            (scenes.plane(size=6.0), scenes.translation(0, 0, -1), WAX),
            (scenes.plane("veil", size=1.0), scenes.look_at((0.3, -2.0, 0.2), (0, -4, 0)), VEIL),
            *objects,
        ],
        view=scenes.camera(eye=(0, -4, 1)),
        frame=Frame(40, 24),
        world=0.6,
        lights=[scenes.sun(2.0, 0.1, scenes.look_at((1.5, -2.0, 2.0), (0, 0, 0)))],
    )


def film(session, scene, **change):
    film = session.render(scene, SETTINGS.replace(**change))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"]


@pytest.fixture(scope="module")
def plain(session):
    return film(session, wax(), batching="OFF")


@pytest.mark.parametrize(
    "change",
    each_of(
        3,
        [
            {"batching": "ON", "ray_count": 100, "queue_size": 8},
            {"batching": "ON", "treelet_size": 16},
            {"ray_sort": "ON", "sample_order": "FRAME_FIRST"},
            {"batching": "ON", "treelet_size": 16, "geometry_budget": 20_000, "geometry_store": "HOST"},
            {"tile_size": 8, "thread_count": 2},
        ],
    ),
)
def test_any_schedule_gives_the_same_film(session, plain, change):
    np.testing.assert_array_equal(film(session, wax(), **change), plain)


@pytest.mark.parametrize(
    "change", [{"batching": "OFF"}, {"batching": "ON", "treelet_size": 16, "sample_order": "PIXEL_FIRST"}]
)
@pytest.mark.parametrize("after", each_of(2, [40, 3]))
def test_walks_take_part_in_resuming(session, plain, after, change):
    settings = SETTINGS.replace(tile_size=9, ray_count=60, thread_count=1, **change)
    with stopping(after):
        stopped = session.render(wax(), settings)
    assert (
        not stopped.complete
        and stopped.counts.min() < SETTINGS.sample_count
        and (after < 40 or stopped.counts.max() > 0)
    )
    film = session.render(wax(), settings, resume=stopped)
    assert film.complete and (film.counts == SETTINGS.sample_count).all() and film.statistics["invalid_samples"] == 0
    np.testing.assert_array_equal(film.passes["Combined"], plain)


def test_halves_with_walks_are_renders_with_seeds_of_their_own(session):
    film = session.render(wax(), SETTINGS.replace(error_estimate="ON", tile_size=9))
    parts = [
        session.render(wax(), SETTINGS.replace(sample_count=count, seed=half_seed(0, half)))
        for half, count in ((0, 2), (1, 1))
    ]
    np.testing.assert_array_equal(film.passes["Combined"], parts[0].merge(parts[1]).passes["Combined"])
    for half, part in zip(film.halves, parts, strict=True):
        np.testing.assert_array_equal(half.passes["Combined"], part.passes["Combined"])
    with stopping(40):
        stopped = session.render(wax(), SETTINGS.replace(error_estimate="ON", tile_size=9, ray_count=60))
    assert not stopped.complete
    again = session.render(wax(), SETTINGS.replace(error_estimate="ON", tile_size=9, ray_count=60), resume=stopped)
    np.testing.assert_array_equal(again.passes["Combined"], film.passes["Combined"])


def test_walks_are_left_out_elsewhere(plain):
    assert plain[..., :3].std() > 0.05
    features = derive_features(wax(), SETTINGS)
    assert features.subsurface and "closure subsurface" not in features.left_out()
    bare = scenes.scene([(scenes.sphere(), scenes.IDENTITY, VEIL)], view=scenes.camera(), frame=Frame(8, 8), world=1.0)
    assert (
        not derive_features(bare, SETTINGS).subsurface
        and "closure subsurface" in derive_features(bare, SETTINGS).left_out()
    )
