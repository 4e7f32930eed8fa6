"""Pages in the pool are whole, shown launches keep theirs, and budgets hold; with a small scene of made-up pages."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages.facts import PageCounts
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.pages.resident import load_nodes
from raybatch_addon.core.bvh.pages.store import HostStore, Page, PageFileError
from raybatch_addon.core.bvh.pages.transfer import CudaTransfer, slots_in
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.errors import OutOfMemoryError

PAGE = 8192


def made_up(page_count: int = 6, nodes_resident: bool = False) -> PagedScene:
    """Two treelets a page; page i is full of bytes i + 1, its second treelet begins in the middle, triangles 64 bytes
    behind nodes.
    """
    store = HostStore(pinned=False)
    pages = []
    for i in range(page_count):
        first, memory = store.add(PAGE)
        memory[:] = i + 1
        pages.append(Page(2 * i, 2, first, PAGE, PAGE))
    count = 2 * page_count
    zeros = wp.zeros(count, dtype=int, device="cpu")
    node = np.tile([0, PAGE // 2], page_count).astype(np.int64)
    return PagedScene(
        layout=Layout.BOXES,
        tree=Tree(),
        of_node=zeros,
        root=zeros,
        deform=wp.zeros(0, dtype=int, device="cpu"),
        treelet_count=count,
        levels=2,
        pages=pages,
        treelet_page=np.repeat(np.arange(page_count), 2).astype(np.int32),
        treelet_node_byte=np.arange(count) * 64 if nodes_resident else node,
        treelet_triangle_byte=node + 64,
        nodes_resident=nodes_resident,
        store=store,
        box=np.zeros((2, 3)),
        resident_bytes=1000,
        page_node_bytes=np.zeros(page_count, np.int64),
        page_units=np.zeros(page_count, np.int64),
        resident_nodes=wp.zeros(64 * count if nodes_resident else 0, dtype=wp.uint8, device="cpu"),
    )


def residency_of(scene: PagedScene, slots: int) -> Residency:
    return Residency(scene, scene.resident_bytes + slots * PAGE, wp.get_device("cpu"))


def these(*pages: int):
    return lambda facts, count: list(pages)[: max(count, 0)]


NONE = these()


def bring(residency: Residency, *pages: int, victims=NONE, counts: PageCounts | None = None) -> list[int]:
    asked = residency.ask(these(*pages), victims, 100, counts or PageCounts())
    while any(not residency.there()[page] for page in asked):
        changes = residency.changes
        if not residency.there()[asked].all():
            residency.wait(changes, 1.0)
    return asked


def byte_at(address: int) -> int:
    return int(np.ctypeslib.as_array((np.ctypeslib.ctypes.c_uint8 * 1).from_address(int(address)))[0])


def shown_bytes(view) -> list[tuple[int, int]]:
    """What lies at the nodes and at the triangles of every treelet; 0: absent."""
    nodes, triangles = view.treelets.nodes.numpy(), view.treelets.triangles.numpy()
    return [(byte_at(a) if a else 0, byte_at(b) if b else 0) for a, b in zip(nodes, triangles)]


def test_treelets_find_their_blocks():
    residency = residency_of(made_up(), 3)
    view = residency.view()
    view.begin()
    assert shown_bytes(view) == [(0, 0)] * 12
    view.end()
    assert bring(residency, 4, 1) == [4, 1]
    view.begin()
    assert view.shown.tolist() == [1, 4]
    expected = [(0, 0)] * 12
    expected[2:4], expected[8:10] = [(2, 2)] * 2, [(5, 5)] * 2
    assert shown_bytes(view) == expected
    addresses = view.treelets.triangles.numpy().astype(np.int64)
    assert (addresses - view.treelets.nodes.numpy().astype(np.int64))[[2, 3, 8, 9]].tolist() == [64] * 4
    assert addresses[3] - addresses[2] == PAGE // 2 and view.treelets.nodes.numpy()[2] % 64 == 0
    view.end()
    view.begin(only=np.arange(6) == 4)
    assert [a for a, _ in shown_bytes(view)] == [0] * 8 + [5, 5, 0, 0]
    view.end()
    residency.close()


def test_nodes_that_stay_are_always_there():
    scene = made_up(nodes_resident=True)
    residency = residency_of(scene, 2)
    view = residency.view()
    bring(residency, 3)
    view.begin()
    assert np.array_equal(view.treelets.nodes.numpy(), scene.resident_nodes.ptr + 64 * np.arange(12, dtype=np.uint64))
    assert np.flatnonzero(view.treelets.triangles.numpy()).tolist() == [6, 7]
    view.end()
    residency.close()


def test_what_leaves_makes_room_and_is_counted():
    residency, counts = residency_of(made_up(), 2), PageCounts()
    assert bring(residency, 0, 1, 2, counts=counts) == [0, 1], "there is no room for a third"
    assert bring(residency, 2, counts=counts) == [], "and none leaves"
    assert bring(residency, 2, victims=these(0), counts=counts) == [2]
    assert residency.there().tolist() == [False, True, True, False, False, False]
    assert (counts.loaded, counts.evicted, counts.bytes_copied) == (3, 1, 3 * PAGE)
    assert residency.bytes_peak == 1000 + 2 * PAGE
    view = residency.view()
    view.begin()
    assert [a for a, _ in shown_bytes(view)] == [0, 0, 2, 2, 3, 3] + [0] * 6
    view.end()
    residency.close()


def test_a_launch_keeps_its_pages_until_it_is_over():
    residency = residency_of(made_up(), 1)
    bring(residency, 0)
    first, second = residency.view(), residency.view()
    first.begin()
    second.begin()
    asked = residency.ask(these(3), these(0), 1, PageCounts())
    assert asked == [3] and residency.is_coming()
    assert not residency.there().any(), "no launch is shown what leaves"
    assert [a for a, _ in shown_bytes(first)][:2] == [1, 1]
    first.end()
    assert shown_bytes(second)[0] == (1, 1) and not residency.there().any(), "the other launch still runs"
    changes = residency.changes
    second.end()
    while not residency.there()[3]:
        assert residency.wait(changes, 5.0)
        changes = residency.changes
    second.begin()
    assert [a for a, _ in shown_bytes(second)] == [0] * 6 + [4, 4] + [0] * 4
    second.end()
    residency.close()


def test_room_is_made_ahead():
    residency, counts = residency_of(made_up(), 3), PageCounts()
    bring(residency, 0, 1, 2)
    residency.make_room(these(2, 0, 1), 2, counts)
    assert residency.there().tolist() == [False, True, False, False, False, False] and counts.evicted == 2
    residency.make_room(these(1), 2, counts)
    assert counts.evicted == 2, "there is room already"
    assert bring(residency, 4, 5, victims=these(1), counts=counts) == [4, 5]
    assert counts.evicted == 2
    residency.close()


def test_only_so_many_are_on_their_way():
    residency = residency_of(made_up(), 6)
    gate = threading.Event()
    read_into = residency.scene.store.read_into
    residency.scene.store.read_into = lambda *given, **named: (gate.wait(5), read_into(*given, **named))
    assert residency.ask(these(0, 1, 2, 3), NONE, 2, PageCounts()) == [0, 1]
    assert residency.ask(these(2), NONE, 2, PageCounts()) == []
    assert residency.ask(these(2), NONE, 3, PageCounts()) == [2]
    facts = residency.facts()
    assert facts.absent.tolist() == [False] * 3 + [True] * 3 and not facts.evictable.any()
    gate.set()
    residency.close()
    assert residency.there().tolist() == [True] * 3 + [False] * 3 or not residency.there().all()


def test_who_waits_is_added_up():
    residency = residency_of(made_up(), 2)
    first, second = residency.view(), residency.view()
    first.set_waiting(np.array([5, 0, 0, 1, 0, 0]))
    bring(residency, 3)
    second.set_waiting(np.array([2, 7, 0, 0, 0, 0]))
    facts = residency.facts()
    assert facts.waiting.tolist() == [7, 7, 0, 1, 0, 0] and facts.clock == 1 and facts.served[3] == 1
    assert facts.since.tolist() == [0, 1, 0, 0, 0, 0], "since the first of them came"
    second.close()
    assert residency.facts().waiting.tolist() == [5, 0, 0, 1, 0, 0]
    first.set_waiting(np.array([3, 0, 0, 0, 0, 0]))
    del second
    first.close()
    assert not residency.facts().waiting.any()
    residency.close()


def test_a_page_that_cannot_be_read_stops_who_waits():
    residency = residency_of(made_up(), 2)

    def fails(*given, **named):
        raise PageFileError("the file of geometry is gone")

    residency.scene.store.read_into = fails
    residency.ask(these(0), NONE, 1, PageCounts())
    with pytest.raises(PageFileError, match="is gone"):
        while residency.wait(residency.changes, 5.0):
            pass
    with pytest.raises(PageFileError, match="is gone"):
        residency.view().begin()
    residency.close()


def test_a_transfer_waits_for_its_copies_where_one_of_its_threads_closes_it(monkeypatch):
    """The last to know a pool may be a thread that reads; the pool's memory is free behind that."""
    transfer, waited = CudaTransfer.__new__(CudaTransfer), []
    transfer._stream, transfer._threads = "stream", ThreadPoolExecutor(1)
    monkeypatch.setattr(wp, "synchronize_stream", waited.append)
    with pytest.raises(RuntimeError, match="join"):
        transfer._threads.submit(transfer.close).result(5)
    assert waited == ["stream"]


def test_budgets():
    scene = made_up()
    device = wp.get_device("cpu")
    assert slots_in(scene, 1000 + PAGE, device) == 1 and slots_in(scene, 1000 + 3 * PAGE - 1, device) == 2
    assert slots_in(scene, 2**62, device) == 6, "no more than there are pages"
    with pytest.raises(OutOfMemoryError, match=r"needs 9,192 at least .*raise it"):
        Residency(scene, 1000 + PAGE - 1, wp.get_device("cpu"))


def test_a_pool_of_more_bytes_than_an_array_has_elements():
    scene = made_up()
    scene.pages[0] = dataclasses.replace(scene.pages[0], device_bytes=3 << 29)
    residency = Residency(scene, 1000 + (3 << 30), wp.get_device("cpu"))  # memory that is never written is never had
    assert residency.slot_count == 2
    view = residency.view()
    bring(residency, 3, 4)
    view.begin()
    assert [a for a, _ in shown_bytes(view)] == [0] * 6 + [4, 4, 5, 5, 0, 0]
    addresses = view.treelets.nodes.numpy().astype(np.int64)
    assert abs(addresses[8] - addresses[6]) == 3 << 29
    view.end()
    residency.close()


def test_more_nodes_than_an_array_has_elements():
    count = 3
    sizes = np.full((count, 2), 1 << 30)
    read = []

    class Store:
        def read_into(self, page, host, direct):
            host[: 4096 if page.byte_first else 0] = 7
            read.append((page.byte_first, len(host)))

    tables = SimpleNamespace(page_bytes=sizes, page_byte=np.cumsum(sizes, 0) - sizes, page_treelet=np.arange(count + 1))
    nodes = load_nodes(tables, Store(), wp.get_device("cpu"))
    assert nodes.size == 3 << 30 and nodes.ptr % 4096 == 0 and read == [(i << 30, 1 << 30) for i in range(count)]
    assert byte_at(nodes.ptr + (2 << 30)) == 7


def test_slots_hold_the_largest_page():
    scene = made_up()
    scene.pages[3] = dataclasses.replace(scene.pages[3], device_bytes=PAGE + 1)
    residency = Residency(scene, 1000 + 2 * (PAGE + 4096), wp.get_device("cpu"))
    assert residency.slot_bytes == PAGE + 4096 and residency.slot_count == 2
    residency.close()
