"""Devices of one model that share a render: the film of one of them, bit for bit."""

import threading
import time

import pytest
import warp as wp

from raybatch_addon.core import session as session_module
from raybatch_addon.core.bvh.build.in_common import TreesInCommon
from raybatch_addon.core.bvh.build.mesh_tree import MeshTrees
from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.bvh.memory import GeometrySize
from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.errors import DeviceError
from raybatch_addon.core.native.structs import copied_by_host
from raybatch_addon.core.session import Session
from raybatch_addon.core.session_device import SessionDevice
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.render import deal
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from raybatch_addon.core.wavefront.scheduler import CUDA_WORKERS
from raybatch_addon.core.wavefront.tile_state import TileState
from tests.support import scenes
from tests.support.under_test import DEVICE
from tests.support.watched_renders import FRAME, SETTINGS, assert_same_film, stopping

pytestmark = pytest.mark.usefixtures("general_kernels")

COUNT = 3
WAYS = {
    "progressive": dict(tile_size=5),
    "tile first": dict(tile_order="TILE_FIRST", tile_size=7),
    "halves": dict(error_estimate="ON", tile_size=6),
    "adaptive": dict(adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8, sample_count=32, tile_size=6),
    "rounds": dict(error_target=1e-9, sample_count=16, tile_size=9),
    "batched": dict(batching="ON", debug_checks="ON", tile_size=8),
    "paged": dict(debug_checks="ON", tile_size=8),
    "peers": dict(debug_checks="ON", tile_size=8, geometry_store="PEERS"),
}
# Budgets, as shares of what the whole scene takes at most
PAGED = {"paged": 0.2, "peers": 0.6}


def devices_like_it() -> list[wp.Device]:
    """`COUNT` devices like the one under test; fewer where there are fewer of CUDA, each of them once (Warp's sorts
    share memory, and a capture takes in what others launch). The CPU stands for several.
    """
    device = wp.get_device(DEVICE)
    if device.is_cpu:
        return [device] * COUNT
    return [each for each in wp.get_cuda_devices() if each.name == device.name][:COUNT]


def of_several() -> Session:
    """A session of `devices_like_it`."""
    there = devices_like_it()
    if len(there) < 2:
        pytest.skip("there are no two devices alike")
    session = Session(DEVICE)
    session._at = [SessionDevice(each) for each in there]
    return session


@pytest.fixture
def several(monkeypatch):
    """The same; each tile lies elsewhere than its next worker, who is another one each time."""

    def move_to(self: TileState, device: wp.Device) -> None:
        if self.held is not None:
            self.held = self.held.copied(device)
        if self.active is not None:
            self.active = copied_by_host(self.active, device)

    monkeypatch.setattr(TileState, "move_to", move_to)
    monkeypatch.setattr(session_module, "SHARED_PATHS_LEAST", 0)
    monkeypatch.setattr(deal.Deal, "take", lambda self, place: self._waiting.pop(0)[0] if self._waiting else None)
    session = of_several()
    yield session
    session.close()


def fine() -> scenes.Scene:
    """A scene that has pages."""
    return scenes.mixed(FRAME, 4)


def settings_of(way: str):
    budget = {}
    if way in PAGED:
        layout = layout_for(wp.get_device(DEVICE))
        budget["geometry_budget"] = int(PAGED[way] * GeometrySize.of(fine()).tree_bytes_most(layout))
    return SETTINGS.replace(**{"thread_count": 1, "sample_count": 12, **WAYS[way], **budget})


def workers_of_one(way: str) -> int:
    """Workers of a device: a GPU has two where no ray waits."""
    waits = way in PAGED or way == "batched"
    return 1 if waits or wp.get_device(DEVICE).is_cpu else CUDA_WORKERS


def failing(call, number, error):
    """`call`, whose call of this `number` fails."""
    calls = []

    def called(*arguments, **options):
        calls.append(1)
        if len(calls) == number:
            raise error
        return call(*arguments, **options)

    return called


@pytest.mark.parametrize("way", WAYS)
def test_the_film_is_that_of_one_device(session, several, way):
    settings = settings_of(way)
    expected = session.render(fine(), settings)
    for _ in range(2):  # the second with what the first left
        film = several.render(fine(), settings)
        assert_same_film(film, expected)
        assert film.statistics["rays"] == expected.statistics["rays"]
    assert film.statistics["schedule"]["workers"] == workers_of_one(way) * len(several.devices)


def test_the_statistics_list_the_devices(several):
    settings = settings_of("progressive")
    found = several.render(fine(), settings).statistics
    assert [each["alias"] for each in found["devices"]] == [each.alias for each in several.devices]
    shares = {each["alias"]: each for each in found["devices"]}  # the CPU stands for several
    assert sum(each["paths"] for each in shares.values()) == settings.sample_count * FRAME.pixel_count
    assert all(0 < each["seconds_working"] <= found["seconds"]["render"] for each in shares.values())
    assert found["device"].items() < found["devices"][0].items()


def test_trees_are_built_by_one_of_them(session, several, monkeypatch):
    """Where the others ask while it builds: it waits for them here."""
    if several.device.is_cpu:
        pytest.skip("the CPU stands for several")
    expected = session.render(fine(), settings_of("progressive"))
    build, get, built, asked = MeshTrees.build, TreesInCommon.get, [], threading.Barrier(len(several.devices))

    def get_together(self, device, kind, own):
        def own_with_others():
            deadline = time.monotonic() + 60
            while sum(map(len, self._waiting.values())) < len(several.devices) - 1 and time.monotonic() < deadline:
                time.sleep(0.001)
            return own()

        asked.wait(60)
        return get(self, device, kind, own_with_others)

    monkeypatch.setattr(TreesInCommon, "get", get_together)
    monkeypatch.setattr(MeshTrees, "build", lambda self, part: built.append(part) or build(self, part))
    film = several.render(fine(), settings_of("progressive"))
    assert len(built) == film.statistics["tree"]["trees"] > 0
    assert_same_film(film, expected)


def test_few_paths_are_not_shared(session, several, monkeypatch):
    settings = settings_of("progressive")
    expected = session.render(fine(), settings)
    monkeypatch.setattr(session_module, "SHARED_PATHS_LEAST", settings.sample_count * FRAME.pixel_count + 1)
    film = several.render(fine(), settings)
    assert_same_film(film, expected)
    assert len(film.statistics["devices"]) == 1
    assert film.statistics["schedule"]["workers"] == workers_of_one("progressive")


def test_a_stopped_render_goes_on_with_other_devices(session, several):
    settings = settings_of("halves")
    expected = session.render(fine(), settings)
    for first, second in ((session, several), (several, session)):
        with stopping(5):
            film = first.render(fine(), settings)
        assert not film.complete and film.resume_state
        assert_same_film(second.render(fine(), settings, resume=film), expected)


def test_a_checkpoint_of_one_device_goes_on_with_several(session, several, tmp_path):
    settings, path = settings_of("progressive"), tmp_path / "film.checkpoint"
    expected = session.render(fine(), settings)
    with stopping(5):
        stopped = session.render(fine(), settings, checkpoint=Checkpoint(path))
    assert not stopped.complete and path.exists()
    assert_same_film(several.render(fine(), settings, checkpoint=Checkpoint(path)), expected)


def test_what_fails_on_one_device_fails_the_render_and_leaves_the_session_well(session, several, monkeypatch):
    settings = settings_of("progressive")
    expected = session.render(fine(), settings)
    lack = DeviceError("the last one has no room")
    monkeypatch.setattr(DeviceScene, "build", failing(DeviceScene.build, len(several.devices), lack))
    with pytest.raises(DeviceError, match="the last one has no room"):
        several.render(fine(), settings)
    assert_same_film(several.render(fine(), settings), expected)

    end = DeviceError("one of them is gone")
    monkeypatch.setattr(TileIntegrator, "render", failing(TileIntegrator.render, 5, end))
    with pytest.raises(DeviceError, match="one of them is gone"):
        several.render(fine(), settings)
    assert_same_film(several.render(fine(), settings), expected)


def test_a_cancel_while_they_build_ends_all(several, monkeypatch):
    build = DeviceScene.build
    begun = []

    def noted(*arguments, **options):
        begun.append(1)
        return build(*arguments, **options)

    monkeypatch.setattr(DeviceScene, "build", noted)
    film = several.render(fine(), settings_of("progressive"), cancelled=lambda: bool(begun))
    assert not film.complete and film.sample_total == 0
    assert several.render(fine(), settings_of("progressive")).complete


@pytest.mark.parametrize("names", [f"{DEVICE},{DEVICE}", f"{DEVICE}, nothing"])
def test_names_that_mean_no_devices(names):
    with pytest.raises(DeviceError, match="twice|there is no device ' nothing'"):
        Session(names)


def test_all_means_every_device_of_the_first_ones_model():
    found = Session("ALL").devices
    first = found[0]
    assert first.alias == ("cuda:0" if wp.get_cuda_devices() else "cpu")
    assert found == ([each for each in wp.get_cuda_devices() if each.name == first.name] or [first])
