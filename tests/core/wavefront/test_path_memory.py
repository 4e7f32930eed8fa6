"""The memory of a path is known exactly: the arrays of an integrator grow with its paths by just that."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.film import sums
from raybatch_addon.core.film import tile as film_tile
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.inputs.ray_inputs import ROUNDED, SAMPLES_SHIFT
from raybatch_addon.core.programs.requests import requesting_scene
from raybatch_addon.core.scene.description import ClosureKind, Frame, Material
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator, TileState
from raybatch_addon.core.wavefront.order import ray_order
from raybatch_addon.core.wavefront.order.hit_order import hit_order_bytes
from raybatch_addon.core.wavefront.order.ray_order import order_bytes
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from raybatch_addon.core.wavefront.rays import Paths, bytes_per_path, needed_arrays
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from raybatch_addon.core.wavefront.scene.geometry_request import GeometryRequest
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from raybatch_addon.core.wavefront.scheduler import Rectangle, water_marks
from raybatch_addon.core.wavefront.stages import generate
from tests.support import scenes
from tests.support.feature_scenes import EACH_WIDE_FEATURE, FEATURES, SETTINGS, lit
from tests.support.under_test import DEVICE

LEAST = 4096
GENERAL = pytest.mark.usefixtures("general_kernels")


# What cases are named for, that they may not lose: words of which the names of just those have one
HAS = {
    ("subsurface",): lambda features: features.subsurface,
    ("lamp program",): lambda features: bool(features.lamp_program),
    ("history",): lambda features: features.path_history,
    ("with a program", "for programs"): lambda features: bool(features.programs),
}


def integrator_of(scene, settings, path_count) -> tuple[TileIntegrator, DeviceScene]:
    device = find_device(DEVICE)
    scene = checked_scene(scene)
    features = derive_features(scene, settings)
    plan = TracingPlan(Method.REFERENCE if settings.batching == "REFERENCE" else Method.UNBATCHED)
    request = GeometryRequest(
        settings=settings,
        plan=plan,
        layout=layout_for(device),
        instancing=features.instancing,
        page_folder=Path("unused"),
    )
    built = DeviceScene.build(scene, features, request, device, SceneCache())
    return TileIntegrator(built, scene.frame, settings, water_marks(settings, path_count)), built


def arrays_in(value, seen: set[int]) -> list[wp.array]:
    """All Warp arrays that can be reached from `value`."""
    if id(value) in seen or isinstance(value, (DeviceScene, type, wp.Kernel, wp.Device)):
        return []
    seen.add(id(value))
    if isinstance(value, wp.array):
        return [value]
    if isinstance(value, dict):
        parts = list(value.values())
    elif isinstance(value, (list, tuple)):
        parts = list(value)
    else:
        parts = list(getattr(value, "__dict__", {}).values())
        cls = getattr(value, "_cls", None)
        if cls is not None and hasattr(cls, "vars"):  # a struct
            parts = [getattr(value, name) for name in cls.vars]
    return [array for part in parts for array in arrays_in(part, seen)]


def bytes_held(integrator: TileIntegrator, scene: DeviceScene) -> int:
    """Memory of all its arrays, what they share counted once [bytes]."""
    seen = {id(scene), id(scene.tree), id(scene.data), id(scene.camera)}
    spans = sorted(
        (a.ptr, a.ptr + a.size * wp.types.type_size_in_bytes(a.dtype))
        for a in arrays_in(integrator.__dict__, seen)
        if a.size
    )
    total, last = 0, 0
    for first, end in spans:
        total += max(0, end - max(first, last))
        last = max(last, end)
    return total


def test_the_table_of_paths_has_all_their_arrays():
    features = derive_features(checked_scene(lit()), RenderSettings())
    assert needed_arrays(features).keys() == Paths.vars.keys() - {"walk", "passes", "answers", "requests"}


CASES = FEATURES | {"shadow catchers": EACH_WIDE_FEATURE["shadow catchers"]}
# Each compiles kernels of its own
OFTEN = {next(iter(FEATURES)), "transparent"}


@pytest.mark.parametrize(
    "case", [pytest.param(each, marks=() if each in OFTEN else pytest.mark.thorough) for each in CASES]
)
def test_memory_grows_by_what_is_reported(case):
    scene, changes = CASES[case]
    settings = SETTINGS.replace(**changes)
    features = derive_features(checked_scene(scene), settings)
    for words, has in HAS.items():
        assert has(features) == any(each in case for each in words), (case, words)
    reported, grown = reported_and_grown(scene, settings)
    assert reported - 1 <= grown <= reported, (case, reported, grown)


@pytest.mark.thorough
@pytest.mark.parametrize("passes", [("Combined",), ("Combined", "Ambient Occlusion")])
def test_rays_for_programs_and_passes_take_what_is_reported(passes):
    program = ProgramBuilder()
    normal = program.value("normals")[0]
    rounded = program.value("bevel", normal, 0.1, ROUNDED | 2 << SAMPLES_SHIFT, -1, -1)
    seen = program.value("ambient_occlusion", rounded, 0.5, 2 << SAMPLES_SHIFT, -1, -1)
    program.closure("diffuse", program.value("splat", seen), normal)
    material = Material("dirt", (), (ClosureKind.DIFFUSE,), program.finish())
    scene = requesting_scene(lit(material, Frame(32, 32, passes=passes)))
    reported, grown = reported_and_grown(scene, SETTINGS)
    assert reported - 1 <= grown <= reported, (reported, grown)


def reported_and_grown(scene, settings) -> tuple[int, float]:
    """Bytes of a path, and by how many a worker grows with each."""
    features = derive_features(checked_scene(scene), settings)
    held = []
    for path_count in (LEAST, 3 * LEAST):
        integrator, built = integrator_of(scene, settings, path_count)
        integrator.render(TileState(Rectangle(0, 0, 32, 32)), 0, 1, lambda: False)
        sorting = hit_order_bytes(path_count) if built.hits_sorted_by(settings) else 0
        held.append(bytes_held(integrator, built) - sorting)
    reported = bytes_per_path(features, settings.batching == "REFERENCE")
    return reported, (held[1] - held[0]) / (2 * LEAST)


def test_a_path_of_an_opaque_scene_with_lights_is_small():
    settings = RenderSettings()
    assert bytes_per_path(derive_features(checked_scene(lit()), settings)) <= 133


def test_sorting_takes_memory_when_it_begins_and_no_more_than_is_reported(monkeypatch):
    monkeypatch.setattr(ray_order, "CPU_SORTED_MAX", 500)
    monkeypatch.setattr(ray_order, "CUDA_SORTED_MAX", 500)
    scene, is_cuda = lit(), find_device(DEVICE).is_cuda
    held = {}
    for ray_sort in ("OFF", "ON"):
        for path_count in (200, LEAST):
            integrator, built = integrator_of(scene, RenderSettings(sample_count=1, ray_sort=ray_sort), path_count)
            before = bytes_held(integrator, built)
            integrator.render(TileState(Rectangle(0, 0, 32, 32)), 0, 1, lambda: False)
            held[ray_sort, path_count] = bytes_held(integrator, built) - before
    for path_count in (200, LEAST):
        assert held["ON", path_count] - held["OFF", path_count] == pytest.approx(
            order_bytes("ON", path_count, is_cuda), abs=64
        )
    assert order_bytes("ON", LEAST, is_cuda) == order_bytes("ON", 2 * LEAST, is_cuda) > order_bytes("ON", 200, is_cuda)
    assert order_bytes("OFF", LEAST, is_cuda) == 0


def bright():
    """A scene whose samples do not fit the film's window: light of 1e20, and hardly any."""
    objects = [
        (scenes.plane("lamp", 1.0), scenes.translation(-0.7, 0, 0), scenes.emitter(1e20)),
        (scenes.plane("glow", 1.0), scenes.translation(0.7, 0, 0), scenes.emitter(1e-35)),
    ]
    view = scenes.camera(eye=(0, -0.1, 3), half_width=0.6)
    return scenes.scene(
        objects, view=view, frame=Frame(24, 24, passes=("Combined", "Normal"), transparent=True), world=0.3
    )


@GENERAL
@pytest.mark.parametrize("places", [1, 70, 1000])
def test_a_film_is_the_same_when_there_is_no_room_to_set_channels_aside(monkeypatch, places):
    films = []
    for count in (film_tile.SPILL_CAPACITY, places):
        monkeypatch.setattr(film_tile.FilmTiles.__init__, "__defaults__", (count,))
        films.append(Session(DEVICE).render(bright(), RenderSettings(sample_count=3, thread_count=1)))
    whole, short = films
    for name, values in whole.passes.items():
        assert np.array_equal(values.view(np.int32), short.passes[name].view(np.int32)), name
    assert whole.sums.wide.shape[0] == sums.WIDE_DIGITS and whole.sums.wide.any()
    assert np.array_equal(whole.sums.wide, short.sums.wide) and np.array_equal(whole.sums.window, short.sums.window)
    assert np.array_equal(whole.counts, short.counts) and (whole.counts == 3).all()
    assert whole.statistics["invalid_samples"] == short.statistics["invalid_samples"] == 0


@GENERAL
@pytest.mark.parametrize("sorted_max", [7, 300])
def test_lists_that_are_sorted_in_parts_give_the_same_film(monkeypatch, sorted_max):
    whole = Session(DEVICE).render(scenes.mixed(), RenderSettings(sample_count=2, ray_sort="ON", thread_count=1))
    monkeypatch.setattr(ray_order, "CPU_SORTED_MAX", sorted_max)
    monkeypatch.setattr(ray_order, "CUDA_SORTED_MAX", sorted_max)
    parts = Session(DEVICE).render(
        scenes.mixed(), RenderSettings(sample_count=2, ray_sort="ON", thread_count=1, ray_count=2000)
    )
    for name, values in whole.passes.items():
        assert np.array_equal(values, parts.passes[name]), name


@GENERAL
@pytest.mark.parametrize("order", ["FRAME_FIRST", "PIXEL_FIRST"])
def test_numbers_of_paths_that_begin_anew_give_the_same_film(monkeypatch, order):
    settings = RenderSettings(sample_count=3, thread_count=1, ray_count=400, sample_order=order)
    whole = Session(DEVICE).render(scenes.mixed(), settings)
    monkeypatch.setattr(generate, "ITEMS_NUMBERED", 150)
    again = Session(DEVICE).render(scenes.mixed(), settings)
    for name, values in whole.passes.items():
        assert np.array_equal(values, again.passes[name]), name
