"""Strands and points that deform while the shutter is open: hits at a time are those of strands that stand still so."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import IDENTITY, flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.core.bvh.traverse.test_segments import hair, rays_around
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

RAYS = 4000


def moving_hair(ribbons: bool):
    """Strands and points that sway to and fro, at three times."""
    mesh = replace(hair(), ribbons=ribbons)
    sway = np.sin(7 * mesh.positions[:, [1, 2, 0]]) * 0.3
    steps = np.stack([mesh.positions + share * sway for share in (-1.0, 0.0, 1.5)]).astype(np.float32)
    return replace(mesh, motion=steps)


def traced(mesh, layout: Layout, time: float):
    """Distance, instance and primitive that the tree finds."""
    scene = scenes.scene([(mesh, IDENTITY, scenes.diffuse())])
    device, flat, moving = wp.get_device("cpu"), flatten(scene), mesh.motion is not None
    geometry = upload_geometry(with_motion(flat), scene, device)
    built = build_scene_tree(flat, geometry, scene.instances.visibility, moving, device, layout, on_device=False)
    origin, direction = rays_around(RAYS, seed=5, size=1.0)
    rays = allocate_rays(RAYS, device, RayNeeds(time=moving))
    for name, values in (("origin", origin), ("direction", direction)):
        getattr(rays, name).assign(values)
    if moving:
        rays.time.fill_(time)
    rays.t_max.fill_(np.inf)
    rays.visibility.fill_(int(Visibility.ALL))
    slots = wp.array(np.arange(RAYS), dtype=int, device=device)
    listed = RayList(slots, wp.array([RAYS], dtype=int, device=device), RAYS)
    refill = 8 if layout is Layout.BOXES else 0
    options = TraceOptions(any_hit=False, instancing=moving, motion=moving, curves=True, refill=refill)
    stage = trace_stage(layout, options)
    load_kernels(list(stage.kernels), device, lambda *_: None)
    stage.launch(built.tree, rays, listed, None)
    return [array.numpy().copy() for array in (rays.hit_t, rays.hit_instance, rays.hit_primitive)]


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("ribbons", [False, True])
@pytest.mark.parametrize("time", [0.0, 0.3, 0.5, 0.85])
def test_strands_are_met_where_they_are_at_a_time(layout, ribbons, time):
    mesh = moving_hair(ribbons)
    at = 2 * time
    step = min(int(at), 1)
    positions = mesh.motion[step] + np.float32(at - step) * (mesh.motion[step + 1] - mesh.motion[step])
    t, instance, primitive = traced(mesh, layout, time)
    expected = traced(replace(mesh, positions=positions, motion=None), layout, time)
    assert (expected[1] >= 0).mean() > 0.1
    # but at the planes between segments, which turn otherwise, the more so where strands have kinks
    assert ((instance >= 0) == (expected[1] >= 0)).mean() > 0.99
    assert (primitive == expected[2]).mean() > 0.975
    same = (instance >= 0) & (primitive == expected[2])
    assert np.quantile(np.abs(t[same] - expected[0][same]), 0.98) < 1e-4


def test_strands_that_deform_are_a_feature():
    features = derive_features(scenes.scene([(moving_hair(True), IDENTITY, scenes.diffuse())]), RenderSettings())
    assert features.moving and features.curves
