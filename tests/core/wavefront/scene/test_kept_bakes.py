"""Meshes in world space are brought there once, as long as they and their places stay the same."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.wavefront.scene import kept_bakes
from raybatch_addon.core.wavefront.scene.kept_bakes import KeptBakes
from tests.core.wavefront.scene.keeping import frozen_meshes
from tests.support import scenes


@pytest.fixture
def baked(monkeypatch):
    """Names of the meshes that were brought to their places."""
    names, bake = [], kept_bakes.baked_mesh
    monkeypatch.setattr(kept_bakes, "baked_mesh", lambda mesh, to: names.append(mesh.name) or bake(mesh, to))
    return names


def three_balls(x: float = 0.0):
    balls = [scenes.sphere(name, smooth=True) for name in "abc"]
    places = [scenes.translation(x, 0, 1), scenes.translation(3, 0, 1), scenes.translation(6, 0, 1, 0.5)]
    return frozen_meshes(scenes.scene([(ball, to, scenes.diffuse()) for ball, to in zip(balls, places, strict=True)]))


def assert_flattened(bakes: KeptBakes, scene) -> None:
    bakes.begin()
    found, expected = flatten(scene, bake=bakes.get), flatten(scene)
    for name in ("positions", "triangles", "corner_normals", "triangle_slot"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


def moved(scene, x: float):
    transform = np.array(scene.instances.transform)
    transform[0, 0, 3] = x
    return replace(scene, instances=replace(scene.instances, transform=transform))


def test_what_stays_is_kept(baked):
    bakes, scene = KeptBakes(), three_balls()
    for each, expected in ((scene, "abc"), (scene, ""), (moved(scene, 1.0), "a"), (scene, "a"), (scene, "")):
        baked.clear()
        assert_flattened(bakes, each)
        assert "".join(baked) == expected
    bakes.clear()
    assert_flattened(bakes, scene)
    assert "".join(baked) == "abc"


@pytest.mark.parametrize("name", ["positions", "triangles", "corner_normals"])
def test_other_arrays_are_seen(baked, name):
    bakes, scene = KeptBakes(), three_balls()
    assert_flattened(bakes, scene)
    baked.clear()
    values = np.array(getattr(scene.meshes[1], name))
    values[:2] = values[1::-1]
    changed = replace(scene.meshes[1], **{name: freeze(values)})
    assert_flattened(bakes, replace(scene, meshes=(scene.meshes[0], changed, scene.meshes[2])))
    assert "".join(baked) == "b"


def test_arrays_that_may_change_are_looked_at(baked):
    bakes, scene = KeptBakes(), three_balls()
    loose = replace(scene.meshes[0], positions=np.array(scene.meshes[0].positions))
    scene = replace(scene, meshes=(loose, *scene.meshes[1:]))
    for expected in ("abc", "a"):
        baked.clear()
        assert_flattened(bakes, scene)
        assert "".join(baked) == expected
        assert bakes._bytes == 2 * kept_bakes._bytes_of(bakes.get(scene.meshes[1], scene.instances.transform[1]))
        loose.positions[:] *= 1.5


def test_no_more_is_kept_than_there_is_room_for(baked, monkeypatch):
    bakes, scene = KeptBakes(), three_balls()
    bakes.get(scene.meshes[0], scene.instances.transform[0])
    monkeypatch.setattr(kept_bakes, "_BYTES_MOST", int(1.5 * bakes._bytes))
    assert_flattened(bakes, scene)
    baked.clear()
    assert_flattened(bakes, scene)
    assert len(baked) == 2
