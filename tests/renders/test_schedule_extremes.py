"""The least and the most of what can be asked of queues and treelets: the same film in bounded time, and every ray
finished once.
"""

import functools

import pytest
from checking.films import FilmComparer

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import rendering
from raybatch_addon.core.wavefront.tracers.buckets.policy import Selection
from tests.support import scenes, schedule_scenes
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
ESTIMATOR = RenderSettings(sample_count=3, bounce_max=5, roulette_bounce=2)
CHECKED = dict(batching="ON", debug_checks="ON")
STORAGES = ("INDIRECT", "DIRECT")
SELECTIONS = tuple(Selection.__members__)


@pytest.fixture(scope="module")
def session(device, tmp_path_factory):
    opened = Session(device, page_folder=tmp_path_factory.mktemp("pages"))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def comparer(session):
    return FilmComparer(session, schedule_scenes.mixed_scene(), ESTIMATOR, 24)


def paged_settings() -> dict:
    """Most pages of the mixed scene wait elsewhere."""
    return dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000)


def settings_of(way: str) -> dict:
    return {**WAYS[way], **(paged_settings() if way == "paged" else {})}


def part(frame: Frame, width: int, height: int) -> Frame:
    """The middle of `frame`."""
    x, y = (frame.width - width) // 2, (frame.height - height) // 2
    return Frame(frame.width, frame.height, border=(x, y, x + width, y + height), passes=frame.passes)


SMALL = part(schedule_scenes.frame(), 4, 3)


@pytest.mark.parametrize("paged", [False, True], ids=["batched", "paged"])
@pytest.mark.parametrize(
    "change",
    [
        dict(ray_count=1),
        dict(ray_count=1, thread_count=4),
        dict(ray_count=2, ray_low_water=0.0, ray_high_water=0.0),
        dict(tile_size=1),
    ],
    ids=str,
)
def test_one_ray_at_a_time(comparer, change, paged):
    more = paged_settings() if paged else {}
    assert not comparer.compare({**CHECKED, **change, **more}, SMALL).differs


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize(
    "change", each_of(2, [dict(queue_size=1), dict(queue_count=1), dict(queue_size=1, queue_count=1)]), ids=str
)
def test_the_smallest_blocks_and_fewest(comparer, change, selection, storage):
    drawn = {**CHECKED, **change, "bucket_selection": selection, "ray_storage": storage}
    found = comparer.compare(drawn, part(schedule_scenes.frame(), 8, 6), rays_few=0)
    assert not found.differs
    waited = found.statistics["batching"]
    if change.get("queue_count") == 1:
        # there are no fewer than are needed to go on at all
        assert waited["blocks_peak"] == waited["block_count"] and waited["blocks_short"] > 0
    assert waited["blocks_peak"] <= waited["block_count"]


@pytest.mark.parametrize("selection", SELECTIONS)
def test_one_bucket(comparer, selection):
    """A `treelet_size` of as many nodes as the tree has makes one treelet of each mesh tree."""
    many = comparer.compare({**CHECKED, "treelet_size": 1, "bucket_selection": selection})
    found = comparer.compare({**CHECKED, "treelet_size": 10**6, "bucket_selection": selection})
    assert not many.differs and not found.differs
    assert many.statistics["tree"]["cut"]["treelets"] > found.statistics["tree"]["cut"]["treelets"]
    assert found.statistics["tree"]["cut"]["treelets"] == found.statistics["tree"]["trees"]


@functools.cache
def fine_scene():
    """More than ten thousand nodes."""
    ball = scenes.sphere("fine", 800, 420)
    return scenes.scene(
        [
            (ball, scenes.IDENTITY, scenes.diffuse()),
            (scenes.plane("floor", 8), scenes.translation(0, 0, -1), scenes.diffuse(0.5)),
        ],
        view=scenes.camera(eye=(0.4, -4, 1.2)),
        frame=Frame(32, 24, passes=schedule_scenes.PASSES),
        lights=[scenes.sun(2.0, 0.05)],
        world=0.4,
    )


@pytest.fixture(scope="module")
def fine(session):
    return FilmComparer(session, fine_scene(), ESTIMATOR.replace(spatial_splits="OFF"), 24)


@pytest.mark.parametrize(
    "more",
    each_of(
        3,
        [
            dict(queue_count=64, queue_size=1),
            dict(),
            dict(bucket_selection="ALL"),
            dict(bucket_selection="NEXT", ray_count=300),
            dict(bucket_wait_max=3),
        ],
    ),
    ids=str,
)
def test_ten_thousand_buckets(fine, more):
    found = fine.compare(
        {**CHECKED, "treelet_size": 1, "top_level_depth_max": 1024, **more}, part(fine_scene().frame, 12, 9), rays_few=0
    )
    assert not found.differs
    assert found.statistics["tree"]["cut"]["treelets"] >= 10_000


@pytest.mark.parametrize("paged", [False, True], ids=["batched", "paged"])
@pytest.mark.parametrize(
    "change",
    [
        dict(single_lane="ON"),
        dict(warp_count=1),
        dict(single_lane="ON", warp_count=1, ray_count=40),
        dict(warp_count=500),
    ],
    ids=str,
)
def test_few_lanes(comparer, change, paged):
    more = paged_settings() if paged else {}
    assert not comparer.compare({**CHECKED, **change, **more}, part(schedule_scenes.frame(), 8, 6)).differs


@pytest.mark.parametrize("order", ["FRAME_FIRST", "PIXEL_FIRST"])
@pytest.mark.parametrize("more", [{}, CHECKED], ids=["unbatched", "batched"])
def test_counters_pass_over_free_slots(comparer, more, order):
    """When the last paths of a tile are begun, numbers in free slots are those of paths before, and beyond the tile's
    pixels.
    """
    drawn = dict(counters="ON", thread_count=1, tile_size=24, sample_order=order, ray_count=100, ray_low_water=0.0)
    assert not comparer.compare({**more, **drawn}).differs


# --- stopped and gone on


class Stop:
    """Cancels a render: after some tiles, or after it was asked some times, which is in the middle of one."""

    def __init__(self, tiles: int = 10**9, looks: int = 10**9):
        self.tiles, self.looks = tiles, looks

    def on_tile(self, tile) -> None:
        self.tiles -= 1

    def cancelled(self) -> bool:
        self.looks -= 1
        return self.tiles <= 0 or self.looks <= 0


WAYS = {
    "batched": dict(CHECKED),
    "few blocks": dict(CHECKED, queue_size=2, queue_count=3, bucket_selection="NEXT"),
    "by value": dict(CHECKED, ray_storage="DIRECT", bucket_selection="ALL"),
    "paged": dict(CHECKED),
}


def rays_of(film) -> tuple[int, int, int]:
    """Traced, taken in, finished."""
    waited = film.statistics["batching"]
    return film.statistics["rays"]["total"], waited["rays"], waited["finished"]


@pytest.mark.parametrize("way", WAYS)
def test_stopped_between_tiles_and_resumed(session, comparer, way, monkeypatch):
    """Paths under way are brought to their end, however long that takes; each film counts the rays of its own part."""
    monkeypatch.setattr(rendering, "DRAIN_SECONDS", 1e9)
    slow = ESTIMATOR.replace(tile_size=6, thread_count=1, ray_count=20, **settings_of(way))
    film, parts = None, []
    while film is None or not film.complete:
        stop = Stop(tiles=2)
        film = session.render(
            schedule_scenes.mixed_scene(),
            slow,
            on_tile=stop.on_tile,
            cancelled=stop.cancelled if len(parts) < 2 else None,
            resume=film,
        )
        parts.append(rays_of(film))
    assert len(parts) == 3 and all(traced == taken == finished > 0 for traced, taken, finished in parts)
    assert not [fault for fault in comparer.faults(film) if "taken in" not in fault]
    whole = rays_of(session.render(schedule_scenes.mixed_scene(), slow))
    assert sum(traced for traced, _, _ in parts) == whole[0]


def stop_in_a_tile(monkeypatch, after: int):
    """Renders of tiles are told to stop when they have asked `after` times."""
    render, asked = integrator.TileIntegrator.render, [0]

    def stopped(self, state, first, count, stop, most):
        def tells():
            asked[0] += 1
            return stop() or asked[0] > after

        return render(self, state, first, count, tells, most)

    monkeypatch.setattr(integrator.TileIntegrator, "render", stopped)


@pytest.mark.parametrize("way", WAYS)
def test_stopped_in_the_middle_of_a_tile_and_resumed(session, comparer, way):
    slow = ESTIMATOR.replace(tile_size=16, thread_count=1, ray_count=30, **settings_of(way))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rendering, "DRAIN_SECONDS", 1e9)
        stop_in_a_tile(patch, 60)
        film = session.render(schedule_scenes.mixed_scene(), slow)
    assert not film.complete and 0 < film.counts.sum() < comparer.plain.counts.sum()
    traced, taken, finished = rays_of(film)
    assert traced == taken == finished > 0
    film = session.render(schedule_scenes.mixed_scene(), slow, resume=film)
    assert film.complete and not [fault for fault in comparer.faults(film) if "taken in" not in fault]
    traced, taken, finished = rays_of(film)
    assert traced == taken == finished > 0


@pytest.mark.parametrize("way", WAYS)
def test_rays_that_are_given_up_are_reported_and_the_next_render_is_whole(session, comparer, way):
    """Where rays take too long to come to their end they are left; the film cannot be resumed then, and says so."""
    slow = ESTIMATOR.replace(tile_size=16, thread_count=1, ray_count=30, **settings_of(way))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rendering, "DRAIN_SECONDS", 0.0)
        stop_in_a_tile(patch, 60)
        film = session.render(schedule_scenes.mixed_scene(), slow)
    traced, taken, finished = rays_of(film)
    assert not film.complete and traced == taken >= finished > 0
    whole = session.render(schedule_scenes.mixed_scene(), slow).statistics["batching"]
    assert film.statistics["batching"]["block_count"] == whole["block_count"]
    with pytest.raises(RayBatchError, match="render it again"):
        session.render(schedule_scenes.mixed_scene(), slow, resume=film)
    assert not comparer.compare({**settings_of(way), "tile_size": 16, "thread_count": 1, "ray_count": 30}).differs
