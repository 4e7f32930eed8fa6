"""Pages in memory and in files: the same bytes, what is damaged is found, nothing is left behind, nothing grows without
bound.
"""

import errno
import os
import shutil
import threading

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages import file as page_file
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.bvh.pages.store import PAGE_ALIGNMENT, PageFileError, page_buffer
from raybatch_addon.core.scene.flatten import flatten
from tests.core.bvh.pages.page_files import BUDGET, SCENE, built
from tests.support.paged_scenes import page_bytes

# what makes the pages: the CPU's builder; what builds on GPUs
WHERE = {"host": {}, "device": {"layout": Layout.QUANTISED, "on_device": True, "encoded": True}}


def same(a: PagedScene, b: PagedScene) -> bool:
    """Whether rays would find the same."""
    arrays = [
        (a.tree.nodes, b.tree.nodes),
        (a.tree.triangles, b.tree.triangles),
        (a.of_node, b.of_node),
        (a.root, b.root),
    ]
    arrays += [
        (getattr(a.tree, name), getattr(b.tree, name))
        for name in vars(a.tree)
        if isinstance(getattr(a.tree, name), wp.array)
    ]
    tables = [
        (getattr(a, name), getattr(b, name))
        for name in ("treelet_page", "treelet_node_byte", "treelet_triangle_byte", "box")
    ]
    return (
        all(
            np.array_equal(x.numpy(), y.numpy(), equal_nan=True)
            for x, y in [*arrays, (a.resident_nodes, b.resident_nodes)]
        )
        and all(np.array_equal(x, y) for x, y in tables)
        and len(a.pages) == len(b.pages)
        and all(np.array_equal(x, y) for x, y in zip(page_bytes(a), page_bytes(b)))
    )


@pytest.mark.parametrize("nodes_resident", [False, True])
@pytest.mark.parametrize("layout", Layout)
def test_memory_and_file_hold_the_same_and_the_file_is_used_again(tmp_path, layout, nodes_resident):
    host = built("HOST", layout=layout, nodes_resident=nodes_resident)
    fresh = built("DISK", tmp_path, layout, nodes_resident=nodes_resident)
    assert not fresh.statistics["reused"] and host.nodes_resident == nodes_resident
    again = built("DISK", tmp_path, layout, nodes_resident=nodes_resident)
    assert again.statistics["reused"] and "page_file_warning" not in again.statistics
    assert same(host, fresh) and same(host, again)
    assert len(list(tmp_path.iterdir())) == 1
    assert host.store.view(host.pages[0]).size == host.pages[0].byte_count and fresh.store.view(fresh.pages[0]) is None
    assert host.store.byte_count == fresh.store.byte_count >= sum(page.byte_count for page in host.pages)


def test_one_file_serves_scenes_with_and_without_resident_nodes(tmp_path):
    built("DISK", tmp_path, nodes_resident=True)
    again = built("DISK", tmp_path, nodes_resident=False)
    assert again.statistics["reused"] and same(again, built("HOST", nodes_resident=False))


def test_other_geometry_or_choices_get_a_file_of_their_own(tmp_path):
    for changes in (
        {},
        {"budget": 800_000},
        {"layout": Layout.QUANTISED},
        {"layout": Layout.QUANTISED, "on_device": True},
        {"spatial_splits": True},
    ):
        assert not built("DISK", tmp_path, **changes).statistics["reused"]
        assert built("DISK", tmp_path, **changes).statistics["reused"]
    moved = flatten(SCENE)
    moved.positions[0, 0] = np.nextafter(moved.positions[0, 0], np.float32(9))
    other = build_paged_scene(
        moved, SCENE.instances.visibility, Layout.BOXES, wp.get_device("cpu"), BUDGET, "DISK", tmp_path
    )
    assert not other.statistics["reused"] and len(list(tmp_path.iterdir())) == 6


def test_instances_may_move_without_a_new_file(tmp_path):
    built("DISK", tmp_path)
    flat = flatten(SCENE)
    flat.instance_transform[1] = flat.instance_transform[1] + np.eye(3, 4, 3)
    moved = build_paged_scene(
        flat, SCENE.instances.visibility, Layout.BOXES, wp.get_device("cpu"), BUDGET, "DISK", tmp_path
    )
    host = build_paged_scene(flat, SCENE.instances.visibility, Layout.BOXES, wp.get_device("cpu"), BUDGET)
    assert moved.statistics["reused"] and same(moved, host)


def cut_short(data: bytearray) -> bytes:
    return bytes(data[:-4096])


def almost_nothing(data: bytearray) -> bytes:
    return bytes(data[:20])


def no_file_of_ours(data: bytearray) -> bytes:
    return b"something" + bytes(data[9:])


def other_version(data: bytearray) -> bytes:
    data[8] += 1
    return bytes(data)


def altered_header(data: bytearray) -> bytes:
    data[60] ^= 1
    return bytes(data)


def altered_index(data: bytearray) -> bytes:
    data[-5000] ^= 1
    return bytes(data)


def other_layout(data: bytearray) -> bytes:
    import struct
    import zlib

    data[12] ^= 1
    struct.pack_into("<I", data, page_file._HEADER.size, zlib.crc32(bytes(data[: page_file._HEADER.size])))
    return bytes(data)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (cut_short, "should be of"),
        (almost_nothing, "too short"),
        (no_file_of_ours, "no file of pages"),
        (other_version, "version"),
        (altered_header, "altered"),
        (altered_index, "altered"),
        (other_layout, "another scene"),
    ],
)
def test_a_file_that_cannot_be_used_is_written_anew_with_a_warning(tmp_path, change, reported):
    first = built("DISK", tmp_path)
    path = first.store.path
    path.write_bytes(change(bytearray(path.read_bytes())))
    again = built("DISK", tmp_path)
    assert (
        not again.statistics["reused"]
        and reported in again.statistics["page_file_warning"]
        and str(path) in again.statistics["page_file_warning"]
    )
    assert same(again, built("HOST")) and built("DISK", tmp_path).statistics["reused"]


def test_a_file_of_another_scene_under_this_ones_name_is_not_taken(tmp_path):
    mine = built("DISK", tmp_path).store.path
    other = built("DISK", tmp_path, spatial_splits=True).store.path
    assert mine != other
    shutil.copy(other, mine)
    again = built("DISK", tmp_path)
    assert "another scene" in again.statistics["page_file_warning"] and same(again, built("HOST"))


@pytest.mark.parametrize("direct", [False, True])
def test_an_altered_page_is_found_when_it_is_read_and_the_file_goes(tmp_path, direct):
    first = built("DISK", tmp_path, nodes_resident=False)
    page = first.pages[2]
    with open(first.store.path, "r+b") as file:
        file.seek(page.byte_first + page.byte_count // 2)
        byte = file.read(1)[0]
        file.seek(-1, 1)
        file.write(bytes([byte ^ 4]))
    again = built("DISK", tmp_path, nodes_resident=False)
    assert again.statistics["reused"]
    buffer = page_buffer(again.page_bytes_max).numpy()
    again.store.read_into(again.pages[1], buffer, direct)
    with pytest.raises(PageFileError, match="render again"):
        again.store.read_into(page, buffer, direct)
    third = built("DISK", tmp_path, nodes_resident=False)
    assert not third.statistics["reused"] and same(third, built("HOST", nodes_resident=False))


def test_a_damaged_file_that_cannot_be_deleted_while_it_is_open_is_not_taken_again(tmp_path, monkeypatch):
    first = built("DISK", tmp_path, nodes_resident=False)
    page, path = first.pages[2], first.store.path
    with open(path, "r+b") as file:
        file.seek(page.byte_first)
        file.write(bytes(PAGE_ALIGNMENT))
    again = built("DISK", tmp_path, nodes_resident=False)
    with monkeypatch.context() as patch:
        patch.setattr(
            type(path),
            "unlink",
            lambda path, missing_ok=False: (_ for _ in ()).throw(PermissionError(errno.EACCES, "in use")),
        )
        with pytest.raises(PageFileError, match="damaged"):
            again.store.read_into(page, page_buffer(page.byte_count).numpy(), True)
    third = built("DISK", tmp_path, nodes_resident=False)
    assert not third.statistics["reused"] and same(third, built("HOST", nodes_resident=False))


def test_a_file_that_gets_shorter_meanwhile_is_reported(tmp_path):
    first = built("DISK", tmp_path)
    os.truncate(first.store.path, 3 * PAGE_ALIGNMENT)
    with pytest.raises(PageFileError, match="ends too early"):
        for page in first.pages:
            first.store.read_into(page, page_buffer(page.byte_count).numpy(), True)


def test_file_systems_without_direct_reads(tmp_path, monkeypatch):
    expected = page_bytes(built("DISK", tmp_path))
    real = os.preadv
    refused = []

    def preadv(number, buffers, offset):
        if number == store._direct:
            refused.append(offset)
            raise OSError(errno.EINVAL, "no")
        return real(number, buffers, offset)

    again = built("DISK", tmp_path)
    store = again.store
    if store._direct < 0:
        pytest.skip("no direct reads here anyway")
    monkeypatch.setattr(os, "preadv", preadv)
    assert all(np.array_equal(a, b) for a, b in zip(page_bytes(again), expected)) and len(refused) == 1
    monkeypatch.delattr(os, "preadv")
    assert all(np.array_equal(a, b) for a, b in zip(page_bytes(again), expected))


def test_memory_that_is_not_aligned_is_filled_too(tmp_path):
    made = built("DISK", tmp_path)
    page = made.pages[0]
    buffer = page_buffer(page.byte_count + 100).numpy()[3:]
    made.store.read_into(page, buffer, True)
    assert np.array_equal(buffer[: page.byte_count], page_bytes(made)[0])


def test_pages_are_read_by_several_threads(tmp_path):
    made = built("DISK", tmp_path)
    expected, wrong = page_bytes(made), []

    def read(seed):
        buffer = page_buffer(made.page_bytes_max).numpy()
        for i in np.random.default_rng(seed).integers(0, len(made.pages), 30):
            made.store.read_into(made.pages[i], buffer, bool(seed % 2))
            if not np.array_equal(buffer[: made.pages[i].byte_count], expected[i]):
                wrong.append(i)

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert not wrong


@pytest.mark.parametrize("where", WHERE)
def test_a_disk_that_fills_up_leaves_nothing_behind(where, tmp_path):
    resource = pytest.importorskip("resource")
    expected = built("HOST", **WHERE[where])  # so that what is compiled for pages is there before files must be small
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limit[1]))
    try:
        with pytest.raises(PageFileError, match="free some space.*Nothing was left"):
            built("DISK", tmp_path, **WHERE[where])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert list(tmp_path.iterdir()) == []
    assert same(built("DISK", tmp_path, **WHERE[where]), expected)


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("at", ["finish", "sync", "replace", "build"])
def test_whatever_fails_leaves_nothing_behind(tmp_path, monkeypatch, at, where):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device") if at != "build" else KeyboardInterrupt

    monkeypatch.setattr(page_file, "_SYNCED_BYTES", 1 if at == "sync" else 1 << 40)
    call = {"replace": (os, "replace"), "build": (page_file.PageFileWriter, "add")}.get(at, (os, "fsync"))
    monkeypatch.setattr(*call, fail)
    with pytest.raises(PageFileError if at != "build" else KeyboardInterrupt):
        built("DISK", tmp_path, **WHERE[where])
    assert list(tmp_path.iterdir()) == []


def test_the_disk_is_waited_for_while_pages_are_made(tmp_path, monkeypatch):
    """Not at the end alone: what is written is the same."""
    expected = built("DISK", tmp_path / "end")
    monkeypatch.setattr(page_file, "_SYNCED_BYTES", 50_000)
    synced, sync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda number: (synced.append(os.fstat(number).st_size), sync(number)))
    found = built("DISK", tmp_path / "often")
    size = found.store.path.stat().st_size
    assert len(synced) > 3 and synced[-1] == size and np.diff(synced[:-1]).min() >= 50_000
    assert found.store.path.read_bytes() == expected.store.path.read_bytes()
