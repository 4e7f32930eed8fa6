"""Geometry of a scene in one set of arrays: baked if possible, shared if necessary."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

MIRROR = np.array([[-1, 0, 0, 2], [0, 1.5, 0, 0], [0, 0, 0.5, 1]], np.float32)


def outward(positions, triangles, centre) -> np.ndarray:
    """Sign of each triangle's normal relative to the direction away from `centre`."""
    corners = positions.astype(np.float64)[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.sign(np.einsum("ij,ij->i", normal, corners.mean(1) - centre))


def test_a_mirrored_mesh_keeps_its_front_outside():
    ball = scenes.sphere(segments=12, rings=6, smooth=True)
    flat = flatten(scenes.scene([(ball, MIRROR, scenes.diffuse())]))
    assert np.all(outward(flat.positions, flat.triangles, MIRROR[:, 3]) == 1)
    normals = flat.corner_normals.reshape(-1, 3, 3)
    corners = flat.positions[flat.triangles]
    true = (corners - MIRROR[:, 3]) / np.array([1, 1.5**2, 0.5**2])  # gradient of the ellipsoid
    true /= np.linalg.norm(true, axis=-1, keepdims=True)
    assert np.abs(normals - true).max() < 1e-5


def test_baked_and_shared_geometry_is_placed_by_visibility():
    ball, floor, lid = scenes.sphere(segments=8, rings=4), scenes.plane(), scenes.plane("lid")
    hidden = Visibility.ALL & ~Visibility.CAMERA
    flat = flatten(
        scenes.scene(
            [
                (ball, scenes.IDENTITY, scenes.diffuse()),
                (lid, scenes.translation(0, 0, 3), scenes.diffuse(), hidden),
                (ball, scenes.translation(3, 0, 0), scenes.diffuse()),
                (floor, scenes.translation(0, 0, -1), scenes.diffuse()),
            ]
        )
    )
    assert [group.visibility for group in flat.merged] == [int(Visibility.ALL), int(hidden)]
    assert [group.instance.tolist() for group in flat.merged] == [[3], [1]]
    assert flat.shared.tolist() == [0, 2] and flat.instance_mesh[0] == flat.instance_mesh[2]
    assert np.array_equal(flat.instance_transform[1], scenes.IDENTITY) and flat.instance_transform[2][0, 3] == 3
    for instance in (1, 3):  # every baked instance finds its own triangles
        first = flat.mesh_triangle_first[flat.instance_mesh[instance]]
        height = flat.positions[flat.triangles[first]][:, 2]
        assert np.all(height == (3 if instance == 1 else -1))


@pytest.mark.usefixtures("general_kernels")
def test_mirrored_instances_shade_like_mirrored_meshes(session):
    """The front of a mirrored object is the front whether it is baked or shared."""
    glass = scenes.material(dataclasses.replace(scenes.diffuse(0.5).closures[0], kind=5, ior=1.5, weight=(1, 1, 1)))
    ball = scenes.sphere(segments=16, rings=8, smooth=True)
    mirror = MIRROR.copy()
    mirror[:, 3] = 0
    far = scenes.translation(0, 0, 500)
    few = RenderSettings(sample_count=64, seed=3)
    pictures = []
    for objects in ([(ball, mirror, glass)], [(ball, mirror, glass), (ball, far, glass)]):
        floor = (scenes.plane(size=8), scenes.translation(0, 0, -1), scenes.diffuse((0.8, 0.3, 0.2)))
        scene = scenes.scene([*objects, floor], world=(0.2, 0.5, 1.0), view=scenes.camera(eye=(0, -4, 1)))
        pictures.append(session.render(scene, few).passes["Combined"])
    difference = np.abs(pictures[0] - pictures[1])
    assert difference.mean() < 2e-3
