"""Files of pages in a folder: their room, their names, and which of them go."""

import os
import shutil
import time

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages import file as page_file
from raybatch_addon.core.bvh.pages import store as page_store
from raybatch_addon.core.bvh.pages.file import PageFileWriter, delete_old_files, open_page_file, page_path
from raybatch_addon.core.bvh.pages.store import PAGE_ALIGNMENT, HostStore, Page, PageFileError, page_buffer
from tests.core.bvh.pages.page_files import built

KEY = bytes(range(32))


def test_too_little_room_is_reported_before_anything_is_written(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(page_file.shutil, "disk_usage", lambda folder: usage._replace(free=5000))
    (tmp_path / "old.pages").write_bytes(bytes(1000))
    with pytest.raises(PageFileError, match="GB are free there"):
        built("DISK", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["old.pages"]  # it would not have helped


def test_a_folder_that_cannot_be_made_is_reported(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(PageFileError, match="cannot be kept"):
        built("DISK", tmp_path / "file" / "folder")


def test_old_files_go_least_recently_used_first(tmp_path):
    now = time.time()
    for i, age in enumerate([50, 10, 40, 30]):
        path = tmp_path / f"{i}.pages"
        path.write_bytes(bytes(100))
        os.utime(path, (now - age, now - age))
    for name, age in (("a.pages.1-2.part", 10), ("b.pages.3-4.part", 1e6), ("other.txt", 1e6)):
        (tmp_path / name).write_bytes(bytes(1000))
        os.utime(tmp_path / name, (now - age, now - age))
    deleted = delete_old_files(tmp_path, tmp_path / "0.pages", 300)
    assert sorted(path.name for path in deleted) == ["2.pages", "b.pages.3-4.part"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "0.pages",
        "1.pages",
        "3.pages",
        "a.pages.1-2.part",
        "other.txt",
    ]


def test_room_is_made_by_deleting_old_files(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    for i in range(3):
        path = tmp_path / f"{i}.pages"
        path.write_bytes(bytes(1000))
        os.utime(path, (1000 + i, 1000 + i))

    def disk_usage(folder):
        return usage._replace(free=4000 - sum(path.stat().st_size for path in tmp_path.glob("*.pages")))

    monkeypatch.setattr(page_file.shutil, "disk_usage", disk_usage)
    PageFileWriter(tmp_path, Layout.BOXES, KEY, 2500).abandon()
    assert [path.name for path in tmp_path.iterdir()] == ["2.pages"]


def test_files_that_another_process_deletes_meanwhile_do_no_harm(tmp_path, monkeypatch):
    for i in range(3):
        path = tmp_path / f"{i}.pages"
        path.write_bytes(bytes(1000))
        os.utime(path, (1000 + i, 1000 + i))
    usage, glob = shutil.disk_usage(tmp_path), type(tmp_path).glob
    monkeypatch.setattr(
        type(tmp_path), "glob", lambda folder, *more: [folder / f"gone{more[0][1:]}", *glob(folder, *more)]
    )
    monkeypatch.setattr(
        page_file.shutil,
        "disk_usage",
        lambda folder: usage._replace(free=4000 - 1000 * len(list(glob(tmp_path, "*.pages")))),
    )
    PageFileWriter(tmp_path, Layout.BOXES, KEY, 2500).abandon()
    assert [path.name for path in tmp_path.iterdir()] == ["2.pages"]
    assert [path.name for path in delete_old_files(tmp_path, None, 0)] == ["2.pages"]


def test_a_file_that_is_in_use_does_not_keep_others_from_making_room(tmp_path, monkeypatch):
    for i in range(3):
        path = tmp_path / f"{i}.pages"
        path.write_bytes(bytes(1000))
        os.utime(path, (1000 + i, 1000 + i))
    usage, deleted = shutil.disk_usage(tmp_path), page_file._deleted
    monkeypatch.setattr(page_file, "_deleted", lambda path: path.name != "0.pages" and deleted(path))
    monkeypatch.setattr(
        page_file.shutil,
        "disk_usage",
        lambda folder: usage._replace(free=4000 - 1000 * len(list(tmp_path.glob("*.pages")))),
    )
    PageFileWriter(tmp_path, Layout.BOXES, KEY, 1500).abandon()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.pages", "2.pages"]


def test_what_is_written_does_not_depend_on_the_run(tmp_path):
    """Two processes may write the same file, and one of them reads what the other wrote."""
    for layout, encoded in ((Layout.BOXES, False), (Layout.QUANTISED, True)):
        written = [built("DISK", tmp_path / str(i), layout, encoded=encoded).store.path.read_bytes() for i in range(2)]
        assert written[0] == written[1]


def test_files_say_what_they_hold(tmp_path):
    assert open_page_file(tmp_path, Layout.BOXES, KEY) is None
    writer = PageFileWriter(tmp_path, Layout.BOXES, KEY, 0)
    data = page_buffer(2 * PAGE_ALIGNMENT).numpy()
    data[:] = np.arange(len(data)) % 251
    first = [writer.add(data), writer.add(data[PAGE_ALIGNMENT:])]
    writer.finish({"some": np.arange(5)}).close()
    store, index = open_page_file(tmp_path, Layout.BOXES, KEY)
    assert (
        index["some"].tolist() == list(range(5))
        and store.byte_count == 3 * PAGE_ALIGNMENT
        and store.path == page_path(tmp_path, KEY)
    )
    out = page_buffer(3 * PAGE_ALIGNMENT).numpy()
    store.read_into(Page(0, 1, first[0], len(out), len(out)), out, True)
    assert np.array_equal(out, np.concatenate([data, data[PAGE_ALIGNMENT:]]))
    store.close()
    store.close()
    assert isinstance(open_page_file(tmp_path, Layout.QUANTISED, KEY), str)


def test_small_and_large_pages_in_memory(monkeypatch):
    monkeypatch.setattr(page_store, "_BLOCK_BYTES", 16 * PAGE_ALIGNMENT)
    store, rng = HostStore(pinned=False), np.random.default_rng(0)
    pages, contents = [], []
    for pages_each in (1, 3, 20, 2, 2, 2, 3, 3, 40, 1):
        first, memory = store.add(pages_each * PAGE_ALIGNMENT - 5)
        assert memory.ctypes.data % PAGE_ALIGNMENT == 0 and len(memory) == pages_each * PAGE_ALIGNMENT
        memory[:] = rng.integers(0, 256, len(memory))
        contents.append(memory.copy())
        pages.append(Page(0, 1, first, len(memory), len(memory)))
    out = page_buffer(40 * PAGE_ALIGNMENT).numpy()
    for page, expected in zip(pages, contents):
        store.read_into(page, out, False)
        assert np.array_equal(out[: page.byte_count], expected) and np.array_equal(store.view(page).numpy(), expected)
    assert store.byte_count == sum(map(len, contents))
