"""Trees over time: hits of moving instances and vertices against all triangles at the ray's time, in both layouts."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.motion import maps_at, motion_keys, moving_instances
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.renders.motion.test_motion import moving_scene

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

RAYS = 3000


def rays_towards(seed: int):
    """Random rays through the scene, and their times."""
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=(RAYS, 3)) * 3 + [0, 0, 1]
    target = rng.normal(size=(RAYS, 3)) * [1.5, 0.8, 0.8]
    direction = target - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return origin.astype(np.float32), direction.astype(np.float32), rng.random(RAYS, np.float32)


def traced(scene, layout: Layout, any_hit: bool = False):
    """Distance, instance and primitive that the tree finds."""
    device, flat = wp.get_device("cpu"), flatten(scene)
    geometry = upload_geometry(with_motion(flat), scene, device)
    built = build_scene_tree(flat, geometry, scene.instances.visibility, True, device, layout)
    origin, direction, time = rays_towards(1)
    rays = allocate_rays(RAYS, device, RayNeeds(time=True))
    for name, values in (("origin", origin), ("direction", direction), ("time", time)):
        getattr(rays, name).assign(values)
    rays.t_max.fill_(np.inf)
    rays.visibility.fill_(int(Visibility.ALL))
    listed = RayList(
        wp.array(np.arange(RAYS), dtype=int, device=device), wp.array([RAYS], dtype=int, device=device), RAYS
    )
    stage = trace_stage(layout, TraceOptions(any_hit=any_hit, instancing=True, motion=True))
    load_kernels(list(stage.kernels), device, lambda *_: None)
    stage.launch(built.tree, rays, listed, None)
    return [array.numpy().copy() for array in (rays.hit_t, rays.hit_instance, rays.hit_primitive)]


def met_by_all(scene):
    """The same by Moeller and Trumbore in float64, of all triangles where they are at each ray's time."""
    origin, direction, time = (each.astype(np.float64) for each in rays_towards(1))
    nearest, owner = np.full(RAYS, np.inf), np.full(RAYS, -1)
    moving = moving_instances(scene)
    for i, mesh_index in enumerate(scene.instances.mesh):
        mesh = scene.meshes[mesh_index]
        vertices = np.repeat(mesh.positions[None].astype(np.float64), RAYS, 0)
        if mesh.motion is not None:
            at = time * (len(mesh.motion) - 1)
            step = np.minimum(at.astype(int), len(mesh.motion) - 2)
            share = (at - step)[:, None, None]
            vertices = (1 - share) * mesh.motion[step] + share * mesh.motion[step + 1]
        maps = np.repeat(scene.instances.transform[i][None].astype(np.float64), RAYS, 0)
        if moving[i]:
            maps = maps_at(motion_keys(scene.instances.motion.maps[i : i + 1]), time)[0]
        world = np.einsum("nij,nvj->nvi", maps[:, :, :3], vertices) + maps[:, None, :, 3]
        for triangle in mesh.triangles:
            a, b, c = (world[:, k] for k in triangle)
            across = np.cross(direction, c - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1 / ((b - a) * across).sum(1)
                u = ((origin - a) * across).sum(1) * inverse
                other = np.cross(origin - a, b - a)
                v, t = (direction * other).sum(1) * inverse, ((c - a) * other).sum(1) * inverse
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < nearest)
            nearest[hit], owner[hit] = t[hit], i
    return nearest, owner


@pytest.mark.parametrize("layout", list(Layout))
def test_rays_meet_what_is_there_at_their_time(layout):
    scene = moving_scene()
    t, instance, _ = traced(scene, layout)
    nearest, owner = met_by_all(scene)
    assert (owner >= 0).mean() > 0.5 and len(np.unique(owner)) == len(scene.instances) + 1
    # at silhouettes rounding decides
    assert (instance == owner).mean() > 0.999
    same = (instance == owner) & (owner >= 0)
    # where two edges meet rounding decides too: which of two surfaces, hardly ever
    assert (np.abs(t[same] - nearest[same]) < 1e-4).mean() > 0.999
    occluded = traced(scene, layout, any_hit=True)[1]
    np.testing.assert_array_equal(occluded >= 0, instance >= 0)


def test_both_layouts_find_the_same():
    found = [traced(moving_scene(), layout) for layout in Layout]
    assert (found[0][1] == found[1][1]).all() and (found[0][2] == found[1][2]).all()
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-5)
