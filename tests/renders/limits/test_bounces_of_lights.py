"""Lights that paths aim at from their first vertices alone, and a world that shines through what is in its way."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Frame, Light, LightKind, Scene, Visibility, World
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tier import why_not_general
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")
SETTINGS = RenderSettings(sample_count=16, bounce_max=3)
ON_GPU = SimpleNamespace(is_cuda=True)


@pytest.fixture(scope="module")
def session():
    made = Session(DEVICE)
    yield made
    made.close()


def sky() -> World:
    """Brightest above and below."""
    builder = ProgramBuilder()
    direction = builder.value("normals")[2]
    square = builder.value("multiply_colors", direction, direction)
    builder.closure("emission", builder.value("multiply_colors", square, (0.1, 0.2, 1.0)))
    return World(program=builder.finish())


def room(*limits: int | None) -> Scene:
    """A grey box from within, with a lamp without size for each of `limits`."""
    lamps = tuple(
        Light(f"lamp {i}", LightKind.POINT, scenes.translation(0.5 - i, 0, 0.5), (1.0, 0.5 + i, 2.0), bounce_max=limit)
        for i, limit in enumerate(limits)
    )
    view = scenes.camera(eye=(0.1, -0.5, 0.2), target=(0, 1, 0))
    return scenes.scene(
        [(scenes.box(), scenes.IDENTITY, scenes.diffuse(0.7))], view=view, frame=Frame(16, 12), lights=lamps
    )


def outside(roofed: bool, **world) -> Scene:
    """A floor under the sky, and a roof over it that stops shadow rays alone."""
    made = scenes.scene(
        [
            (scenes.plane(size=20.0), scenes.IDENTITY, scenes.diffuse(0.7)),
            (scenes.plane("roof", 200.0), scenes.translation(0, 0, 1), scenes.diffuse(0.7)),
        ],
        view=scenes.camera(eye=(0, -2, 0.9), target=(0, 0, 0)),
        frame=Frame(16, 12),
    )
    seen = made.instances.visibility.copy()
    seen[1] = int(Visibility.SHADOW) if roofed else 0
    instances = dataclasses.replace(made.instances, visibility=seen)
    return dataclasses.replace(made, instances=instances, world=dataclasses.replace(sky(), **world))


def picture(session: Session, scene: Scene, **change) -> np.ndarray:
    film = session.render(scene, SETTINGS.replace(**change))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].copy()


@pytest.mark.parametrize("limit", [0, 1, 2])
def test_a_lamp_with_few_bounces_lights_the_first_vertices_alone(session, limit):
    limited = picture(session, room(limit))
    np.testing.assert_array_equal(limited, picture(session, room(None), bounce_max=limit))
    assert limited.mean() < 0.95 * picture(session, room(None)).mean()


def test_lamps_have_limits_of_their_own(session):
    """The light of two lamps is that of each; each is chosen for its share."""
    both = picture(session, room(0, 2), sample_count=1024)
    alone = picture(session, dataclasses.replace(room(0, 2), lights=room(0, 2).lights[:1]), sample_count=256)
    other = picture(session, dataclasses.replace(room(0, 2), lights=room(0, 2).lights[1:]), sample_count=256)
    np.testing.assert_allclose(both.mean((0, 1)), alone.mean((0, 1)) + other.mean((0, 1)), rtol=0.01)


def test_a_world_without_shadow_shines_through_what_is_in_the_way(session):
    settings = {"mis": "OFF", "bounce_max": 0}
    free = picture(session, outside(roofed=False), **settings)
    through = picture(session, outside(roofed=True, casts_shadow=False), **settings)
    np.testing.assert_allclose(through, free, rtol=1e-5)
    assert picture(session, outside(roofed=True), **settings).mean() < 0.5 * free.mean()


def test_a_world_with_few_bounces_is_aimed_at_from_the_first_vertices_alone(session):
    """Without rays that meet it by themselves nothing is left behind its limit."""
    box = room()
    holed = dataclasses.replace(
        box, instances=dataclasses.replace(box.instances, visibility=box.instances.visibility & ~int(Visibility.SHADOW))
    )
    skies = [dataclasses.replace(holed, world=dataclasses.replace(sky(), bounce_max=limit)) for limit in (1, None)]
    limited, free = (picture(session, each, mis="OFF") for each in skies)
    np.testing.assert_array_equal(limited, picture(session, skies[1], mis="OFF", bounce_max=1))
    assert limited.mean() < 0.95 * free.mean()


@pytest.mark.parametrize(
    "change",
    [
        {"batching": "ON", "treelet_size": 16},
        {"batching": "ON", "ray_count": 100, "queue_size": 8},
        {"tile_size": 5, "thread_count": 2},
    ],
    ids=str,
)
def test_any_schedule_gives_the_same_film(session, change):
    scene = scenes.few_bounces(dataclasses.replace(room(None, None), world=sky()))
    plain = picture(session, scene, batching="OFF")
    np.testing.assert_array_equal(picture(session, scene, **change), plain)


def test_scenes_without_limits_have_no_code_for_them():
    without = derive_features(room(None), SETTINGS)
    assert not without.light_bounces and "bounces of lights" in without.left_out()
    with_one = derive_features(room(None, 1), SETTINGS)
    assert with_one.light_bounces and "bounces of lights" in why_not_general(with_one, ON_GPU)
    assert not derive_features(room(SETTINGS.bounce_max), SETTINGS).light_bounces  # paths end before
    assert not derive_features(room(1), SETTINGS.replace(nee="OFF")).light_bounces
    outdoors = outside(roofed=False, bounce_max=1)
    assert derive_features(outdoors, SETTINGS).light_bounces
    unsampled = dataclasses.replace(outdoors, world=dataclasses.replace(outdoors.world, sampling_size=0))
    assert not derive_features(unsampled, SETTINGS).light_bounces


def test_limits_are_saved(tmp_path):
    scene = scenes.few_bounces(dataclasses.replace(room(None), world=sky()))
    save_scene(tmp_path / "scene.npz", scene, SETTINGS)
    loaded, _ = load_scene(tmp_path / "scene.npz")
    assert loaded.lights[0].bounce_max == 0
    assert (loaded.world.bounce_max, loaded.world.casts_shadow) == (1, False)
