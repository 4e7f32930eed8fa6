"""Emissive triangles and the tree over them are kept where the same things shine, whatever else is edited."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights import table
from raybatch_addon.core.wavefront.scene import device_scene
from tests.core.wavefront.scene.edited import painted
from tests.core.wavefront.scene.keeping import counted_calls, frozen_meshes
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=4, bounce_max=2)
FIRST, PLAIN, LAMP, TWIN, GLOW = range(5)
BOXES = [frozen_meshes(scenes.scene([(scenes.box(), scenes.IDENTITY, None)])).meshes[0] for _ in range(4)]


def scene_of(*shown, glow=3.0):
    """Those of five boxes that are `shown`, in their order: two shine, of which the second is a mesh that the box
    before it has as well. Meshes and materials are numbered in the order in which they come, as exporters have it.
    """
    materials = [
        scenes.diffuse(0.2),
        scenes.diffuse(0.7),
        painted(3.0, False),
        scenes.diffuse(0.5),
        painted(glow, True),
    ]
    meshes = [BOXES[0], BOXES[1], BOXES[2], BOXES[3], BOXES[3]]
    parts = [(meshes[i], scenes.translation(1.5 * i - 3, i % 2, 0, 0.5), materials[i]) for i in shown]
    made = scenes.scene(parts, view=scenes.camera(eye=(0, -7, 1)), frame=Frame(16, 8), world=0.1)
    return replace(made, lights=(scenes.area_light(matrix=scenes.translation(0, -1, 3)),))


ALL = (FIRST, PLAIN, LAMP, TWIN, GLOW)


@pytest.fixture
def made(monkeypatch):
    """What was made, by name, in order."""
    calls, count = counted_calls(monkeypatch)
    count(device_scene, "find_emissive_triangles")
    count(table, "fill_blocks")
    return calls


@pytest.mark.parametrize(
    "hidden, keeps",
    [
        ({FIRST}, True),
        ({PLAIN}, True),
        ({FIRST, PLAIN}, True),
        ({LAMP}, False),
        ({TWIN}, False),
        ({FIRST, GLOW}, False),
    ],
)
def test_emitters_are_kept_where_other_things_are_hidden_and_shown(made, hidden, keeps):
    """The mesh of GLOW lies in world space once TWIN is hidden: points on it are rounded otherwise."""
    session, before = Session(DEVICE), scene_of(*ALL)
    session.render(before, SETTINGS)
    for scene in (scene_of(*(i for i in ALL if i not in hidden)), before):
        made.clear()
        film = session.render(scene, SETTINGS)
        assert ("find_emissive_triangles" not in made) == keeps or scene is before
        assert ("fill_blocks" not in made) == keeps or scene is before
        if keeps:
            assert not made
        fresh = Session(DEVICE).render(scene, SETTINGS)
        np.testing.assert_array_equal(film.passes["Combined"], fresh.passes["Combined"])


def test_another_graph_that_does_not_shine_keeps_emitters(made):
    session, scene = Session(DEVICE), scene_of(*ALL)
    session.render(scene, SETTINGS)
    made.clear()
    materials = list(scene.materials)
    materials[scene.slot_materials[PLAIN]] = painted(0.3, True)
    other = replace(scene, materials=tuple(materials))
    film = session.render(other, SETTINGS)
    assert not made
    fresh = Session(DEVICE).render(other, SETTINGS)
    np.testing.assert_array_equal(film.passes["Combined"], fresh.passes["Combined"])


def test_another_brightness_finds_them_anew(made):
    session, other = Session(DEVICE), scene_of(*ALL, glow=5.0)
    session.render(scene_of(*ALL), SETTINGS)
    made.clear()
    film = session.render(other, SETTINGS)
    assert made == ["find_emissive_triangles", "fill_blocks"]
    fresh = Session(DEVICE).render(other, SETTINGS)
    np.testing.assert_array_equal(film.passes["Combined"], fresh.passes["Combined"])
