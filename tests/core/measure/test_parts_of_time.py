"""Parts of a render's time: named as they are, and nothing outside any of them."""

import contextlib
import dataclasses
import threading

import pytest

from raybatch_addon.core.ahead import aside
from raybatch_addon.core.device.loading import loads_noted
from raybatch_addon.core.device.notes import compiling_noted
from raybatch_addon.core.measure.parts import BUILD_PARTS, PARTS, Parts
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene import device_scene
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.support import feature_scenes
from tests.support.under_test import DEVICE

SETTINGS = RenderSettings(sample_count=1, bounce_max=2)


class Ticks:
    """A clock that moves when it is told to."""

    def __init__(self):
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def full_scene():
    """Displacement, a volume and a lamp."""
    fog = feature_scenes.ALL_FEATURES["volume"][0]
    materials = list(fog.materials)
    place = next(i for i, each in enumerate(materials) if each.volume is None)
    materials[place] = dataclasses.replace(materials[place], displacement=feature_scenes.displacing().displacement)
    return dataclasses.replace(fog, materials=tuple(materials))


def test_parts_follow_one_another_and_add_up():
    clock = Ticks()
    parts = Parts("export", clock)
    for seconds, part in ((2.0, "check"), (0.5, "tree"), (1.0, "kernels"), (4.0, "tree"), (0.25, "render")):
        clock.now += seconds
        parts.enter(part)
    clock.now += 8.0
    parts.compile_seconds = 100.0
    reported = parts.record()
    assert {name: reported[name] for name in PARTS if name in reported} == {
        "export": 2.0,
        "check": 0.5,
        "tree": 1.25,
        "kernels": 4.0,
        "render": 8.0,
    }
    assert (reported["build"], reported["compile"], reported["total"]) == (1.25, 100.0, 15.75)
    clock.now += 1.0
    assert parts.record()["total"] == 16.75 == parts.elapsed


def test_waiting_for_kernels_is_no_part_of_what_waits(monkeypatch):
    clock = Ticks()
    parts = Parts("lights", clock)
    noted = []
    monkeypatch.setattr(aside, "loads_noted", lambda note: noted.append(note) or contextlib.nullcontext())
    with aside.kernels_apart(aside.WaitedParts(parts)):
        clock.now += 1.0
        noted[0](True)
        assert parts.message == "Loading kernels"
        with compiling_noted():
            assert parts.message == "Compiling kernels"
        assert parts.message == "Loading kernels"
        clock.now += 10.0
        noted[0](False)
        assert parts.part == "lights"
    assert parts.record()["lights"] == 1.0 and parts.record()["kernels"] == 10.0


def test_loads_are_noted_on_the_thread_that_waits(device):
    """And none where a module is loaded."""
    from raybatch_addon.core.device.devices import load_module
    from raybatch_addon.core.film.tile import add_integers_kernel

    session = Session(device)
    heard = []
    with loads_noted(heard.append):
        other = threading.Thread(target=load_module, args=(add_integers_kernel, session.device))
        other.start()
        other.join()
        load_module(add_integers_kernel, session.device)
    session.close()
    assert heard == []


@pytest.fixture
def watched(monkeypatch):
    """The part that went on when each of these was called."""
    clocks, found = [], {}

    class Watched(Parts):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            clocks.append(self)

    monkeypatch.setattr("raybatch_addon.core.session.Parts", Watched)
    for owner, name in (
        (SceneCache, "displaced"),
        (SceneCache, "get"),
        (device_scene, "upload_materials"),
        (device_scene, "upload_lights"),
        (device_scene, "upload_volumes"),
    ):
        whole = getattr(owner, name)

        def call(*arguments, _whole=whole, _name=name, **options):
            found[_name] = clocks[-1].part
            return _whole(*arguments, **options)

        monkeypatch.setattr(owner, name, call)
    return found


@pytest.mark.usefixtures("general_kernels")
def test_each_part_of_a_render_goes_by_its_own_name_and_they_add_up_to_the_total(device, watched, monkeypatch):
    session, messages, shown, displaced = Session(device), [], threading.Event(), SceneCache.displaced

    def displaced_once_shown(*arguments, **options):
        """Displacement of so small a scene is over before anybody looks."""
        made = displaced(*arguments, **options)
        shown.wait(30)
        return made

    def note(progress):
        messages.append(progress.message)
        if progress.message == "Displacing surfaces":
            shown.set()

    monkeypatch.setattr(SceneCache, "displaced", displaced_once_shown)
    try:
        film = session.render(full_scene(), SETTINGS, on_progress=note)
    finally:
        session.close()
    assert watched == {
        "displaced": "displacement",
        "get": "tree",
        "upload_materials": "materials",
        "upload_lights": "lights",
        "upload_volumes": "volumes",
    }
    reported = film.statistics["seconds"]
    named = [part for part in PARTS if part in reported]
    others = ("export", "start", "wait", "checkpoint", "denoise", "write")
    assert named == [part for part in PARTS if part not in others]
    assert set(reported) - set(named) == {"build", "compile", "total"}
    assert reported["total"] == pytest.approx(sum(reported[part] for part in named), abs=1e-5)
    assert reported["build"] == pytest.approx(sum(reported[part] for part in BUILD_PARTS), abs=1e-5)
    assert "Displacing surfaces" in messages and messages[-1] == "Rendering"


@pytest.mark.skipif(DEVICE != "cpu", reason="CUDA's compiler takes minutes for general kernels")
def test_the_tier_that_renders_is_reported(device, monkeypatch):
    scene, reported, shown, get = feature_scenes.ALL_FEATURES["volume"][0], [], threading.Event(), SceneCache.get
    session = Session(device)

    def get_once_shown(*arguments, **options):
        """The tree of so small a scene is there before anybody looks."""
        shown.wait(30)
        return get(*arguments, **options)

    def note(progress):
        reported.append(progress.kernels)
        shown.set()

    monkeypatch.setattr(SceneCache, "get", get_once_shown)
    try:
        film = session.render(scene, SETTINGS.replace(kernel_tier="GENERAL"), on_progress=note)
    finally:
        session.close()
    assert film.statistics["kernels"] == {
        "tier": "GENERAL",
        "why": "as set",
        "specialised_after": None,
        "compiled_for_next": False,
    }
    assert set(reported) == {"", "general"}
