"""Volumes that move by grids of vectors while the shutter is open, against the same in NumPy."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Grid, Scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.volumes.grids import flow_reach
from tests.renders.volumes.test_volumes import color
from tests.stability.volume_scenes import in_grid

pytestmark = pytest.mark.usefixtures("general_kernels")

COUNT = 32  # voxels along an edge of the cube of 2 m
PARTS = ((10, 6, 1.5),)  # 12 x 12 x 6 voxels around the ray


def places() -> np.ndarray:
    """Of voxels [m], shape [x, y, z, 3]."""
    along = (np.arange(COUNT) + 0.5) * 2 / COUNT - 1
    return np.stack(np.meshgrid(along, along, along, indexing="ij"), -1)


def moving(vectors: np.ndarray, time: float = 0.5) -> Scene:
    """A dense block in a grid that moves by `vectors` [m], shape [x, y, z, 3]; `time`: when it is where the grid has
    it.
    """
    scene, _ = in_grid(COUNT, PARTS)
    mesh = scene.meshes[0]
    flow = Grid("velocity", freeze(vectors.astype(np.float32)), mesh.grids[0].to_index)
    return dataclasses.replace(scene, meshes=(dataclasses.replace(mesh, flow=flow, flow_time=time), *scene.meshes[1:]))


def looked_up(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear between voxels, and 0 outside; `at`: places [m], shape [n, 3]."""
    index = (at + 1) * COUNT / 2 - 0.5
    first = np.floor(index).astype(int)
    share = index - first
    padded = np.pad(values, [(2, 2)] * 3 + [(0, 0)] * (values.ndim - 3))
    result = 0.0
    for x, y, z in np.ndindex(2, 2, 2):
        corner = np.clip(first + (x, y, z) + 2, 0, COUNT + 3)
        weight = np.prod(np.where(np.array((x, y, z)) == 1, share, 1 - share), -1)
        found = padded[corner[:, 0], corner[:, 1], corner[:, 2]]
        result = result + (weight[:, None] * found if values.ndim > 3 else weight * found)
    return result


def passed(vectors: np.ndarray, time: float) -> float:
    """What comes through along the axis z, in the mean over the time that the shutter is open."""
    density = in_grid(COUNT, PARTS)[0].meshes[0].grids[0].values.astype(float)
    z = np.linspace(-1, 1, 4001)
    ray = np.column_stack([np.zeros((len(z), 2)), z])
    shares = []
    for now in (np.arange(200) + 0.5) / 200:
        at = ray - (now - time) * looked_up(vectors, ray)
        at = ray - (now - time) * looked_up(vectors, at)
        shares.append(np.exp(-np.trapezoid(looked_up(density, at), z)))
    return float(np.mean(shares))


def aside() -> np.ndarray:
    return np.broadcast_to([0.9, 0.4, 0.0], (COUNT, COUNT, COUNT, 3))


def around() -> np.ndarray:
    at = places()
    return np.stack([-3.0 * at[..., 2], np.zeros(at.shape[:3]), 3.0 * at[..., 0]], -1)


@pytest.mark.parametrize("time", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("way", [aside, around])
def test_what_a_ray_sees_in_the_mean_over_time(session, way, time):
    vectors = np.array(way(), float)
    film = session.render(moving(vectors, time), RenderSettings(sample_count=1024, bounce_max=0))
    found, expected = color(film), passed(vectors, time)
    still = float(color(session.render(in_grid(COUNT, PARTS)[0], RenderSettings(sample_count=256))).mean())
    assert abs(expected - still) > 0.02
    error = found.std() / np.sqrt(found[..., 0].size)
    assert abs(found.mean() - expected) < 5 * error + 1e-3
    # bounds are those of where things come
    counts = film.statistics["volumes"]
    assert counts["collisions"] > 0 == counts["exceeded"]


def test_an_object_that_turns_takes_its_vectors_with_it(session):
    """A quarter of a turn about the ray: what would go along x goes along y."""
    turned = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]], np.float32)
    scene = moving(np.array(aside(), float))
    instances = dataclasses.replace(scene.instances, transform=turned[None])
    settings = RenderSettings(sample_count=1024, bounce_max=0)
    found = color(session.render(dataclasses.replace(scene, instances=instances), settings))
    vectors = np.broadcast_to([0.9, 0.4, 0.0], (COUNT, COUNT, COUNT, 3))
    error = found.std() / np.sqrt(found[..., 0].size)
    assert abs(found.mean() - passed(vectors, 0.5)) < 5 * error + 1e-3


def test_how_far_things_come():
    vectors = np.zeros((COUNT, COUNT, COUNT, 3))
    vectors[3, 4, 5] = (0.5, -2.0, 0.0)
    for time, share in ((0.5, 0.5), (0.0, 1.0), (-1.0, 2.0)):
        np.testing.assert_allclose(flow_reach(moving(vectors, time).meshes[0]), np.array([0.5, 2.0, 0.0]) * share)
    assert not flow_reach(in_grid(COUNT, PARTS)[0].meshes[0]).any()


def test_a_session_that_keeps_bounds_finds_others_for_other_vectors(session):
    settings = RenderSettings(sample_count=256, bounce_max=0)
    for length in (0.2, 1.5):
        film = session.render(moving(length * np.array(aside(), float)), settings)
        assert film.statistics["volumes"]["exceeded"] == 0


def test_scenes_without_have_none_of_it():
    still, settings = in_grid(COUNT, PARTS)[0], RenderSettings()
    assert not derive_features(still, settings).volume_program.flows
    assert not derive_features(still, settings).motion
    assert "motion within volumes" in derive_features(still, settings).left_out()
    features = derive_features(moving(np.array(aside(), float)), settings)
    assert features.volume_program.flows and features.motion and not features.moving
