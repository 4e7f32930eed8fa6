"""Films of scenes whose trees have a top level for each of some ranges of time: those of one, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build.top_level import OverTime
from raybatch_addon.core.bvh.pages import build
from raybatch_addon.core.scene.description import Shutter
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.bvh.build.ranges_scenes import flying, swaying
from tests.renders.motion.test_motion import moving_scene
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=4, bounce_max=2)
pytestmark = pytest.mark.usefixtures("general_kernels")
SCENES = {
    "balls and bulges": moving_scene,
    "flying": lambda: flying(12, ball=scenes.sphere(segments=48, rings=24)),
    "swaying": swaying,
    "strands": lambda: swaying(segments=True),
}
SCHEDULES = {
    "whole": {},
    "triangles split": {"spatial_splits": "ON"},
    "batched": {"batching": "ON", "treelet_size": 6},
    "paged": {"batching": "ON", "geometry_budget": 120_000, "geometry_store": "HOST"},
}


@pytest.fixture
def rendered(device, monkeypatch):
    """A function that renders with trees in a number of ranges, which may take a share of a budget."""
    opened = []

    def render(scene, count: int, share: float = 0.5, **changes):
        monkeypatch.setattr(OverTime, "may_pay", lambda _: count > 1)
        monkeypatch.setattr(OverTime, "count", lambda _, room: count)
        monkeypatch.setattr(build, "_RANGES_SHARE", share)
        opened.append(Session(device))
        return opened[-1].render(scene, SETTINGS.replace(**changes))

    yield render
    for session in opened:
        session.close()


@pytest.mark.parametrize("name", SCENES)
def test_films_are_the_same_in_any_number_of_ranges(rendered, name):
    scene = SCENES[name]()
    one = rendered(scene, 1)
    assert one.passes["Combined"][..., :3].std() > 0.005 and one.statistics["tree"]["time_ranges"] == 1
    for schedule, changes in SCHEDULES.items():
        film = rendered(scene, 4, **changes)
        np.testing.assert_array_equal(film.passes["Combined"], one.passes["Combined"], err_msg=schedule)
        statistics = film.statistics
        assert statistics["tree"]["time_ranges"] == 4 and statistics["invalid_samples"] == 0
        assert (schedule == "paged") == ("pages" in statistics["tree"])
        assert (schedule in ("batched", "paged")) == (statistics["batching"] is not None)


@pytest.mark.parametrize("time", [0.0, 0.25, 1.0])
def test_a_shutter_that_is_open_at_one_time_alone_sees_the_same(rendered, time):
    """Rays at the end of a range, and of the last one, are in one range all the same."""
    scene = moving_scene()
    shutter = Shutter(times=np.array([time, time], np.float32))
    scene = replace(scene, camera=replace(scene.camera, shutter=shutter))
    one = rendered(scene, 1).passes["Combined"]
    for count in (2, 8):
        np.testing.assert_array_equal(rendered(scene, count).passes["Combined"], one)


@pytest.mark.parametrize("counts", [(1, 4, 2), (2, 4, 2)])
@pytest.mark.parametrize("splits", ["AUTO", "ON"])
def test_trees_follow_from_frame_to_frame(device, monkeypatch, counts, splits):
    """Ranges come and go as they pay, also where only maps change and mesh trees stay."""
    settings = SETTINGS.replace(spatial_splits=splits)
    scene = moving_scene()
    maps = scene.instances.motion.maps
    frames = [
        replace(scene, instances=replace(scene.instances, motion=replace(scene.instances.motion, maps=each)))
        for each in (maps, maps + np.float32(0.1) * np.eye(3, 4, 3, dtype=np.float32)[:, :4], maps)
    ]
    session = Session(device)
    for count, frame in zip(counts, frames, strict=True):
        monkeypatch.setattr(OverTime, "may_pay", lambda _, count=count: count > 1)
        monkeypatch.setattr(OverTime, "count", lambda _, room, count=count: count)
        film = session.render(frame, settings)
        assert film.statistics["tree"]["time_ranges"] == count
        fresh = Session(device)
        np.testing.assert_array_equal(fresh.render(frame, settings).passes["Combined"], film.passes["Combined"])
        fresh.close()
    session.close()


def test_what_was_rendered_before_does_not_tell_how_many_ranges_meshes_have(device):
    """Trees that are cut have none in meshes; those that are not are as in a session of their own."""
    scene, schedules = swaying(), ({}, SCHEDULES["batched"])

    def entries(session, changes):
        return session.render(scene, SETTINGS.replace(**changes)).statistics["tree"]["entries"]

    own = []
    for changes in schedules:
        alone = Session(device)
        own.append(entries(alone, changes))
        alone.close()
    assert own[0] > own[1]
    session = Session(device)
    assert [entries(session, schedules[k]) for k in (1, 0, 1, 0)] == [own[k] for k in (1, 0, 1, 0)]
    session.close()


def test_a_budget_that_several_top_levels_do_not_fit_in_is_enough_for_one(rendered):
    scene = flying(12, ball=scenes.sphere(segments=48, rings=24))
    several, one = (rendered(scene, 4, share, **SCHEDULES["paged"]) for share in (0.5, 0.01))
    assert (several.statistics["tree"]["time_ranges"], one.statistics["tree"]["time_ranges"]) == (4, 1)
    np.testing.assert_array_equal(one.passes["Combined"], several.passes["Combined"])
