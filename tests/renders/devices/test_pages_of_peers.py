"""Devices that share a render hold pages of its geometry for each other: the film of one device, pages built once."""

from dataclasses import replace

import pytest

from raybatch_addon.core import session_device
from raybatch_addon.core.bvh.pages.peers import build as peers_build
from raybatch_addon.core.bvh.pages.peers.store import PeerStore
from raybatch_addon.core.scene.description import Scene
from tests.renders.devices.test_several_devices import failing, fine, settings_of, several
from tests.support.watched_renders import assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")

__all__ = ["several"]


@pytest.fixture
def stores(monkeypatch) -> list[PeerStore]:
    """The stores that are made."""
    made = []

    def noted(self, *given, within=PeerStore.__init__):
        made.append(self)
        within(self, *given)

    monkeypatch.setattr(PeerStore, "__init__", noted)
    return made


def moved(scene: Scene) -> Scene:
    """The same with its meshes a little larger."""
    return replace(scene, meshes=tuple(replace(mesh, positions=1.01 * mesh.positions) for mesh in scene.meshes))


def test_pages_are_built_once_for_all_and_kept_for_the_next_render(several, stores):
    settings = settings_of("peers")
    made = []
    for scene in (fine(), fine(), moved(fine())):
        tree = several.render(scene, settings).statistics["tree"]
        assert tree["store"] == "PEERS" and tree["peer_count"] == len(several.devices) and tree["peer_bytes"] > 0
        made.append(len(stores))
    # a share may be found too large once it is built
    assert made[0] < len(several.devices) and made[1] == made[0] and made[2] == 2 * made[0]


def test_several_devices_of_other_stores_have_pages_of_their_own(several, stores):
    film = several.render(fine(), settings_of("peers").replace(geometry_store="HOST"))
    assert film.statistics["tree"]["store"] == "HOST" and "peer_count" not in film.statistics["tree"] and not stores


def test_one_device_keeps_pages_in_host_memory_and_says_so(session, stores):
    film = session.render(fine(), settings_of("peers"))
    assert film.statistics["tree"]["store"] == "HOST" and not stores
    assert "geometry_store is HOST, not PEERS: one device renders" in film.statistics["warnings"]


def test_devices_that_fail_to_read_each_other_use_host_memory(session, several, stores, monkeypatch):
    expected = session.render(fine(), settings_of("peers"))
    monkeypatch.setattr(session_device, "let_read", lambda devices: "cuda:1 cannot read the memory of cuda:0")
    film = several.render(fine(), settings_of("peers"))
    assert_same_film(film, expected)
    assert film.statistics["tree"]["store"] == "HOST" and not stores
    found = "geometry_store is HOST, not PEERS: cuda:1 cannot read the memory of cuda:0"
    assert film.statistics["warnings"].count(found) == 1


def test_a_failure_on_one_device_leaves_the_session_well(session, several, monkeypatch):
    settings = settings_of("peers")
    expected, end = session.render(fine(), settings), RuntimeError("it broke")
    monkeypatch.setattr(peers_build, "build_paged_scene", failing(peers_build.build_paged_scene, 2, end))
    with pytest.raises(Exception, match="it broke"):
        several.render(fine(), settings)
    assert_same_film(several.render(fine(), settings), expected)
