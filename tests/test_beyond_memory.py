"""Geometry that does not fit: the film is that of memory, whatever the budget and the store; a file that is damaged costs a new one at most."""

import dataclasses
import errno
import os
import re
import shutil
import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
import schedule_scenes
import warp as wp
from checking.films import FilmComparer

from raybatch_addon.core.bvh import page_file
from raybatch_addon.core.bvh.build import layout_for
from raybatch_addon.core.bvh.page_build import build_paged_scene
from raybatch_addon.core.bvh.page_store import PAGE_ALIGNMENT, PageFileError
from raybatch_addon.core.bvh.residency import Residency
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.wavefront.geometry_cache import encodes

ESTIMATOR = RenderSettings(sample_count=3, bounce_max=5, roulette_bounce=2)
CHECKED = dict(batching="ON", debug_checks="ON")
DISK = dict(CHECKED, geometry_store="DISK")


@pytest.fixture
def pages(tmp_path) -> Path:
    return tmp_path / "pages"


@pytest.fixture
def session(device, pages):
    opened = Session(device, page_folder=pages)
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def plain(device):
    """Films without queues, of all three scenes."""
    opened = Session(device)
    made = {name: FilmComparer(opened, make(), ESTIMATOR, 24) for name, make in schedule_scenes.SCENES.items()}
    yield made
    opened.close()


def render(session, name="mixed", **change):
    """Little more than one page is on the device."""
    budget = schedule_scenes.least_budget(session.device.alias, name) + 500
    return session.render(schedule_scenes.SCENES[name](), ESTIMATOR.replace(**{**DISK, "geometry_budget": budget, **change}))


def the_file(pages: Path) -> Path:
    (found,) = pages.iterdir()
    return found


@pytest.mark.parametrize("store", ["HOST", "DISK"])
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
        film = session.render(schedule_scenes.SCENES[name](), ESTIMATOR.replace(**CHECKED, geometry_budget=each, geometry_store=store))
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
    assert not found.differs and found.statistics["pages_evicted"] >= found.statistics["pages_loaded"] - 1 > found.statistics["tree"]["pages"]


def test_the_file_is_found_by_other_sessions(device, pages, plain):
    for number in range(3):
        opened = Session(device, page_folder=pages)
        film = render(opened)
        opened.close()
        assert film.statistics["tree"]["reused"] == (number > 0) and not film.statistics["warnings"]
        assert not plain["mixed"].faults(film)
    assert the_file(pages).suffix == page_file.SUFFIX


# --- files that are no good


def shortened(path: Path) -> None:
    os.truncate(path, path.stat().st_size - 1000)


def emptied(path: Path) -> None:
    os.truncate(path, 0)


def header_altered(path: Path) -> None:
    flip(path, 20)


def index_altered(path: Path) -> None:
    flip(path, int(struct.unpack_from("<Q", path.read_bytes(), 56)[0]) + 200)


def other_version(path: Path) -> None:
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 8, page_file.VERSION + 1)
    size = page_file._HEADER.size
    struct.pack_into("<I", data, size, zlib.crc32(bytes(data[:size])))
    path.write_bytes(data)


def text(path: Path) -> None:
    path.write_text("no pages\n" * 1000)


def flip(path: Path, place: int) -> None:
    with open(path, "r+b") as file:
        file.seek(place)
        byte = file.read(1)[0]
        file.seek(place)
        file.write(bytes([byte ^ 64]))


SPOILED = {
    shortened: "should be of", emptied: "too short", header_altered: "was altered", index_altered: "was altered", other_version: "of version",
    text: "no file of pages",
}  # fmt: skip


@pytest.mark.parametrize("spoil", SPOILED, ids=lambda spoil: spoil.__name__)
def test_a_useless_file_is_written_anew_and_the_film_says_so(device, pages, plain, spoil):
    first = Session(device, page_folder=pages)
    render(first)
    first.close()
    path = the_file(pages)
    sound = path.read_bytes()
    spoil(path)
    assert path.read_bytes() != sound
    opened = Session(device, page_folder=pages)
    film = render(opened)
    assert not plain["mixed"].faults(film) and not film.statistics["tree"]["reused"]
    (warning,) = film.statistics["warnings"]
    assert SPOILED[spoil] in warning and str(path) in warning and "written anew" in warning
    opened.close()
    assert the_file(pages).stat().st_size == len(sound)
    again = Session(device, page_folder=pages)
    film = render(again)
    assert film.statistics["tree"]["reused"] and not film.statistics["warnings"] and not plain["mixed"].faults(film)
    again.close()


def test_the_file_of_another_scene_under_this_ones_name(device, pages, plain, tmp_path):
    first = Session(device, page_folder=pages)
    render(first)
    path = the_file(pages)
    other = Session(device, page_folder=tmp_path / "other")
    render(other, "open")
    first.close(), other.close()
    shutil.copy(the_file(tmp_path / "other"), path)
    opened = Session(device, page_folder=pages)
    film = render(opened)
    assert "is of another scene" in film.statistics["warnings"][0] and not plain["mixed"].faults(film)
    opened.close()


def page_altered(path: Path) -> None:
    flip(path, PAGE_ALIGNMENT + 100)


def all_pages_altered(path: Path) -> None:
    for place in range(PAGE_ALIGNMENT + 10, int(struct.unpack_from("<Q", path.read_bytes(), 56)[0]), 500):
        flip(path, place)


@pytest.mark.parametrize("spoil", [page_altered, all_pages_altered], ids=lambda spoil: spoil.__name__)
def test_a_page_that_is_damaged_is_found_when_it_is_read_and_the_next_render_works(device, pages, plain, spoil):
    """No picture is made of it. Rendering again, in the same session or another, writes the file anew."""
    first = Session(device, page_folder=pages)
    render(first)
    first.close()
    spoil(the_file(pages))
    opened = Session(device, page_folder=pages)
    with pytest.raises(PageFileError, match="damaged.*render again"):
        render(opened)
    assert not list(pages.iterdir())
    for _ in range(2):
        film = render(opened)
        assert not plain["mixed"].faults(film)
    opened.close()


def test_pages_that_are_damaged_between_renders_of_one_session(session, pages, plain):
    """What was read once and found good is not looked at again in full; a file that became shorter is found."""
    assert not plain["mixed"].faults(render(session))
    os.truncate(the_file(pages), PAGE_ALIGNMENT)
    with pytest.raises(PageFileError, match="ends too early.*render again"):
        render(session)
    for _ in range(2):
        assert not plain["mixed"].faults(render(session))


def test_a_file_that_is_deleted_under_a_session(session, pages, plain):
    """It stays open where the system lets it be deleted."""
    render(session)
    shutil.rmtree(pages)
    assert not plain["mixed"].faults(render(session))
    assert not plain["open"].faults(render(session, "open"))


# --- nowhere to write


def test_a_folder_that_cannot_be_made(device, tmp_path, plain):
    (tmp_path / "file").write_text("")
    opened = Session(device, page_folder=tmp_path / "file" / "pages")
    for _ in range(2):
        with pytest.raises(PageFileError, match="cannot be kept in .*pages.* choose another folder, or HOST memory"):
            render(opened)
    assert not plain["mixed"].faults(render(opened, geometry_store="HOST"))
    opened.close()


def test_a_folder_that_may_not_be_written(session, pages, plain, monkeypatch):
    def refuses(path, mode="r", **more):
        if "x" in mode:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return open(path, mode, **more)

    with monkeypatch.context() as patch:
        patch.setattr(page_file, "open", refuses, raising=False)
        with pytest.raises(PageFileError, match=r"cannot be kept in .*pages \(Permission denied\); make it writable, .* HOST memory"):
            render(session)
    assert not list(pages.iterdir())
    assert not plain["mixed"].faults(render(session))


def test_a_disk_that_is_full_from_the_start(session, pages, plain, monkeypatch):
    usage = shutil.disk_usage(pages.parent)
    with monkeypatch.context() as patch:
        patch.setattr(page_file.shutil, "disk_usage", lambda folder: usage._replace(free=1000))
        with pytest.raises(PageFileError, match="are free there; free some space"):
            render(session)
    assert not list(pages.iterdir())
    assert not plain["mixed"].faults(render(session))


def test_a_disk_that_fills_up_while_it_is_written(session, pages, plain, monkeypatch):
    """Also a file of another scene is still there afterwards."""
    render(session, "open")
    kept = the_file(pages)
    write = page_file.PageFileWriter._write

    class Full:
        """A file that takes some bytes, and then no more."""

        def __init__(self, file):
            self.file, self.left = file, 6000

        def __getattr__(self, name):
            return getattr(self.file, name)

        def write(self, data):
            if self.left <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            count = self.file.write(data[: self.left])
            self.left -= count
            return count

    def into_little_room(self, data):
        if not isinstance(self._file, Full):
            self._file = Full(self._file)
        write(self, data)

    with monkeypatch.context() as patch:
        patch.setattr(page_file.PageFileWriter, "_write", into_little_room)
        with pytest.raises(PageFileError, match="No space left on device.*Nothing was left there"):
            render(session)
    assert the_file(pages) == kept
    assert not plain["mixed"].faults(render(session))
    assert len(list(pages.iterdir())) == 2


# --- too little


@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.4, 0.999])
def test_a_budget_smaller_than_what_must_stay_is_refused_and_the_message_says_what_is_enough(session, plain, share, store):
    budget = max(1, int(share * schedule_scenes.least_budget(session.device.alias)))
    with pytest.raises(OutOfMemoryError, match=r"budget of [\d,]+ bytes is too small.*enough|geometry_budget is [\d,]+ bytes.*at least"):
        render(session, geometry_budget=budget, geometry_store=store)
    assert not plain["mixed"].compare(dict(DISK, geometry_budget=budget, geometry_store=store)).differs
    assert not plain["mixed"].faults(render(session, geometry_store=store))


@pytest.mark.parametrize("seed", range(6))
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
    from raybatch_addon.core.bvh import page_build

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
