"""Grids of volumes: those that move while the shutter is open, by grids of velocities, and those read by splines."""

import os
import tempfile

import bpy
import numpy as np

from tests.blender.features.build import add_world, floor, lamp, look
from tests.blender.features.families.motion import keyed
from tests.blender.features.families.volumes import volume_of
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_object

_SHAPE, _STEP = (28, 28, 28), 0.09
_FRAMES = 24.0  # a second


def _grid(name: str, values: np.ndarray, kind: str):
    """An OpenVDB grid around the origin."""
    import openvdb

    grid = getattr(openvdb, kind)()
    grid.name = name
    grid.copyFromArray(values.astype(np.float32), ijk=tuple(-count // 2 for count in _SHAPE))
    grid.transform = openvdb.createLinearTransform(_STEP)
    return grid


def _smoke(scene: bpy.types.Scene, velocity: np.ndarray, split: bool, position: str, length: float) -> bpy.types.Object:
    """Two puffs of smoke that go by `velocity` [m/s, or m a frame], shape [x, y, z, 3]; as one grid, or three."""
    bpy.utils.expose_bundled_modules()
    import openvdb

    add_world(scene, 0.4, (0.6, 0.75, 1.0))
    floor()
    lamp("AREA", (2.5, -1.5, 3.0), target=(0, 0, 1), energy=150.0, size=1.0)
    look(scene, (0, -4.8, 2.0), (0, 0, 1.0), lens=50)
    place = _places()
    values = np.zeros(_SHAPE)
    for middle in ((-0.5, 0, 0.1), (0.55, 0.1, -0.3)):
        values += 8.0 * (np.linalg.norm(place - middle, axis=-1) < 0.3)
    grids = [_grid("density", values, "FloatGrid")]
    if split:
        grids += [_grid(f"v{axis}", velocity[..., i], "FloatGrid") for i, axis in enumerate("xyz")]
    else:
        grids.append(_grid("velocity", velocity, "Vec3SGrid"))
    path = os.path.join(tempfile.mkdtemp(), "smoke.vdb")
    openvdb.write(path, grids)
    data = bpy.data.volumes.new("Smoke")
    data.filepath = path
    obj = add_object("Smoke", data)
    obj.location = (0, 0, 1.1)
    values = {"Color": (0.8, 0.6, 0.4), "Density": 1.0}
    volume_of(obj, lambda graph: graph.value("ShaderNodeVolumePrincipled", values))
    # Bounds by which Cycles finds collisions are those of grids that stand still: where something moves, means are off
    # by 0.5 to 1.5 %. In small steps it gives the picture of RayBatch
    scene.cycles.volume_biased, scene.cycles.volume_step_rate, scene.cycles.volume_max_steps = True, 0.2, 4096
    render = scene.render
    render.fps, render.fps_base = int(_FRAMES), 1.0
    render.use_motion_blur, render.motion_blur_shutter, render.motion_blur_position = True, length, position
    scene.frame_set(10)
    return obj


def _places() -> np.ndarray:
    """Of voxels [m], shape [x, y, z, 3]."""
    return np.stack(np.meshgrid(*[(np.arange(n) - n // 2) * _STEP for n in _SHAPE], indexing="ij"), -1)


@feature("Motion blur: a volume by its velocities", "Volumes", "picture", quick=True, samples=64)
def by_velocities(scene: bpy.types.Scene) -> None:
    """The puffs go round one another, and up."""
    place = _places()
    turning = np.stack([-place[..., 1], place[..., 0], np.full(_SHAPE, 0.25)], -1)
    turning[..., 0] += 0.5
    _smoke(scene, turning * _FRAMES, split=False, position="CENTER", length=0.8)


@feature("Motion blur: a volume by velocities in three grids, from the frame on", "Volumes", "picture", samples=64)
def by_three_grids(scene: bpy.types.Scene) -> None:
    """Along one axis, on an object that moves."""
    velocity = np.zeros((*_SHAPE, 3))
    velocity[..., 0] = 0.4
    velocity[..., 2] = 0.3 * (_places()[..., 0] > 0)
    obj = _smoke(scene, velocity, split=True, position="START", length=1.0)
    obj.data.velocity_grid, obj.data.velocity_unit, obj.data.velocity_scale = "v", "FRAME", 1.5
    keyed(obj, "location", (-0.3, 0, 0.9), (0.3, 0, 1.3))
    scene.frame_set(10)


@feature("OpenVDB object: cubic interpolation", "Volumes", "picture", quick=True, samples=64)
def by_splines(scene: bpy.types.Scene) -> None:
    """Few large voxels."""
    obj = _smoke(scene, np.zeros((*_SHAPE, 3)), split=False, position="CENTER", length=0.5)
    obj.scale, obj.data.materials[0].cycles.volume_interpolation = (2.5, 2.5, 2.5), "CUBIC"
    scene.render.use_motion_blur = False
