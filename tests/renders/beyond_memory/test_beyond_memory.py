"""Geometry that does not fit: the film is that of memory, whatever the budget and the store; a file that is damaged
costs a new one at most.
"""

import dataclasses
import re
import threading
import time

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.bvh.pages import file as page_file
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.errors import BuildCancelledError, OutOfMemoryError
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.session import Session
from raybatch_addon.core.wavefront.scene import scene_cache
from raybatch_addon.core.wavefront.scene.scene_cache import encodes
from tests.renders.beyond_memory.least_budget import CHECKED, DISK, ESTIMATOR, render, the_file
from tests.support import schedule_scenes
from tests.support.running.shares import each_of

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.mark.parametrize("store", each_of(2, ["HOST", "DISK"]))
@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_every_budget_gives_the_film_of_memory(session, plain, name, store):
    """From one page to everything."""
    comparer = plain[name]
    one_page = comparer.compare(dict(CHECKED, geometry_budget=1, geometry_store=store))
    budget, everything = one_page.settings["geometry_budget"], comparer.sizes.tree_bytes
    if budget >= everything:
        pytest.skip("on this device the scene is smaller than a page and what stays beside it")
    fewest = most = one_page.statistics["tree"]["pages"]
    assert one_page.raised == 1 and fewest > 1
    evicted = []
    budgets = sorted({int(b) for b in np.geomspace(budget, everything, 9)} | {everything - 1})
    for each in budgets:
        film = session.render(
            schedule_scenes.SCENES[name](), ESTIMATOR.replace(**CHECKED, geometry_budget=each, geometry_store=store)
        )
        assert not comparer.faults(film), each
        evicted.append(film.statistics["pages_evicted"])
        paged = "pages" in film.statistics["tree"]
        assert paged == (each < everything)
        assert not paged or 0 < film.statistics["resident_peak"] <= each
        most = max(most, film.statistics["tree"].get("pages", 0))
    assert evicted[0] > 0 and evicted[-1] == 0 and not one_page.differs


def test_one_page_at_a_time(session, plain):
    """The budget that the message calls enough holds a single page: every other one that is needed takes its place."""
    found = plain["mixed"].compare(dict(DISK, geometry_budget=1, geometry_store="HOST"))
    assert (
        not found.differs
        and found.statistics["pages_evicted"]
        >= found.statistics["pages_loaded"] - 1
        > found.statistics["tree"]["pages"]
    )


def test_the_file_is_found_by_other_sessions(device, pages, plain):
    for number in range(3):
        opened = Session(device, page_folder=pages)
        film = render(opened)
        opened.close()
        assert film.statistics["tree"]["reused"] == (number > 0) and not film.statistics["warnings"]
        assert not plain["mixed"].faults(film)
    assert the_file(pages).suffix == page_file.SUFFIX


# --- too little


@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.4, 0.999])
def test_a_budget_smaller_than_what_must_stay_is_refused_and_the_message_says_what_is_enough(
    session, plain, share, store
):
    budget = max(1, int(share * schedule_scenes.least_budget(session.device.alias)))
    with pytest.raises(
        OutOfMemoryError, match=r"budget of [\d,]+ bytes is too small.*enough|geometry_budget is [\d,]+ bytes.*at least"
    ):
        render(session, geometry_budget=budget, geometry_store=store)
    assert not plain["mixed"].compare(dict(DISK, geometry_budget=budget, geometry_store=store)).differs
    assert not plain["mixed"].faults(render(session, geometry_store=store))


@pytest.mark.parametrize("seed", each_of(2, range(6)))
def test_the_number_in_the_message_renders_and_one_less_does_not(session, plain, seed):
    """For scenes, stores, treelets and budgets at random."""
    rng = np.random.default_rng(seed)
    name = rng.choice(sorted(schedule_scenes.SCENES))
    change = dict(DISK, geometry_store=str(rng.choice(["HOST", "DISK"])), treelet_size=int(rng.choice([0, 1, 8])))
    asked = int(rng.integers(1, schedule_scenes.least_budget(session.device.alias, name)))
    with pytest.raises(OutOfMemoryError, match="too small") as error:
        render(session, name, **{**change, "geometry_budget": asked})
    (number,) = re.findall(r"([\d,]+) bytes are enough", str(error.value))
    enough = int(number.replace(",", ""))
    with pytest.raises(OutOfMemoryError, match=f" {number} bytes are enough"):
        render(session, name, **{**change, "geometry_budget": enough - 1})
    film = render(session, name, **{**change, "geometry_budget": enough})
    assert not plain[name].faults(film)
    assert "pages" not in film.statistics["tree"] or film.statistics["resident_peak"] <= enough


def test_host_memory_that_does_not_hold_the_pages(session, plain, monkeypatch):
    from raybatch_addon.core.bvh.pages import build as page_build

    schedule_scenes.least_budget(session.device.alias, "mixed")  # is found with the memory that there is, and kept
    with monkeypatch.context() as patch:
        patch.setattr(page_build, "free_memory", lambda device: 1000)
        with pytest.raises(OutOfMemoryError, match="use DISK"):
            render(session, geometry_store="HOST")
    assert not plain["mixed"].faults(render(session, geometry_store="HOST"))


def test_a_frame_that_moves_is_built_anew(session, plain):
    """A second scene in the same session, and the first again."""
    for name in ("mixed", "closed", "mixed", "open", "open"):
        film = render(session, name)
        assert not plain[name].faults(film)
    moved = schedule_scenes.mixed_scene()
    transform = moved.instances.transform.copy()
    transform[1, :, 3] += 0.3
    moved = dataclasses.replace(moved, instances=dataclasses.replace(moved.instances, transform=transform))
    expected = session.render(moved, ESTIMATOR.replace(batching="OFF"))
    budget = schedule_scenes.least_budget(session.device.alias) + 2000
    film = session.render(moved, ESTIMATOR.replace(**DISK, geometry_budget=budget))
    assert "pages" in film.statistics["tree"]
    assert all(np.array_equal(film.passes[name], values) for name, values in expected.passes.items())
    assert not all(np.array_equal(film.passes[name], values) for name, values in plain["mixed"].plain.passes.items())


def test_trees_follow_the_settings_from_render_to_render(session, plain):
    """In one session: treelets, and triangles that are split, which other settings leave out."""
    budget = schedule_scenes.least_budget(session.device.alias) + 10_000
    trees = []
    for change in ({}, dict(treelet_size=1), dict(spatial_splits="ON"), {}):
        film = render(session, geometry_budget=budget, geometry_store="HOST", **change)
        assert not plain["mixed"].faults(film)
        trees.append([film.statistics["tree"][name] for name in ("chunks", "bytes", "levels", "sah")])
    usual, small, split, again = trees
    assert usual == again and usual != small and usual != split


def test_a_page_that_a_launch_sees_is_not_overwritten(device):
    """It leaves, but its slot is filled with another page when the launch is over."""
    scene, on = schedule_scenes.mixed_scene(), wp.get_device(device)
    layout = layout_for(on)
    flat, visibility = flatten(scene), scene.instances.visibility
    budget = schedule_scenes.least_budget(device)
    paged = build_paged_scene(flat, visibility, layout, on, budget, encoded=encodes(layout))
    residency = Residency(paged, budget, on)
    assert residency.slot_count == 1
    view = residency.view()

    def bring(page: int, victims: list[int]) -> None:
        assert residency.ask(lambda facts, most: [page], lambda facts, most: victims, 1, view.counts) == [page]

    def arrives(page: int, seconds: float) -> bool:
        end = time.perf_counter() + seconds
        while not residency.there()[page] and time.perf_counter() < end:
            time.sleep(0.01)
        return bool(residency.there()[page])

    bring(0, [])
    assert arrives(0, 30)
    view.begin()
    bring(1, [0])
    assert not residency.there()[0] and not arrives(1, 0.3)
    view.end()
    assert arrives(1, 30) and not residency.there()[0]
    view.close()
    residency.close()


def test_a_cancel_ends_the_building_of_pages(session, plain, pages, monkeypatch):
    began, ended = threading.Event(), threading.Event()

    def build_until_cancelled(*arguments, cancelled, **more):
        began.set()
        while not cancelled():
            time.sleep(0.01)
        try:
            return build_paged_scene(*arguments, cancelled=cancelled, **more)
        except BuildCancelledError:
            ended.set()
            raise

    name = "mixed"
    budget = schedule_scenes.least_budget(session.device.alias, name) + 500
    with monkeypatch.context() as patch:
        patch.setattr(scene_cache, "build_paged_scene", build_until_cancelled)
        settings = ESTIMATOR.replace(**DISK, geometry_budget=budget)
        film = session.render(schedule_scenes.SCENES[name](), settings, cancelled=began.is_set)
        assert not film.complete and ended.wait(30)
    assert not list(pages.iterdir())
    assert not plain[name].faults(render(session, name))
