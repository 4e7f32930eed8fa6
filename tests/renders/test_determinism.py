"""The schedule changes time, never the image: films are equal bit for bit."""

import dataclasses
import functools
import itertools
import threading

import numpy as np
import pytest
import warp as wp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.order import hit_order
from raybatch_addon.core.wavefront.order.hit_order import HitOrder
from raybatch_addon.core.wavefront.scene import scene_cache
from raybatch_addon.core.wavefront.tracers.unbatched import BoxesStage, QuantisedStage
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=6, bounce_max=6, roulette_bounce=2, clamp_indirect=3.0)


@pytest.fixture(scope="module")
def reference(session):
    return session.render(scenes.mixed(), SETTINGS).passes


def assert_same(passes, expected):
    assert passes.keys() == expected.keys()
    for name in expected:
        assert np.array_equal(passes[name], expected[name]), name


def test_the_reference_shows_something(reference):
    picture = reference["Combined"]
    assert np.isfinite(picture).all() and picture[..., :3].std() > 0.05
    assert all(reference[name].any() for name in reference)


@pytest.mark.parametrize(
    "change",
    [
        dict(tile_size=5),
        dict(tile_size=64),
        dict(thread_count=1),
        dict(thread_count=5, tile_size=4),
        dict(ray_count=1),
        dict(ray_count=37),
        dict(ray_count=64, ray_low_water=0.1, ray_high_water=0.4),
        dict(sample_order="PIXEL_FIRST"),
    ],
    ids=str,
)
def test_schedule_settings_do_not_change_the_film(session, reference, change):
    small = dict(change)
    if change.get("ray_count") == 1:  # one path at a time, so one tile of it
        frame = Frame(24, 20, border=(9, 9, 12, 11), passes=("Combined", "Depth", "Normal", "Position"))
        passes = session.render(scenes.mixed(frame), SETTINGS.replace(**small)).passes
        assert_same(passes, {name: values[9:11, 9:12] for name, values in reference.items()})
        return
    assert_same(session.render(scenes.mixed(), SETTINGS.replace(**small)).passes, reference)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    tile_size=st.integers(1, 30),
    thread_count=st.integers(1, 4),
    ray_count=st.integers(20, 5000),
    low=st.floats(0, 1),
    high=st.floats(0, 1),
    order=st.sampled_from(["FRAME_FIRST", "PIXEL_FIRST"]),
)
def test_any_schedule_gives_the_same_film(session, reference, tile_size, thread_count, ray_count, low, high, order):
    low, high = sorted((low, high))
    drawn = SETTINGS.replace(
        tile_size=tile_size,
        thread_count=thread_count,
        ray_count=ray_count,
        ray_low_water=low,
        ray_high_water=high,
        sample_order=order,
    )
    frame = Frame(24, 20, border=(6, 6, 18, 14), passes=("Combined", "Depth", "Normal", "Position"))
    passes = session.render(scenes.mixed(frame), drawn).passes
    assert_same(passes, {name: values[6:14, 6:18] for name, values in reference.items()})


def test_a_border_equals_that_part_of_the_frame(session, reference):
    frame = Frame(24, 20, border=(3, 5, 20, 13), passes=("Combined", "Depth", "Normal", "Position"))
    passes = session.render(scenes.mixed(frame), SETTINGS).passes
    assert_same(passes, {name: values[5:13, 3:20] for name, values in reference.items()})


@pytest.mark.parametrize("cuts", [(2,), (1, 5), (3, 4)])
def test_sample_ranges_merge_to_one_render(session, reference, cuts):
    edges = [0, *cuts, SETTINGS.sample_count]
    parts = [
        session.render(scenes.mixed(), SETTINGS.replace(sample_count=end - first), sample_first=first)
        for first, end in itertools.pairwise(edges)
    ]
    merged = parts[-1]
    for part in parts[:-1]:
        merged = merged.merge(part)
    assert_same(merged.passes, reference)


class StopAfter:
    """Cancels a render once some of its tiles are done."""

    def __init__(self, tiles: int):
        self.left = tiles
        self.stopped = threading.Event()

    def on_tile(self, tile) -> None:
        self.left -= 1

    def cancelled(self) -> bool:
        return self.left <= 0


@pytest.mark.parametrize("order", ["FRAME_FIRST", "PIXEL_FIRST"])
def test_a_stopped_render_goes_on_where_it_was(session, reference, order):
    slow = SETTINGS.replace(tile_size=6, thread_count=1, ray_count=64, sample_order=order)
    film, stops = None, 0
    while film is None or not film.complete:
        stop = StopAfter(3)
        film = session.render(
            scenes.mixed(), slow, on_tile=stop.on_tile, cancelled=stop.cancelled if stops < 3 else None, resume=film
        )
        if not film.complete:
            assert film.counts.min() < SETTINGS.sample_count
            stops += 1
    assert stops > 1
    assert_same(film.passes, reference)


def test_a_complete_film_cannot_be_resumed(session):
    film = session.render(scenes.mixed(), SETTINGS)
    with pytest.raises(RayBatchError, match="complete"):
        session.render(scenes.mixed(), SETTINGS, resume=film)


def test_the_seed_changes_the_film(session, reference):
    other = session.render(scenes.mixed(), SETTINGS.replace(seed=1)).passes["Combined"]
    assert not np.array_equal(other, reference["Combined"])


def test_instances_that_are_shared_shade_like_meshes_of_their_own(session):
    """Baking a mesh into the world or transforming its instance is the same picture, to rounding."""
    one = scenes.sphere(segments=16, rings=8, smooth=True)
    other = dataclasses.replace(one, name="copy", positions=one.positions.copy())
    view = scenes.camera(eye=(0, -5, 1))
    places = [scenes.translation(-1.2, 0, 0), scenes.translation(1.2, 0, 0, 0.8)]
    shared = scenes.scene(
        [(one, m, scenes.diffuse()) for m in places], view=view, lights=[scenes.sun(1.0, 0.2)], world=0.3
    )
    apart = scenes.scene(
        [(one, places[0], scenes.diffuse()), (other, places[1], scenes.diffuse())],
        view=view,
        lights=[scenes.sun(1.0, 0.2)],
        world=0.3,
    )
    a, b = (session.render(s, RenderSettings(sample_count=32)).passes["Combined"] for s in (shared, apart))
    assert np.abs(a - b).mean() < 1e-3 and np.quantile(np.abs(a - b), 0.99) < 2e-2


PASSES_WITH_COST = ("Combined", "Depth", "Normal", "Position", "Rays", "Node Steps", "Triangle Tests")


@pytest.mark.parametrize(
    "change",
    [
        dict(ray_sort="ON"),
        dict(ray_sort="OFF"),
        dict(ray_sort="AUTO", ray_count=3000),
        dict(counters="ON"),
        dict(spatial_splits="ON"),
        dict(spatial_splits="OFF"),
    ],
    ids=str,
)
def test_neither_order_nor_counters_nor_another_tree_change_the_film(session, reference, change):
    assert_same(session.render(scenes.mixed(), SETTINGS.replace(**change)).passes, reference)


def test_hits_that_are_sorted_by_material_give_the_same_film(session, reference, monkeypatch):
    original, lists = HitOrder.parts, []

    def parts(self, rays, hits):
        for part in original(self, rays, hits):
            lists.append(part is not hits)
            yield part

    monkeypatch.setattr(HitOrder, "parts", parts)
    monkeypatch.setattr(hit_order, "BINNED_MIN", 1)
    for hit_sort in ("ON", "OFF"):
        lists.clear()
        film = session.render(scenes.mixed(), SETTINGS.replace(hit_sort=hit_sort))
        assert any(lists) == (hit_sort == "ON")
        assert_same(film.passes, reference)


@pytest.mark.parametrize("on_device", [False, True], ids=["host", "device"])
@pytest.mark.parametrize("splits", ["ON", "OFF"])
def test_trees_of_the_other_layout_give_the_same_film(session, reference, monkeypatch, splits, on_device):
    """On the CPU both layouts are traced with the same arithmetic, whoever built the tree."""
    if session.device.is_cuda:
        pytest.skip("CUDA has one layout")
    if splits == "ON" and on_device:
        pytest.skip("devices build without splits")
    build = scene_cache.build_scene_tree
    monkeypatch.setattr(scene_cache, "build_scene_tree", functools.partial(build, on_device=on_device))
    monkeypatch.setattr(session._at[0], "layout", Layout.QUANTISED)
    film = session.render(scenes.mixed(), SETTINGS.replace(spatial_splits=splits))
    assert film.statistics["tree"]["layout"] == "quantised"
    assert_same(film.passes, reference)
    session.close()  # the tree is not what the key of the cache says


def test_rays_may_be_traced_in_any_order(session, reference, monkeypatch):
    generator = np.random.default_rng(6)
    lists = []

    def shuffling(launch):
        def launch_shuffled(self, tree, rays, listed, counts):
            count = int(listed.count.numpy()[0])
            slots = generator.permutation(listed.slots.numpy()[:count])
            lists.append(count)
            launch(
                self,
                tree,
                rays,
                dataclasses.replace(listed, slots=wp.array(slots, dtype=int, device=rays.origin.device)),
                counts,
            )

        return launch_shuffled

    for stage in (BoxesStage, QuantisedStage):
        monkeypatch.setattr(stage, "launch", shuffling(stage.launch))
    assert_same(session.render(scenes.mixed(), SETTINGS.replace(thread_count=1)).passes, reference)
    assert max(lists) > 100


def test_cost_passes_add_up_to_the_rays_and_merge(session, reference):
    frame = Frame(24, 20, passes=PASSES_WITH_COST)
    film = session.render(scenes.mixed(frame), SETTINGS)
    assert_same({name: film.passes[name] for name in reference}, reference)
    assert round(film.passes["Rays"].sum(dtype=float) * SETTINGS.sample_count) == film.statistics["rays"]["total"]
    counted = film.statistics["counters"]
    steps = sum(sum(bounces) for bounces in counted["node_steps"].values())
    assert round(film.passes["Node Steps"].sum(dtype=float) * SETTINGS.sample_count) == steps > 0
    parts = [
        session.render(scenes.mixed(frame), SETTINGS.replace(sample_count=n), sample_first=first)
        for n, first in ((2, 0), (4, 2))
    ]
    assert_same(parts[0].merge(parts[1]).passes, film.passes)
