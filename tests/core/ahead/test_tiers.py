"""General kernels give the films of specialised ones, bit for bit, also where these take over in the middle."""

import gc
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from warp._src.codegen import Adjoint

from raybatch_addon.core import session as session_module
from raybatch_addon.core.ahead import change
from raybatch_addon.core.ahead.change import Decision, Polled
from raybatch_addon.core.device.devices import is_compiled
from raybatch_addon.core.device.kernel import is_general
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront import kernels
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.kernels import StageKernels
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from raybatch_addon.core.wavefront.tier import (
    GENERAL_CLOSURES_MOST,
    VARIABLE,
    choose_tier,
    general_features,
    general_kernels,
    why_not_general,
)
from tests.support import scenes, schedule_scenes
from tests.support.feature_scenes import ALL_FEATURES
from tests.support.feature_scenes import SETTINGS as FEATURE_SETTINGS
from tests.support.running.shares import each_of, thorough_but
from tests.support.under_test import DEVICE

ROOT = Path(__file__).resolve().parents[3]
ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
SETTINGS = RenderSettings(sample_count=4, bounce_max=5, roulette_bounce=2)


@pytest.fixture(autouse=True)
def choice_is_free(monkeypatch):
    """Tiers are chosen as for a user."""
    monkeypatch.delenv(VARIABLE)


# The frame and the setting that tests of the mixed scene have in common, as kernels are specialised on them
FRAME = Frame(24, 20, passes=("Combined", "Depth", "Position"), transparent=True)
CLAMPED = dict(clamp_indirect=0.5)
SCENES = {**schedule_scenes.SCENES, "plain": scenes.mixed}
# What is run always of those and of features, each of which compiles specialised kernels of its own
SCENES_ALWAYS = ("plain", "living")
HISTORY = "transparent with a program that asks for history"
ALWAYS = (HISTORY, "a volume with a program", "all passes of a program")


def films(scene, **changes):
    """The film by specialised and by general kernels."""
    return [
        Session(DEVICE).render(scene, SETTINGS.replace(kernel_tier=tier, **changes))
        for tier in ("SPECIALISED", "GENERAL")
    ]


def assert_same(film, expected):
    assert film.passes.keys() == expected.passes.keys()
    for name, values in expected.passes.items():
        assert np.array_equal(film.passes[name], values, equal_nan=True), name
    assert np.isfinite(expected.passes["Combined"]).all() and expected.passes["Combined"][..., :3].std() > 0


@ON_CPU
@pytest.mark.parametrize("name", thorough_but(SCENES_ALWAYS, SCENES))
def test_tiers_give_the_same_film(name):
    specialised, general = films(SCENES[name]())
    assert_same(general, specialised)


@ON_CPU
@pytest.mark.parametrize("feature", thorough_but(ALWAYS, ALL_FEATURES))
def test_tiers_give_the_same_film_of_each_feature(feature):
    scene, changes = ALL_FEATURES[feature]
    specialised, general = (
        Session(DEVICE).render(scene, FEATURE_SETTINGS.replace(kernel_tier=tier, **changes))
        for tier in ("SPECIALISED", "GENERAL")
    )
    features = derive_features(prepared_scene(scene, FEATURE_SETTINGS), FEATURE_SETTINGS.replace(**changes))
    assert why_not_general(features, wp.get_device(DEVICE)) == ""
    assert general.passes.keys() == specialised.passes.keys()
    for name, values in specialised.passes.items():
        assert np.isfinite(values).all() and values.any(), name
        assert np.array_equal(general.passes[name], values), name


@ON_CPU
@pytest.mark.parametrize(
    "frame, changes",
    each_of(
        6,
        [
            (FRAME, CLAMPED),
            (Frame(24, 20, transparent=True), {}),
            (Frame(24, 20, passes=("Combined", "Normal")), {}),
            (None, dict(nee="OFF")),
            (None, dict(nee="HALF")),
            (None, dict(roulette_bounce=99)),
        ],
    ),
    ids=["depth, position and clamping", "transparent", "normal", "no nee", "half of nee", "no roulette"],
)
def test_what_frames_and_settings_ask_for_counts_in_both_tiers(frame, changes):
    """Frames have what they ask for, and no more."""
    scene = scenes.mixed(frame)
    specialised, general = films(scene, **changes)
    assert_same(general, specialised)
    assert set(general.passes) == set(scene.frame.passes)


@ON_CPU
def test_one_kernel_gives_the_film_of_those_for_each_stage(monkeypatch):
    """What a scene lacks has nothing to do in it."""
    scene, settings = scenes.mixed(), SETTINGS.replace(kernel_tier="GENERAL")
    expected = Session(DEVICE).render(scene, settings)
    monkeypatch.setattr(kernels, "is_wide", lambda _: True)
    monkeypatch.setattr(kernels, "is_common", lambda _: False)
    monkeypatch.setattr(kernels, "_chosen", kernels._chosen.__wrapped__)  # what was chosen before is not remembered
    device = wp.get_device(DEVICE)
    shading = StageKernels.choose(derive_features(scene, settings), device, general_features(device)).shading
    assert set(shading.values()) == {general_kernels(device)[0]}
    assert_same(Session(DEVICE).render(scene, settings), expected)


@ON_CPU
@pytest.mark.parametrize("name", thorough_but(SCENES_ALWAYS, SCENES))
def test_specialised_kernels_take_over_in_the_middle(name, monkeypatch):
    scene = SCENES[name]()
    features = derive_features(scene, SETTINGS)
    expected = Session(DEVICE).render(scene, SETTINGS.replace(kernel_tier="SPECIALISED"))
    turns, finish = [], TileIntegrator._finish_paths

    def finish_and_change(self, *arguments):
        turns.append(self._kernels)
        if len(turns) == 3:
            self.use_kernels(StageKernels.choose(features, wp.get_device(DEVICE)))
        return finish(self, *arguments)

    monkeypatch.setattr(TileIntegrator, "_finish_paths", finish_and_change)
    film = Session(DEVICE).render(scene, SETTINGS.replace(kernel_tier="GENERAL", thread_count=1))
    assert_same(film, expected)
    assert turns[2] != turns[3] == StageKernels.choose(features, wp.get_device(DEVICE))


def choose_general_by_itself(features, setting, device):
    """General kernels where the setting leaves the choice, whatever is compiled."""
    return replace(choose_tier(features, setting.replace("AUTO", "GENERAL"), device), asked=setting)


@ON_CPU
def test_a_render_changes_by_itself_where_that_pays(monkeypatch):
    """What is compiled meanwhile is used, and statistics say so."""
    scene, asked = scenes.mixed(replace(FRAME, width=64, height=64)), []
    settings = SETTINGS.replace(sample_count=256, tile_size=16, **CLAMPED)
    Session(DEVICE).render(scene, settings.replace(kernel_tier="SPECIALISED", sample_count=1))

    def compiled(_self, request, *_):
        asked.append(request.features)
        return Polled(True)

    monkeypatch.setattr(change.TierChanges, "poll", compiled)
    monkeypatch.setattr(change, "_POLL_SECONDS", 0.001)
    monkeypatch.setattr(session_module, "choose_tier", choose_general_by_itself)
    session = Session(DEVICE)
    film = session.render(scene, settings)
    assert asked == [derive_features(scene, settings)]
    chosen = film.statistics["auto"]["kernel_tier"]
    assert chosen["value"] == "GENERAL" and "took over after" in chosen["why"]
    assert film.statistics["kernels"]["why"] == chosen["why"]
    assert_same(film, Session(DEVICE).render(scene, settings.replace(kernel_tier="SPECIALISED")))


@ON_CPU
def test_what_is_compiled_beside_a_render_is_told(monkeypatch):
    """Paths end once it was told."""
    told, process = threading.Event(), SimpleNamespace(is_running=True, stop=lambda: None)
    finish = TileIntegrator._finish_paths

    def finish_once_told(self, *arguments):
        assert told.wait(60)
        return finish(self, *arguments)

    monkeypatch.setattr(TileIntegrator, "_finish_paths", finish_once_told)
    monkeypatch.setattr(change, "_POLL_SECONDS", 0.001)
    monkeypatch.setattr(change, "weigh_compiling", lambda *_: Decision(True, "it pays", None))
    monkeypatch.setattr(change, "CompileProcess", lambda *_: process)
    monkeypatch.setattr(session_module, "choose_tier", choose_general_by_itself)
    session = Session(DEVICE)
    settings = SETTINGS.replace(tile_size=16, thread_count=2)  # beside the thread that tells
    film = session.render(
        scenes.mixed(Frame(64, 64)), settings, on_progress=lambda each: told.set() if each.compiles else None
    )
    session.close()
    assert told.is_set()
    kernels = film.statistics["kernels"]
    assert kernels["compiled_for_next"] and kernels["specialised_after"] is None
    assert kernels["why"].endswith("; it pays; they were not ready before the end")


@ON_CPU
def test_auto_takes_what_is_compiled():
    device, scene = wp.get_device(DEVICE), scenes.mixed(FRAME)
    features = derive_features(scene, SETTINGS.replace(**CLAMPED))
    films(scene, **CLAMPED)
    assert not choose_tier(features, "AUTO", device).general, "specialised kernels are there"
    rare = replace(features, lights=(), mesh_lights=False, smooth_normals=False, roulette=False)
    assert not is_compiled(StageKernels.choose(rare, device).shading[ShadingStage.SURFACE], device)
    choice = choose_tier(rare, "AUTO", device)
    assert choice.general and choice.shading == general_features(device)
    assert not choose_tier(rare, "SPECIALISED", device).general


def test_what_general_kernels_cannot_do_is_said():
    features, device = derive_features(scenes.mixed(), SETTINGS), wp.get_device("cpu")

    def why_not(features):
        return why_not_general(features, device)

    assert why_not(features) == ""
    assert why_not(replace(features, mis=False)).endswith("no code for Use MIS at Off"), "as the panel says it"
    assert "Sequence at Independent" in why_not(replace(features, sample_sequence="INDEPENDENT"))
    assert "closures" in why_not(replace(features, closure_count=GENERAL_CLOSURES_MOST + 1)), "without programs"
    filtered = replace(features, programs=ProgramFeatures(("emission", "image_level")))
    assert "Texture Filter at Footprint" in why_not(filtered)
    unknown = replace(features, lamp_program=ProgramFeatures(("volume_mie",)))
    assert "no code for volume mie" in why_not(unknown)
    large = ProgramFeatures(("emission",), 16, 2 * GENERAL_CLOSURES_MOST)
    assert "closures" in why_not(replace(features, world_program=large))
    session = Session(DEVICE)
    small = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], world=0.5)
    film = session.render(small, SETTINGS.replace(kernel_tier="GENERAL", mis="OFF", sample_count=1))
    why = why_not(replace(features, mis=False))
    assert any(f"not general: {why}" in warning for warning in film.statistics["warnings"])


def test_the_environment_chooses_where_the_setting_does_not(monkeypatch):
    device, features = wp.get_device("cpu"), derive_features(scenes.mixed(), SETTINGS)
    monkeypatch.setenv(VARIABLE, "GENERAL")
    choice = choose_tier(features, "AUTO", device)
    assert choice.general and choice.asked == "GENERAL" and not choice.complaint
    assert not choose_tier(features, "SPECIALISED", device).general
    monkeypatch.setenv(VARIABLE, "general")
    with pytest.raises(SettingsError, match="RAYBATCH_KERNEL_TIER is 'general'; set it to one of AUTO, GENERAL"):
        choose_tier(features, "AUTO", device)


def test_each_general_kernel_has_a_module():
    """Several in one module would each have a copy of the interpreter on CUDA, and a hash that depends on which of them
    were made.
    """
    kernels = general_kernels(wp.get_device(DEVICE))
    assert [list(kernel.module.kernels.values()) for kernel in kernels] == [[kernel] for kernel in kernels]
    assert all(is_general(kernel.module) for kernel in kernels)


def test_names_of_kernels_do_not_depend_on_what_was_compiled_before():
    """Where Warp defers static expressions to the generation of code, a kernel has another name afterwards."""
    general_kernels(wp.get_device(DEVICE))
    deferred = {
        f"{adjoint.filename}:{adjoint.fun_lineno}"
        for adjoint in gc.get_objects()
        if isinstance(adjoint, Adjoint) and adjoint.has_unresolved_static_expressions and "raybatch" in adjoint.filename
    }
    assert not deferred
