"""Bad scenes, settings and devices: what the core refuses, what it leaves out, and its messages."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.errors import DeviceError, OutOfMemoryError, RayBatchError, SceneError, SettingsError
from raybatch_addon.core.scene.description import CameraKind, Closure, ClosureKind, Frame, Light, LightKind, Mesh
from raybatch_addon.core.scene.validate import COORDINATE_MAX, checked_scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import workers
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(sample_count=2, bounce_max=2)
BAD_NUMBERS = [math.nan, math.inf, -math.inf]
WORLD = (0.25, 0.5, 0.75)


def lamp_and(*objects, **more):
    """A glowing square in the middle of a coloured world, and `objects`."""
    facing = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]], np.float32)
    return scenes.scene(
        [(scenes.plane("lamp", 1.0), facing, scenes.emitter(1.0)), *objects], frame=Frame(16, 16), world=WORLD, **more
    )


def assert_lamp(film):
    """Assert that the square and the world look as if nothing else was there."""
    picture = film.passes["Combined"]
    assert np.isfinite(picture).all() and film.statistics["invalid_samples"] == 0
    assert picture[8, 8].tolist() == [1, 1, 1, 1]
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert picture[corner][:3] == pytest.approx(WORLD, rel=1e-6)


def with_positions(mesh, positions):
    return dataclasses.replace(mesh, positions=np.asarray(positions, np.float32))


# --- cameras and frames


def spoiled_cameras():
    good = scenes.camera()
    yield "transform", np.where(np.arange(12).reshape(3, 4) == 5, np.nan, good.transform), "not finite"
    yield "transform", np.where(np.arange(12).reshape(3, 4) == 3, np.inf, good.transform), "not finite"
    yield "transform", np.zeros((3, 4), np.float32), "singular"
    yield "transform", good.transform * np.array([1, 0, 1, 1], np.float32), "singular"
    yield "transform", good.transform + 1e19 * np.eye(3, 4, 3, dtype=np.float32), "1e+18 m"
    yield "window", (0.5, 0.5, -1, 1), "no area"
    yield "window", (-1, 1, 2, 2), "no area"
    yield "window", (-1, math.nan, -1, 1), "not finite"
    yield "clip_start", math.inf, "not finite"
    yield "clip_end", math.nan, "not finite"
    yield "lens_radius", math.nan, "not finite"
    yield "focus_distance", -math.inf, "not finite"


@pytest.mark.parametrize(("name", "value", "reason"), list(spoiled_cameras()))
@pytest.mark.parametrize("kind", CameraKind)
def test_a_camera_that_cannot_be_used(session, kind, name, value, reason):
    scene = lamp_and(view=dataclasses.replace(scenes.camera(), kind=kind, **{name: value}))
    with pytest.raises(SceneError, match="camera") as caught:
        session.render(scene, SETTINGS)
    message = str(caught.value)
    assert reason in message
    assert any(remedy in message for remedy in ("reset", "set its scale", "check its")), "it says what to do"


@pytest.mark.parametrize("border", [(0, 0, 0, 16), (4, 4, 4, 4), (-1, 0, 8, 8), (0, 0, 17, 16), (9, 0, 3, 16)])
def test_a_border_that_is_not_inside_the_frame(session, border):
    scene = dataclasses.replace(lamp_and(), frame=Frame(16, 16, border=border))
    with pytest.raises(SceneError, match="region.*16 x 16"):
        session.render(scene, SETTINGS)


# --- meshes


def broken_meshes():
    triangle = Mesh("broken", np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32), np.array([[0, 1, 2]], np.int32))
    for value in BAD_NUMBERS:
        yield with_positions(triangle, [[0, 0, 0], [1, value, 0], [0, 0, 1]]), "not finite"
    yield with_positions(triangle, [[0, 0, 0], [COORDINATE_MAX * 2, 0, 0], [0, 0, 1]]), "beyond 1e+18 m"
    yield dataclasses.replace(triangle, triangles=np.array([[0, 1, 3]], np.int32)), "do not exist"
    yield dataclasses.replace(triangle, triangles=np.array([[0, -1, 2]], np.int32)), "do not exist"


@pytest.mark.parametrize(("mesh", "reason"), list(broken_meshes()))
def test_a_mesh_that_cannot_be_rendered_is_named_and_left_out(session, mesh, reason):
    film = session.render(lamp_and((mesh, scenes.translation(0, -1, 0), scenes.diffuse())), SETTINGS)
    (warning,) = film.statistics["warnings"]
    assert "“broken”" in warning and reason in warning and "not rendered" in warning
    assert film.complete
    assert_lamp(film)


def test_a_broken_mesh_of_many_instances_is_named_once(session):
    mesh = with_positions(scenes.plane("broken"), np.full((4, 3), np.nan))
    places = [(mesh, scenes.translation(i, 0, 0), scenes.diffuse()) for i in range(5)]
    film = session.render(lamp_and(*places), SETTINGS)
    assert len(film.statistics["warnings"]) == 1
    assert_lamp(film)


def test_meshes_without_triangles_say_nothing(session):
    nothing = Mesh("nothing", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    points = Mesh("points", np.full((7, 3), np.nan, np.float32), np.zeros((0, 3), np.int32))
    film = session.render(
        lamp_and(*((m, scenes.IDENTITY, scenes.diffuse()) for m in (nothing, points, nothing))), SETTINGS
    )
    assert film.statistics["warnings"] == []
    assert_lamp(film)


@pytest.mark.parametrize("smooth", [False, True])
def test_triangles_without_area_are_never_hit(session, smooth):
    """Points and lines in front of the camera and across the picture; they emit, so that light is aimed at them too."""
    positions = np.array([[0, -1, 0], [0, -1, 0.5], [0, -1, -0.5], [0.1, -1, 0]], np.float32)
    triangles = np.array([[0, 0, 0], [0, 1, 2], [1, 1, 2], [3, 0, 3]], np.int32)
    normals = np.tile(np.array([0, -1, 0], np.float32), (4, 3, 1)) if smooth else None
    mesh = Mesh("lines", positions, triangles, corner_normals=normals)
    floor = (scenes.plane("floor", 0.5), scenes.translation(0, 0, -0.9), scenes.diffuse())
    film = session.render(lamp_and((mesh, scenes.IDENTITY, scenes.emitter(50.0)), floor), SETTINGS)
    assert film.statistics["warnings"] == []
    picture = film.passes["Combined"]
    assert film.statistics["invalid_samples"] == 0 and np.isfinite(picture).all()
    assert picture[8, 8].tolist() == [1, 1, 1, 1] and picture.max() <= 1


def test_loose_vertices_cost_nothing(session):
    """A million loose vertices next to one square."""
    square = scenes.plane("lamp", 1.0)
    loose = np.random.default_rng(5).uniform(-3, 3, (1_000_000, 3)).astype(np.float32)
    scene = lamp_and()
    crowded = dataclasses.replace(scene, meshes=(with_positions(square, np.concatenate([square.positions, loose])),))
    film = session.render(crowded, SETTINGS)
    assert np.array_equal(film.passes["Combined"], session.render(scene, SETTINGS).passes["Combined"])
    assert film.statistics["warnings"] == [] and film.statistics["triangles"] == 2


# --- instances


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(
    ("matrix", "reason"),
    [
        (np.full((3, 4), np.nan), "not finite"),
        (np.diag([1, np.inf, 1])[:, [0, 1, 2, 2]], "not finite"),
        (scenes.translation(1e30, 0, 0), "beyond 1e+18 m"),
        (np.zeros((3, 4)), "flat or zero"),
        (scenes.translation(0, -1, 0, 0.0), "flat or zero"),
        (np.diag([1.0, 1.0, 0.0])[:, [0, 1, 2, 2]], "flat or zero"),
        (np.array([[1, 1, 0, 0], [1, 1, 0, -1], [0, 0, 1, 0]]), "flat or zero"),
    ],
)
def test_an_object_that_is_nowhere_or_flat_is_named_and_left_out(session, matrix, reason, shared):
    mesh = scenes.plane("mesh", 1.0)
    objects = [(mesh, matrix, scenes.emitter(9.0))]
    if shared:  # another instance of the same mesh is far away behind the camera
        objects.append((mesh, scenes.translation(0, -50, 0), scenes.emitter(9.0)))
    film = session.render(lamp_and(*objects), SETTINGS)
    (warning,) = film.statistics["warnings"]
    assert "“object 1”" in warning and reason in warning and "not rendered" in warning
    assert film.statistics["instances"] == len(objects)
    assert_lamp(film)


def test_small_and_mirrored_objects_are_not_flat():
    mirrored = scenes.translation(0, 0, 0)
    mirrored[0, 0] = -1
    tiny = scenes.translation(0, 0, 0, 1e-12)
    thin = np.diag([1.0, 1.0, 1e-5])[:, [0, 1, 2, 2]]
    scene = scenes.scene([(scenes.plane(), matrix, scenes.diffuse()) for matrix in (mirrored, tiny, thin)])
    assert checked_scene(scene) is scene


def test_what_the_exporter_warned_of_comes_first(session):
    flat = (scenes.plane("flat"), np.zeros((3, 4)), scenes.diffuse())
    film = session.render(dataclasses.replace(lamp_and(flat), warnings=("a node was left out",)), SETTINGS)
    warnings = film.statistics["warnings"]
    assert warnings[0] == "a node was left out" and "“object 1”" in warnings[1] and len(warnings) == 2
    assert_lamp(film)


@pytest.mark.parametrize(
    ("name", "values"), [("mesh", [0, 2]), ("mesh", [0, -1]), ("slot_first", [0, 9]), ("slot_first", [-1, 0])]
)
def test_an_instance_of_what_does_not_exist(session, name, values):
    """Kernels trust indices."""
    scene = lamp_and((scenes.plane("other"), scenes.IDENTITY, scenes.diffuse()))
    instances = dataclasses.replace(scene.instances, **{name: np.array(values, np.int32)})
    with pytest.raises(SceneError, match="does not exist; export the scene again"):
        session.render(dataclasses.replace(scene, instances=instances), SETTINGS)


def test_a_slot_without_material(session):
    with pytest.raises(SceneError, match="material that does not exist"):
        session.render(dataclasses.replace(lamp_and(), slot_materials=np.array([3], np.int32)), SETTINGS)


# --- lights and worlds


@pytest.mark.parametrize("value", [*BAD_NUMBERS, -1.0])
def test_a_light_of_impossible_power_is_named_and_left_out(session, value):
    floor = (scenes.plane("floor", 0.5), scenes.translation(0, 0, -0.9), scenes.diffuse())
    bulb = Light("Bulb", LightKind.POINT, scenes.translation(0, -2, 0), (1.0, value, 1.0))
    film = session.render(lamp_and(floor, lights=[bulb]), SETTINGS)
    (warning,) = film.statistics["warnings"]
    assert "“Bulb”" in warning and "not rendered" in warning
    assert_lamp(film)


def test_a_light_that_is_nowhere_is_named_and_left_out(session):
    bulb = Light("Bulb", LightKind.SUN, np.full((3, 4), np.nan, np.float32), (1.0,) * 3)
    film = session.render(lamp_and(lights=[bulb]), SETTINGS)
    assert "“Bulb”" in film.statistics["warnings"][0]
    assert_lamp(film)


@pytest.mark.parametrize("value", [*BAD_NUMBERS, -1.0])
def test_a_world_of_impossible_light_is_black(session, value):
    film = session.render(dataclasses.replace(lamp_and(), world=scenes.scene(world=(1.0, value, 1.0)).world), SETTINGS)
    (warning,) = film.statistics["warnings"]
    assert "world" in warning and "black" in warning
    picture = film.passes["Combined"]
    assert picture[0, 0].tolist() == [0, 0, 0, 1] and picture[8, 8].tolist() == [1, 1, 1, 1]


# --- empty scenes


def test_an_empty_scene_is_the_world(session):
    empty = scenes.scene(frame=Frame(8, 8), world=WORLD)
    film = session.render(empty, SETTINGS)
    assert film.passes["Combined"] == pytest.approx(np.tile(np.array([*WORLD, 1], np.float32), (8, 8, 1)), rel=1e-6)
    assert film.statistics["warnings"] == [] and film.statistics["rays"]["shadow"] == 0
    black = session.render(dataclasses.replace(empty, world=scenes.scene().world), SETTINGS)
    assert not black.passes["Combined"][..., :3].any() and (black.passes["Combined"][..., 3] == 1).all()


def test_lights_alone_in_an_empty_scene(session):
    lights = [
        scenes.sun(),
        scenes.area_light(),
        Light("point", LightKind.POINT, scenes.translation(50, 0, 0), (1.0,) * 3),
    ]
    film = session.render(scenes.scene(frame=Frame(8, 8), lights=lights, world=WORLD), SETTINGS)
    assert film.passes["Combined"][0, 0, :3] == pytest.approx(WORLD, rel=1e-6)


def test_instances_of_nothing(session):
    nothing = Mesh("nothing", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    film = session.render(
        scenes.scene([(nothing, scenes.IDENTITY, scenes.diffuse())] * 2, frame=Frame(8, 8), world=WORLD), SETTINGS
    )
    assert film.passes["Combined"][4, 4, :3] == pytest.approx(WORLD, rel=1e-6)
    assert "surfaces" in film.statistics["left_out"]


# --- materials


@pytest.mark.parametrize("value", [*BAD_NUMBERS, -1.0])
def test_a_material_with_an_impossible_value_is_named(session, value):
    bad = scenes.material(Closure(ClosureKind.DIFFUSE, (0.5, value, 0.5)), name="Chalk")
    with pytest.raises(SceneError, match="Chalk.*look for") as caught:
        session.render(lamp_and((scenes.plane(), scenes.IDENTITY, bad)), SETTINGS)
    assert "diffuse" in str(caught.value)


# --- settings, samples and devices


def test_a_setting_out_of_its_range_is_named_with_the_range():
    with pytest.raises(SettingsError, match=r"sample_count = 0 .*must be 1 to"):
        RenderSettings(sample_count=0)
    with pytest.raises(SettingsError, match=r"nee = 'maybe' .*one of ON, OFF, HALF"):
        SETTINGS.replace(nee="maybe")
    with pytest.raises(SettingsError, match="'sample_cuont'.*sample_count"):
        SETTINGS.replace(sample_cuont=3)


@pytest.mark.parametrize("first", [-1, 2**32])
def test_samples_beyond_the_last_number(session, first):
    with pytest.raises(RayBatchError, match="out of range.*use 0 to"):
        session.render(lamp_and(), SETTINGS, sample_first=first)


@pytest.mark.parametrize("name", ["cuda:99", "gpu", "cpu:1", "", "cuda:"])
def test_an_unknown_device_is_refused_at_once_with_those_there_are(name):
    with pytest.raises(DeviceError) as caught:
        Session(device=name or " ")
    assert repr(name or " ") in str(caught.value) and "choose one of AUTO, cpu" in str(caught.value)
    assert ", ALL" in str(caught.value)
    assert name.startswith("cuda") or "NVIDIA" not in str(caught.value)  # where it was not asked for


def test_all_devices_and_others_are_refused():
    with pytest.raises(DeviceError, match="'cpu,ALL' names ALL and others; give ALL alone"):
        Session(device="cpu,ALL")


def test_cuda_where_there_is_none(monkeypatch):
    monkeypatch.setattr("warp.get_cuda_devices", list)
    for name in ("cuda", "cuda:0", "CUDA:1"):
        with pytest.raises(DeviceError, match=f"{name}.*no CUDA device was found.*driver"):
            find_device(name)
    assert find_device("AUTO").alias == find_device("CPU").alias == "cpu"


# --- memory


def test_fewer_rays_where_memory_is_short(session, monkeypatch):
    scene, settings = scenes.mixed(), SETTINGS.replace(sample_count=64, tile_size=32, ray_count=1 << 14, thread_count=1)
    ample = session.render(scene, settings)
    monkeypatch.setattr(workers, "free_memory", lambda device: 3 << 20)
    short = Session(session.device.alias).render(scene, settings)  # it has no rays of an earlier render
    (warning,) = short.statistics["warnings"]
    assert "ray_count was reduced from 16,384 to" in warning and session.device.alias in warning and "memory" in warning
    assert short.complete and ample.statistics["warnings"] == []
    assert np.array_equal(short.passes["Combined"], ample.passes["Combined"])


def test_fewer_rays_where_an_allocation_fails(session, monkeypatch):
    """Free memory was overestimated: a smaller size is tried after a failed allocation."""
    asked = []
    make = integrator.TileIntegrator.__init__

    def allocate(self, scene, frame, settings, marks, *more):
        asked.append(marks.path_count)
        if marks.path_count > 1000:
            raise RuntimeError("Failed to allocate memory on device")
        make(self, scene, frame, settings, marks, *more)

    monkeypatch.setattr(integrator.TileIntegrator, "__init__", allocate)
    film = session.render(lamp_and(), SETTINGS.replace(sample_count=64, tile_size=16, ray_count=8192, thread_count=1))
    assert asked == [8192, 4096, 2048, 1024, 512]
    (warning,) = film.statistics["warnings"]
    assert "reduced from 8,192 to 512" in warning
    assert_lamp(film)


def test_no_memory_for_a_single_path(session, monkeypatch):
    monkeypatch.setattr(workers, "free_memory", lambda device: 64)
    with pytest.raises(OutOfMemoryError, match="bytes left for rays.*close other programs"):
        session.render(lamp_and(), SETTINGS)


def test_other_failures_of_an_allocation_are_not_hidden(session, monkeypatch):
    def broken(*_args):
        raise RuntimeError("the moon is missing")

    monkeypatch.setattr(integrator.TileIntegrator, "__init__", broken)
    with pytest.raises(RuntimeError, match="moon"):
        session.render(lamp_and(), SETTINGS)


# --- callbacks


@pytest.mark.parametrize("where", ["on_tile", "on_progress", "cancelled"])
def test_an_exception_of_a_callback_reaches_the_caller_and_the_session_goes_on(session, where):
    def broken(*_args):
        raise ZeroDivisionError("not ours")

    with pytest.raises(ZeroDivisionError, match="not ours"):
        session.render(lamp_and(), SETTINGS.replace(sample_count=64), **{where: broken})
    assert_lamp(session.render(lamp_and(), SETTINGS))


def test_an_exception_of_a_worker_reaches_the_caller(session, monkeypatch):
    def broken(*_args):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(integrator.TileIntegrator, "_shade", broken)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        session.render(lamp_and(), SETTINGS)
    monkeypatch.undo()
    assert_lamp(session.render(lamp_and(), SETTINGS))
