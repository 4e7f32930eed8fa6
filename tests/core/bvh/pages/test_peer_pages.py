"""Pages that devices hold for each other: where they lie, who builds them, and when their memory may go."""

import gc
import re
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.peers import access
from raybatch_addon.core.bvh.pages.peers import store as store_module
from raybatch_addon.core.bvh.pages.peers.build import build_with_peers
from raybatch_addon.core.bvh.pages.peers.share import PEER_SHARE_MOST, Hold, ways_to_hold
from raybatch_addon.core.bvh.pages.peers.shared import PeerPages, SharedPages
from raybatch_addon.core.bvh.pages.peers.store import BuiltPages, PeerPlace, PeerStore
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.pages.store import PAGE_ALIGNMENT, Page
from raybatch_addon.core.bvh.pages.transfer import slots_in
from raybatch_addon.core.device.devices import is_alike
from raybatch_addon.core.errors import BuildCancelledError, OutOfMemoryError
from raybatch_addon.core.scene.flatten import flatten
from tests.core.bvh.pages.test_residency import NONE, bring, made_up, shown_bytes, these
from tests.support import paged_scenes
from tests.support.under_test import DEVICE

CPU = "cpu"
SIZE = 2 * PAGE_ALIGNMENT


def alike() -> list[wp.Device]:
    """Two devices of the model under test; where there are none, it stands for two."""
    device = wp.get_device(DEVICE)
    there = [each for each in wp.get_cuda_devices() if device.is_cuda and is_alike(each, device)] or [device]
    devices = [there[i % len(there)] for i in range(2)]
    assert access.let_read(devices) == ""
    return devices


def filled(share: int, page_count: int, size: int = SIZE) -> tuple[PeerStore, list[Page]]:
    """Pages of which each is full of its number."""
    store, pages = PeerStore(alike(), share), []
    memory = np.empty(size, np.uint8)
    for i in range(page_count):
        memory[:] = i + 1
        pages.append(Page(i, 1, store.add_page(memory, PAGE_ALIGNMENT), size, size))
    return store, pages


def assert_whole(store: PeerStore, pages: list[Page]) -> None:
    for place in range(2):
        at = PeerPlace(BuiltPages(None, store), place)
        for i, page in enumerate(pages):
            host = np.zeros(page.byte_count, np.uint8)
            at.read_into(page, host, direct=True)
            assert (host == i + 1).all()
            # as a transfer copies it, and a launch reads it: in the device's own name
            view = at.view(page)
            held = store.place_of(page) >= 0
            assert view.device == (store.devices[place] if held else wp.get_device(CPU))
            target = wp.zeros(page.byte_count, dtype=wp.uint8, device=store.devices[place])
            wp.copy(target, view)
            assert (target.numpy() == i + 1).all()


def test_devices_hold_the_same_and_all_is_read_by_all():
    store, pages = filled(4 * SIZE, 8)
    assert [store.held_by(place) for place in range(2)] == [4 * SIZE] * 2 and store.bytes_on_host == 0
    assert store.byte_count == 8 * SIZE
    assert sorted(store.place_of(page) for page in pages) == [0] * 4 + [1] * 4
    assert_whole(store, pages)


def test_what_has_no_room_lies_on_the_host():
    store, pages = filled(2 * SIZE + 100, 7)
    assert [store.held_by(place) for place in range(2)] == [2 * SIZE] * 2 and store.bytes_on_host == 3 * SIZE
    assert [store.place_of(page) for page in pages[4:]] == [-1] * 3
    assert_whole(store, pages)
    nothing, pages = filled(0, 2)
    assert nothing.bytes_on_host == 2 * SIZE == nothing.byte_count
    assert_whole(nothing, pages)


def test_a_part_of_a_page_is_read_from_its_place():
    store, pages = filled(4 * SIZE, 8)
    rest = Page(3, 1, pages[3].byte_first + PAGE_ALIGNMENT, PAGE_ALIGNMENT, PAGE_ALIGNMENT)
    assert store.place_of(rest) == store.place_of(pages[3])
    whole, part = (store.view(each, 0) for each in (pages[3], rest))
    assert part.ptr == whole.ptr + PAGE_ALIGNMENT and part.size == PAGE_ALIGNMENT


def test_a_device_without_memory_leaves_its_share_to_the_host(monkeypatch):
    asked = []

    def page_rows(byte_count, device, within=store_module.page_rows):
        asked.append(byte_count)
        if len(asked) > 1:
            raise RuntimeError("out of memory")
        return within(byte_count, device)

    monkeypatch.setattr(store_module, "page_rows", page_rows)
    store, pages = filled(4 * SIZE, 6)
    assert len(asked) == 2, "a device that refused is not asked again"
    assert store.held_by(0) == 4 * SIZE and store.held_by(1) == 0 and store.bytes_on_host == 2 * SIZE
    monkeypatch.undo()
    assert_whole(store, pages)


def test_memory_goes_when_no_device_reads_it(monkeypatch):
    """Another device's stream knows nothing of what is freed here."""
    waited = []
    store = PeerStore.__new__(PeerStore)
    devices = [SimpleNamespace(alias=f"cuda:{i}", is_cuda=True) for i in (0, 1, 1)]
    store.devices = devices
    monkeypatch.setattr(store_module.wp, "synchronize_device", lambda device: waited.append(device.alias))
    store.__del__()
    assert waited == ["cuda:0", "cuda:1"]
    store.devices = ()


# --- who may hold pages for whom


def faked(monkeypatch, pooled: bool, refuses: tuple[str, str] | None = None, fails: bool = False) -> list[tuple]:
    """Devices' access as Warp has it, for devices that are not there."""
    turned: list[tuple] = []

    def supported(owner, reader):
        return (owner.alias, reader.alias) != refuses

    def turn(owner, reader, enable):
        if fails:
            raise RuntimeError("no")
        turned.append((owner.alias, reader.alias))

    names = ("mempool", "peer") if pooled else ("peer", "mempool")
    for name, is_used in zip(names, (True, False), strict=True):
        for verb, call in (("is_{}_access_supported", supported), ("set_{}_access_enabled", turn)):
            monkeypatch.setattr(access.wp, verb.format(name), call if is_used else None)
        monkeypatch.setattr(access.wp, f"is_{name}_access_enabled", (lambda *_: False) if is_used else None)
    monkeypatch.setattr(access.wp, "is_mempool_enabled", lambda device: pooled)
    return turned


def gpus(*names: str) -> list:
    return [
        SimpleNamespace(alias=f"cuda:{i}", name=name, arch=90, is_cuda=True, is_cpu=False)
        for i, name in enumerate(names)
    ]


@pytest.mark.parametrize("pooled", [True, False])
def test_each_reads_the_memory_of_all_others(monkeypatch, pooled):
    turned = faked(monkeypatch, pooled)
    devices = gpus("H", "H", "H")
    assert access.why_apart(devices) == "" and not turned
    assert access.let_read(devices) == ""
    assert sorted(turned) == [(f"cuda:{i}", f"cuda:{j}") for i in range(3) for j in range(3) if i != j]


def test_why_devices_hold_none_for_each_other(monkeypatch):
    faked(monkeypatch, True, refuses=("cuda:1", "cuda:0"), fails=True)
    assert access.why_apart([]) == access.why_apart(gpus("H")) == "one device renders"
    assert access.why_apart(gpus("H", "A")) == "cuda:0 and cuda:1 are of unlike models"
    assert access.why_apart(gpus("H", "H")) == "cuda:0 cannot read the memory of cuda:1"
    assert access.let_read(gpus("H", "H")) == "cuda:1 cannot read the memory of cuda:0"
    assert access.why_apart([wp.get_device(CPU)] * 3) == "", "as tests have it"


def test_shares():
    most = int(1000 * PEER_SHARE_MOST)
    # all of it as the device has it, where there is room
    half = most // 2
    assert ways_to_hold(1000, 4, plain=2000, packed=900) == [Hold(500, False), Hold(half, True), Hold(0, True)]
    assert ways_to_hold(1000, 4, plain=4 * most + 1, packed=900) == [Hold(225, True), Hold(225, True), Hold(0, True)]
    assert ways_to_hold(1000, 2, plain=10**6, packed=10**5) == [Hold(most, True), Hold(half, True), Hold(0, True)]
    assert ways_to_hold(1000, 2, plain=10**6, packed=None) == [Hold(most, False), Hold(half, False), Hold(0, False)]


# --- who builds them


def built() -> BuiltPages:
    return BuiltPages(None, PeerStore([wp.get_device(CPU)], 0))


def test_the_first_builds_and_others_wait():
    shared, made, begun = SharedPages(), [], threading.Barrier(4)

    def build():
        time.sleep(0.05)
        made.append(built())
        return made[-1]

    def ask():
        begun.wait()
        return shared.get(b"one", build, lambda: False)

    with ThreadPoolExecutor(4) as pool:
        found = [each.result() for each in [pool.submit(ask) for _ in range(4)]]
    assert len(made) == 1 and all(each is made[0] for each in found)


def test_what_nobody_uses_is_built_anew_and_what_is_used_is_waited_for():
    shared = SharedPages()
    held = [shared.get(b"one", built, lambda: False)]
    threading.Timer(0.2, held.clear).start()
    order = []

    def second():
        order.append(len(held))
        return built()

    shared.get(b"two", second, lambda: False)
    assert order == [0], "the pages of the last frame were gone"
    assert shared.get(b"two", second, lambda: False) is not None and len(order) == 2


def test_those_who_wait_can_be_cancelled_and_a_failure_leaves_the_next_to_build():
    shared, gate, begun = SharedPages(), threading.Event(), threading.Event()

    def fails():
        begun.set()
        assert gate.wait(5)
        raise OutOfMemoryError("no room")

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(shared.get, b"one", fails, lambda: False)
        assert begun.wait(5)
        with pytest.raises(BuildCancelledError):
            shared.get(b"one", built, lambda: True)
        gate.set()
        with pytest.raises(OutOfMemoryError):
            first.result(5)
    assert shared.get(b"one", built, lambda: False)


# --- in the pool


def test_pages_at_home_are_shown_always_and_take_no_slot():
    scene = made_up()
    kept = scene.store.view(scene.pages[2])
    scene.home = np.zeros(6, np.uint64)
    scene.home[2] = kept.ptr
    device = wp.get_device(CPU)
    assert slots_in(scene, 2**62, device) == 5
    residency = Residency(scene, scene.resident_bytes + 2 * SIZE, device)
    view = residency.view()
    assert residency.there().tolist() == [page == 2 for page in range(6)]
    view.begin()
    assert [a for a, _ in shown_bytes(view)] == [0] * 4 + [3, 3] + [0] * 6
    assert view.treelets.nodes.numpy()[4] == kept.ptr
    view.end()
    bring(residency, 0, 1)
    assert not residency.facts().evictable[2] and residency.facts().evictable[:2].all()
    assert bring(residency, 4, victims=these(0)) == [4]
    view.begin()
    assert [a for a, _ in shown_bytes(view)] == [0, 0, 2, 2, 3, 3, 0, 0, 5, 5, 0, 0]
    view.end()
    assert residency.ask(these(), NONE, 5, view.counts) == []
    residency.close()


# --- whole scenes


def scenes_of(budget: int, devices: list[wp.Device], layout: Layout, encodes: bool = False):
    made = paged_scenes.everything()
    flat, visibility = flatten(made), made.instances.visibility
    parts = PeerPages.of(SharedPages(), devices)
    with ThreadPoolExecutor(len(parts)) as pool:  # side by side, as a session does
        waited = [
            pool.submit(
                build_with_peers,
                part,
                flat,
                visibility,
                layout,
                device,
                budget=budget,
                encoded=encodes,
                cancelled=lambda: False,
            )
            for part, device in zip(parts, devices, strict=True)
        ]
        return [each.result() for each in waited]


def test_a_scene_is_built_once_for_all_and_budgets_hold():
    devices = alike()
    layout = Layout.QUANTISED if devices[0].is_cuda else Layout.BOXES
    budget = 1_000_000
    made = scenes_of(budget, devices, layout)
    first, second = made
    assert first.store.store is second.store.store
    assert {each.statistics["store"] for each in made} == {"PEERS"}
    for place, scene in enumerate(made):
        assert scene.statistics["peer_bytes"] + scene.statistics["host_bytes"] == scene.store.byte_count
        assert scene.store.held > 0 and scene.resident_bytes > scene.store.held
        residency = Residency(scene, budget, devices[place])
        assert residency.bytes_peak + residency.slot_count * residency.slot_bytes <= budget
        residency.close()
    at_home = np.stack([scene.home > 0 for scene in made])
    assert at_home.any(1).all() and not at_home.all(0).any(), "each page lies in one place"
    for place in range(2):
        for a, b in zip(paged_scenes.page_bytes(made[place]), paged_scenes.page_bytes(made[0]), strict=True):
            assert np.array_equal(a, b)
    pages, contents = weakref.ref(first.store.store), paged_scenes.page_bytes(first)
    del first, scene
    made.pop(0)
    gc.collect()
    for a, b in zip(paged_scenes.page_bytes(second), contents, strict=True):
        assert np.array_equal(a, b), "one device has given them up"
    assert pages() is not None
    del second, made, residency
    gc.collect()
    assert pages() is None, "nobody has them any more"


def test_a_budget_without_room_for_shares_says_so():
    devices = alike()
    layout = Layout.QUANTISED if devices[0].is_cuda else Layout.BOXES
    with pytest.raises(OutOfMemoryError, match="are enough") as refused:
        scenes_of(1, devices, layout)
    enough = re.search(r"([\d,]+) bytes are enough", str(refused.value))[1]  # without shares
    made = scenes_of(int(enough.replace(",", "")), devices, layout)
    assert {each.statistics["store"] for each in made} == {"HOST"}
    assert all("not PEERS" in each.statistics["store_warning"] for each in made)
    assert made[0].store.held == 0 and made[0].statistics["host_bytes"] == made[0].store.byte_count


@pytest.mark.parametrize(("budget", "encoded"), [(300_000, True), (600_000, False)])
def test_pages_are_those_of_the_host(budget, encoded):
    """Packed where the shares do not hold all of them as the device has them; only others are read in place."""
    devices, made = alike(), paged_scenes.everything()
    for scene in scenes_of(budget, devices, Layout.QUANTISED, encodes=True):
        assert scene.statistics["store"] == "PEERS" and scene.encoded == encoded == (scene.home is None)
        on_host = build_paged_scene(
            flatten(made),
            made.instances.visibility,
            Layout.QUANTISED,
            devices[0],
            8 * scene.statistics["page_bytes"],  # for pages of the same size
            nodes_resident=scene.nodes_resident,
            encoded=encoded,
        )
        assert on_host.statistics["store"] == "HOST" and on_host.pages == scene.pages
        for a, b in zip(paged_scenes.page_bytes(scene), paged_scenes.page_bytes(on_host), strict=True):
            assert np.array_equal(a, b)
