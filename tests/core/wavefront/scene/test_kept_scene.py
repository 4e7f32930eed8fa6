"""A scene on its device and its workers serve the next render, while all that they follow from is the same."""

import gc
import threading
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core import session as session_module
from raybatch_addon.core.ahead import prepare
from raybatch_addon.core.scene.description import (
    Attribute,
    Closure,
    ClosureKind,
    Frame,
    Grid,
    Image,
    InstanceMaps,
    Instances,
    Light,
    LightKind,
    Material,
    Mesh,
    Scene,
    Volume,
    World,
)
from raybatch_addon.core.scene.frozen import Same, freeze
from raybatch_addon.core.scene.notice import Notice
from raybatch_addon.core.scene.program import Instruction, Program
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.render import workers
from raybatch_addon.core.wavefront.scene import kept_scene, scene_cache
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.core.wavefront.scene.keeping import counted_calls, frozen_meshes
from tests.support import scenes
from tests.support.under_test import DEVICE

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=2)


def scene_of(place=0.0):
    """A box on another one, below a lamp, whose meshes nobody can change."""
    made = scenes.scene(
        [
            (scenes.box(), scenes.translation(place, 0, 0), scenes.diffuse()),
            (scenes.box(), scenes.translation(0, 3, -2), scenes.diffuse()),
        ],
        view=scenes.camera(eye=(0, -4, 1)),
        frame=Frame(8, 8),
        lights=[Light("lamp", LightKind.POINT, scenes.translation(0, -4, 3), (9.0, 9.0, 9.0), radius=1.0)],
    )
    return frozen_meshes(made)


@pytest.fixture
def made(monkeypatch):
    """What was made, by name, in order."""
    calls, count = counted_calls(monkeypatch)
    count(DeviceScene, "build")
    count(workers, "make_workers")
    return calls


def test_features_are_those_of_a_scene_and_settings(general_kernels, monkeypatch):
    derived, count = counted_calls(monkeypatch)
    count(session_module, "derive_features")
    session, scene = Session(DEVICE), scene_of()
    for changes in ({}, {"seed": 3}, {"nee": "OFF"}, {"nee": "OFF", "seed": 4}):
        render(session, scene, **changes)
    assert len(derived) == 2
    assert_as_new(render(session, replace(scene, lights=())), replace(scene, lights=()))


def render(session, scene, **changes):
    return session.render(scene, SETTINGS.replace(**changes))


def assert_as_new(film, scene, **changes):
    new = render(Session(DEVICE), scene, **changes)
    assert film.passes["Combined"].tobytes() == new.passes["Combined"].tobytes()
    for name in ("rays", "samples", "warnings", "schedule", "invalid_samples", "samples_per_pixel"):
        assert film.statistics[name] == new.statistics[name], name


def test_nothing_is_made_again_for_other_random_numbers(general_kernels, made):
    session, scene = Session(DEVICE), scene_of()
    first = render(session, scene)
    films, sorting = [first.passes["Combined"]], first.statistics["ray_sort"]
    assert made == ["build", "make_workers"]
    for seed in (1, 2):
        film = render(session, scene, seed=seed)  # counts and random numbers begin anew
        assert film.statistics["ray_sort"] == sorting
        films.append(film.passes["Combined"])
        assert len(made) == 2 if session.device.is_cpu else made.count("build") == 1
        made.clear()
        assert_as_new(film, scene, seed=seed)
        made[:] = ["build", "make_workers"]
    assert len({film.tobytes() for film in films}) == 3
    assert film.statistics["tree"]["built"] == film.statistics["tree"]["refitted"] == 0


@pytest.mark.parametrize(
    "changes", [{"bounce_max": 1}, {"clamp_direct": 0.25}, {"pixel_filter": "BOX"}, {"nee": "OFF"}, {"tile_size": 4}]
)
def test_other_settings_make_it_anew(general_kernels, made, changes):
    session, scene = Session(DEVICE), scene_of()
    render(session, scene)
    made.clear()
    film = render(session, scene, **changes)
    assert made == ["build", "make_workers"]
    assert_as_new(film, scene, **changes)


def test_another_number_of_samples_makes_workers_anew(general_kernels, made):
    session, scene = Session(DEVICE), scene_of()
    render(session, scene)
    made.clear()
    film = render(session, scene, sample_count=5)
    assert made == ["make_workers"]
    assert_as_new(film, scene, sample_count=5)


def test_arrays_that_were_written_to_are_noticed(general_kernels, made):
    session, scene = Session(DEVICE), scene_of()
    render(session, scene)
    made.clear()
    scene.instances.transform[0, 0, 3] += 1.0
    film = render(session, scene)
    assert made == ["build", "make_workers"]
    assert_as_new(film, scene)


def test_a_scene_that_was_kept_is_made_anew_behind_another(general_kernels, made):
    session, first, second = Session(DEVICE), scene_of(), scene_of(place=1.0)
    render(session, first)
    assert_as_new(render(session, second), second)
    assert_as_new(render(session, first), first)


def test_a_cancelled_render_leaves_no_workers(general_kernels, made):
    session, scene = Session(DEVICE), scene_of()
    render(session, scene)
    asked = []

    def cancelled():
        asked.append(True)
        return len(asked) > 1  # when it has begun

    session.render(scene, SETTINGS, cancelled=cancelled)
    made.clear()
    film = render(session, scene)
    assert made == ["make_workers"]
    assert_as_new(film, scene)


def test_a_list_that_was_edited_is_noticed(general_kernels, made):
    whole = scene_of()
    scene = replace(whole, lights=list(whole.lights), meshes=list(whole.meshes))
    session = Session(DEVICE)
    render(session, scene)
    made.clear()
    render(session, replace(scene, lights=list(scene.lights)), seed=1)
    assert "build" not in made, "another list of the same"
    scene.lights[0] = replace(scene.lights[0], emission=(1.0, 2.0, 3.0))
    film = render(session, scene)
    assert "build" in made
    assert_as_new(film, scene)


def test_an_array_in_place_of_a_tuple_that_was_written_to_is_noticed(general_kernels, made):
    whole, color = scene_of(), np.array([9.0, 9.0, 9.0])
    scene = replace(whole, lights=(replace(whole.lights[0], emission=color),))
    session = Session(DEVICE)
    render(session, scene)
    made.clear()
    render(session, replace(whole, lights=(replace(whole.lights[0], emission=color.copy()),)), seed=1)
    assert "build" not in made, "another array of the same numbers"
    color[0] = 1.0
    film = render(session, scene)
    assert "build" in made
    assert_as_new(film, scene)


@pytest.mark.parametrize("thing", [{}, set(), bytearray(b"a"), np.array([[]], dtype=object), np.zeros(1, "i4,f4")[0]])
def test_a_scene_with_something_that_may_change_unseen_is_not_kept(thing):
    assert kept_scene.scene_key(replace(full_scene(), object_names=("a", thing))) is None


@pytest.mark.parametrize(
    "thing", [np.float32(1), np.bool_(True), LightKind.POINT, None, "a", 1.5, [1, (2, [3])], Notice("replaced")]
)
def test_values_that_nobody_can_change_are_compared(thing):
    scene = replace(full_scene(), object_names=("a", thing))
    assert Same(*kept_scene.scene_key(scene)).holds(*kept_scene.scene_key(replace(scene)))


def test_kernels_that_are_gone_are_loaded_and_nothing_is_built(general_kernels, made, monkeypatch):
    session, scene = Session(DEVICE), scene_of()
    first = render(session, scene)
    made.clear()
    asked, loaded = [], []
    monkeypatch.setattr(prepare, "loaded_modules", lambda *of: asked.append(of))
    real = prepare.load_kernels
    monkeypatch.setattr(prepare, "load_kernels", lambda *of: (loaded.append(threading.current_thread()), real(*of))[1])
    film = render(session, scene)
    assert asked and loaded and loaded[0] is not threading.main_thread() and "build" not in made
    assert film.passes["Combined"].tobytes() == first.passes["Combined"].tobytes()
    assert film.statistics["modules"] == first.statistics["modules"]
    if session.device.is_cpu:
        assert made == [], "the workers are kept too"


# --- memory on the device


def arrays_there():
    """Bytes of all of Warp's arrays that own their memory, by address."""
    gc.collect()
    return {each.ptr: each.capacity for each in gc.get_objects() if isinstance(each, wp.array) and each.deleter}


@pytest.mark.parametrize("kind", ["lamp", "glow", "fog", "picture"])
def test_memory_that_only_the_kept_scene_holds_is_counted(general_kernels, kind):
    """It is what is free again without it."""
    session, scene = Session(DEVICE), scene_of()
    if kind == "glow":
        scene = replace(scene, materials=(scenes.emitter(3.0),) * len(scene.materials))
    elif kind == "fog":
        fog = Volume((Closure(ClosureKind.VOLUME_ABSORPTION, (0.5, 0.5, 0.5)),))
        scene = replace(scene, world=replace(scene.world, volume=fog))
    elif kind == "picture":
        picture = freeze(np.ones((4, 4, 4), np.float32))
        scene = replace(scene, images=(Image("picture", picture),))
    render(session, scene)
    session._at[0].kept._workers = None
    counted, before = session._at[0].kept.device_bytes, arrays_there()
    session._at[0].kept.clear()
    after = arrays_there()
    freed = sum(size for address, size in before.items() if address not in after)
    assert counted == freed > 100
    assert session._at[0].kept.device_bytes == 0


def test_what_images_may_have_does_not_depend_on_what_is_kept(monkeypatch):
    """A device that has as much memory as is not kept."""
    kept, all_of_it = [1 << 20], 1 << 24
    monkeypatch.setattr(scene_cache, "free_memory", lambda device: all_of_it - kept[0])
    cache, device = SceneCache(lambda: kept[0]), SimpleNamespace(is_cuda=True)
    budget, geometry = cache.image_budget(device), cache.free_for_geometry((), device)
    kept[0] = 0
    assert cache.image_budget(device) == budget == all_of_it * scene_cache.IMAGE_SHARE
    assert cache.free_for_geometry((), device) == geometry == all_of_it


def test_a_closed_session_keeps_nothing(general_kernels, made):
    session, scene = Session(DEVICE), scene_of()
    render(session, scene)
    session.close()
    made.clear()
    render(session, scene)
    assert made == ["build", "make_workers"]


# --- what a scene is known by


def full_scene(is_frozen=False):
    """A scene with something in every field."""
    array = np.arange(12, dtype=np.float32).reshape(1, 3, 4)
    whole = np.arange(3, dtype=np.int32)
    if is_frozen:
        array, whole = freeze(array), freeze(whole)
    program = Program((Instruction("splat", (1, 2)),), np.ones(3, np.float32), 2, 1, ("splat",))
    program = replace(program, requests=program)
    closure = Closure(ClosureKind.DIFFUSE, (1.0, 1.0, 1.0), color=(0.5, 0.5, 0.5))
    volume = Volume((closure,), program)
    light = Light("lamp", LightKind.POINT, array[0], (1.0, 1.0, 1.0), program=program, object_transform=array[0])
    light = replace(light, info=(1.0,) * 6, attributes=array[0])
    grid = Grid("density", array, array[0], whole[None])
    mesh = Mesh("mesh", array[0], whole[None], whole, texture_space=((0.0,) * 3, (1.0,) * 3), grids=(grid,))
    names = [each.name for each in fields(Mesh) if getattr(mesh, each.name) is None]
    mesh = replace(mesh, **dict.fromkeys(names, array), attributes=(Attribute("UV", "map", array),))
    maps = InstanceMaps(whole, array)
    instances = Instances(whole, array, whole, whole, whole, info=array, attributes=array, motion=maps, frames=maps)
    instances = replace(instances, links=whole.astype(np.uint64), light_group=whole)
    material = Material("material", (closure,), (ClosureKind.DIFFUSE,), program, displacement=program, volume=volume)
    camera = replace(scenes.camera(), motion=array, window_motion=array[0])
    images = (Image("picture", array), Image("tiles", tiles=((1001, array),)))
    return Scene(
        camera,
        Frame(8, 8),
        (mesh,),
        instances,
        slot_materials=whole,
        materials=(material,),
        images=images,
        attributes=(("UV", "map"),),
        lights=(light,),
        world=World((1.0, 1.0, 1.0), program=program, volume=volume, portals=(light,)),
        object_names=("a",),
        light_groups=("group",),
        asset_names=("a",),
        warnings=("warning",),
    )


def others(value, is_frozen):
    """Things like `value` with one difference each, of every part of it, and where it is."""
    if isinstance(value, np.ndarray):
        other = value.copy()
        other.reshape(-1)[-1] += 1
        yield "", freeze(other) if is_frozen else other
    elif is_dataclass(value):
        for each in fields(value):
            if each.init:
                for where, other in others(getattr(value, each.name), is_frozen):
                    yield f".{each.name}{where}", replace_unchecked(value, each.name, other)
    elif isinstance(value, tuple):
        for i, part in enumerate(value):
            for where, other in others(part, is_frozen):
                yield f"[{i}]{where}", (*value[:i], other, *value[i + 1 :])
        yield "[:-1]", value[:-1] if value else ("one",)
    elif isinstance(value, bool):
        yield "", not value
    elif isinstance(value, Enum):
        yield "", next(each for each in type(value) if each is not value)
    elif isinstance(value, int):
        yield "", value + 1
    elif isinstance(value, float):
        yield "", 1.5 if value != 1.5 else 2.5
    elif isinstance(value, str):
        yield "", value + "'"
    else:
        yield "", "something"


def replace_unchecked(value, name, other):
    made = object.__new__(type(value))
    for each in fields(value):
        object.__setattr__(made, each.name, other if each.name == name else getattr(value, each.name))
    return made


@pytest.mark.parametrize("is_frozen", [True, False])
def test_any_difference_between_scenes_is_seen(is_frozen):
    scene = full_scene(is_frozen)
    same = Same(*kept_scene.scene_key(scene))
    assert same.holds(*kept_scene.scene_key(replace(scene)))
    found = list(others(scene, is_frozen))
    assert len(found) > 200
    for where, other in found:
        assert not same.holds(*kept_scene.scene_key(other)), where


def test_large_arrays_that_may_change_are_not_looked_at(monkeypatch):
    scene = full_scene()
    monkeypatch.setattr(kept_scene, "_LOOSE_MOST", 64)
    assert kept_scene.scene_key(scene) is None
