"""Files of pages that are useless, damaged, deleted or do not fit on the disk."""

import errno
import os
import shutil
import struct
import zlib
from pathlib import Path

import pytest

from raybatch_addon.core.bvh.pages import file as page_file
from raybatch_addon.core.bvh.pages.store import PAGE_ALIGNMENT, PageFileError
from raybatch_addon.core.session import Session
from tests.renders.beyond_memory.least_budget import render, the_file
from tests.support import schedule_scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

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
    shortened: "should be of",
    emptied: "too short",
    header_altered: "was altered",
    index_altered: "was altered",
    other_version: "of version",
    text: "no file of pages",
}


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

    schedule_scenes.least_budget(session.device.alias, "mixed")  # kept; it writes pages elsewhere
    with monkeypatch.context() as patch:
        patch.setattr(page_file, "open", refuses, raising=False)
        with pytest.raises(
            PageFileError, match=r"cannot be kept in .*pages \(Permission denied\); make it writable, .* HOST memory"
        ):
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
