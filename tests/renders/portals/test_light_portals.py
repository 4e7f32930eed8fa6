"""Portals of the world: densities, the same light with less noise, and the same film under any schedule."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Light, LightKind, Mesh, Volume, World
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights.portals.portals import portals_pdf, sample_through_portals
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.core.shading.lights.world import WorldLight, sampled_world
from raybatch_addon.core.wavefront.tier import why_not_general
from tests.support import scenes
from tests.support.running.shares import pairs_of

pytestmark = pytest.mark.usefixtures("general_kernels")

ROOM, HOLE = 4.0, 0.5  # edge of the room, and of the hole in its ceiling [m]
SETTINGS = RenderSettings(sample_count=64, bounce_max=2)
ON_GPU = SimpleNamespace(is_cuda=True)


def even() -> World:
    builder = ProgramBuilder()
    builder.closure("emission", (5.0, 4.0, 3.0))
    return World(program=builder.finish())


def varying() -> World:
    """A world whose radiance is the square of each coordinate of the direction."""
    builder = ProgramBuilder()
    direction = builder.value("normals")[2]
    builder.closure("emission", builder.value("multiply_colors", direction, direction))
    return World(program=builder.finish())


def portal(z=ROOM / 2, size=HOLE, kind=LightKind.RECTANGLE, x=0.0) -> Light:
    """A portal above the origin that faces down."""
    return Light("portal", kind, scenes.translation(x, 0, z), (0.0, 0.0, 0.0), size=(size, size))


def room(world: World, *portals: Light, frame=Frame(12, 12), inside=()):
    """A box with a hole in its ceiling, seen from within."""
    h, r, z = HOLE / 2, ROOM / 2, ROOM / 2
    outer = [(-r, -r, z), (r, -r, z), (r, r, z), (-r, r, z)]
    inner = [(-h, -h, z), (h, -h, z), (h, h, z), (-h, h, z)]
    sides = [(i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    faces = [corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))]
    ceiling = Mesh("ceiling", np.array(outer + inner, np.float32), np.array(faces, np.int32))
    box = scenes.box("walls", ROOM)
    kept = box.triangles[~(box.positions[box.triangles][..., 2] > 0).all(1)]
    made = scenes.scene(
        [
            (dataclasses.replace(box, triangles=kept), scenes.IDENTITY, scenes.diffuse(0.5)),
            (ceiling, scenes.IDENTITY, scenes.diffuse(0.5)),
            *inside,
        ],
        view=scenes.camera(eye=(0, -1.5, 0.5), target=(0, 0.5, -1.5)),
        frame=frame,
    )
    return dataclasses.replace(made, world=dataclasses.replace(world, portals=portals))


def picture(session, scene, **change) -> np.ndarray:
    film = session.render(scene, SETTINGS.replace(**change))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].astype(float)


@pytest.mark.parametrize(
    "world, kind",
    pairs_of(
        {"even": even, "varying": varying}.items(),
        {"rectangle": LightKind.RECTANGLE, "ellipse": LightKind.ELLIPSE}.items(),
    ),
)
def test_portals_change_the_noise_and_not_the_light(session, world, kind, examples):
    """The circle around the hole covers more than that, the square is the hole itself."""
    size = HOLE if kind == LightKind.RECTANGLE else HOLE * 2**0.5
    # one that faces away, and one elsewhere that no light comes through
    others = (
        Light("away", kind, scenes.look_at((0, 0, 2), (0, 0, 5), (0, 1, 0)), (0.0,) * 3, size=(1, 1)),
        portal(x=1.2),
    )
    found = {}
    for name, portals in (("without", ()), ("with", (portal(size=size, kind=kind), *others))):
        runs = [
            picture(session, room(world(), *portals), seed=seed, sample_count=max(examples(512), 320))
            for seed in range(8)
        ]
        spread = np.var(runs, axis=0, ddof=1)
        found[name] = np.mean(runs), spread.mean(), np.sqrt(spread.sum() / len(runs)) / runs[0].size
    error = np.hypot(found["without"][2], found["with"][2])
    assert abs(found["with"][0] - found["without"][0]) < 4 * error
    assert error < 0.02 * found["with"][0]
    assert found["with"][1] < 0.05 * found["without"][1]


@pytest.mark.parametrize("settings", [{"mis": "OFF"}, {"nee": "OFF"}], ids=str)
def test_without_multiple_importance_sampling_the_light_is_the_same(session, settings):
    scene = room(varying(), portal())
    many = dict(sample_count=1024, bounce_max=1)
    assert picture(session, scene, **many, **settings).mean() == pytest.approx(
        picture(session, scene, **many).mean(), rel=0.03
    )


def test_portals_light_volumes_too(session, examples):
    """What a volume scatters finds the world through portals, with the weights of surfaces."""
    glass = Closure(ClosureKind.TRANSPARENT, (1.0, 1.0, 1.0))
    smoke = Volume((Closure(ClosureKind.HENYEY_GREENSTEIN, (0.8, 0.8, 0.8)),))
    cloud = (scenes.box("cloud", 1.6), scenes.IDENTITY, dataclasses.replace(scenes.material(glass), volume=smoke))
    means, errors = [], []
    for portals in ((), (portal(),)):
        scene = room(even(), *portals, inside=[cloud])
        runs = [picture(session, scene, seed=seed, sample_count=max(examples(512), 320)) for seed in range(6)]
        means.append(np.mean(runs))
        errors.append(np.sqrt(np.var(runs, axis=0, ddof=1).sum() / len(runs)) / runs[0].size)
    assert abs(means[1] - means[0]) < 4 * np.hypot(*errors)
    assert np.hypot(*errors) < 0.02 * means[1] and errors[1] < 0.5 * errors[0]


@wp.kernel(**KERNEL_OPTIONS)
def look_up(
    table: LightTable,
    position: wp.vec3,
    directions: wp.array(dtype=wp.vec3),
    densities: wp.array(dtype=float),
    points: wp.array(dtype=wp.vec2),
    sampled: wp.array(dtype=float),
):
    i = wp.tid()
    densities[i] = portals_pdf(table, position, directions[i])
    sampled[i] = sample_through_portals(table, position, points[i]).pdf


@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("kind", [LightKind.RECTANGLE, LightKind.ELLIPSE])
def test_densities_add_up(kind, is_even):
    """Two portals that overlap, and one behind the point."""
    count, random = 200_000, np.random.default_rng(4)
    portals = (portal(1.0, 1.5, kind), portal(0.8, 1.0, kind, 0.3), portal(-1.0))
    scene = dataclasses.replace(room(varying()), world=dataclasses.replace(varying(), portals=portals))
    light = np.ones((8, 16), np.float32) + (np.arange(16) == 3)
    world = sampled_world(WorldLight(light), wp.get_device("cpu"), is_even)
    uploaded = upload_lights(scene, wp.get_device("cpu"), world=world)
    z, around = random.uniform(-1, 1, count), random.uniform(0, 2 * np.pi, count)
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(around), np.sqrt(1 - z * z) * np.sin(around), z], 1)
    densities, sampled = wp.zeros(count, dtype=float, device="cpu"), wp.zeros(count, dtype=float, device="cpu")
    inputs = (
        wp.array(directions, dtype=wp.vec3, device="cpu"),
        wp.array(random.random((count, 2)), dtype=wp.vec2, device="cpu"),
    )
    wp.launch(
        look_up, count, [uploaded.table, wp.vec3(0.1, 0.0, 0.0), inputs[0], densities, inputs[1], sampled], device="cpu"
    )
    densities, sampled = densities.numpy().astype(float), sampled.numpy().astype(float)
    assert 4 * np.pi * densities.mean() == pytest.approx(1, abs=0.01)
    # the mean reciprocal of densities is the solid angle of all that can be found
    reach = 4 * np.pi * (densities > 0).mean()
    assert reach < 4 if is_even else reach == pytest.approx(4 * np.pi)
    assert (sampled > 0).all()
    assert (1 / sampled).mean() == pytest.approx(reach, rel=0.01)


@pytest.mark.parametrize(
    "change",
    [
        {"batching": "ON", "treelet_size": 16},
        {"batching": "ON", "ray_count": 100, "queue_size": 8},
        {"tile_size": 5, "thread_count": 2},
        {"ray_sort": "ON", "sample_order": "FRAME_FIRST"},
    ],
    ids=str,
)
def test_any_schedule_gives_the_same_film(session, change):
    scene = room(varying(), portal(), portal(kind=LightKind.ELLIPSE), frame=Frame(20, 14))
    plain = picture(session, scene, sample_count=3, batching="OFF")
    np.testing.assert_array_equal(picture(session, scene, sample_count=3, **change), plain)


def test_scenes_without_portals_have_no_code_for_them():
    without, with_one = (derive_features(room(varying(), *each), SETTINGS) for each in ((), (portal(),)))
    assert not without.light_portals and "portals of the world" in without.left_out()
    assert with_one.light_portals and "portals" in why_not_general(with_one, ON_GPU)
    assert not derive_features(room(varying(), portal()), SETTINGS.replace(nee="OFF")).light_portals


def test_portals_are_checked_and_saved(session, tmp_path):
    with pytest.raises(SceneError, match="portal “portal” is a POINT"):
        session.render(room(varying(), portal(kind=LightKind.POINT)), SETTINGS)
    with pytest.raises(SceneError, match="no program"):
        session.render(room(World((1.0, 1.0, 1.0)), portal()), SETTINGS)
    save_scene(tmp_path / "room.rbs", room(varying(), portal()), SETTINGS)
    (saved,) = load_scene(tmp_path / "room.rbs")[0].world.portals
    assert saved.size == (HOLE, HOLE) and saved.kind == LightKind.RECTANGLE
