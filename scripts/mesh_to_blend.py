"""Make a .blend of bare geometry, so that other engines can render it too. Needs bpy.

python scripts/mesh_to_blend.py MESH.npz OUT.blend --camera ex,ey,ez,tx,ty,tz,fov [--up y]
    under a sun and a constant world
python scripts/mesh_to_blend.py MESH.npz OUT.blend --stage [--up y]
    on a floor, under one area light, seen from the front

MESH.npz holds `v` float32 [n, 3], `f` int32 [m, 3] and perhaps `m` [m], a material id a triangle (as
`scripts/render.py` takes it). Everything is diffuse and white.
"""

import argparse
import math
import sys
import zipfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import UsageError, exit_code
from lib.node_trees import with_nodes

ERRORS = (UsageError, OSError)


def mesh_object(path: Path, up: str, drop: list[int], flat: bool) -> bpy.types.Object:
    """The geometry of `path` as an object, turned so that Blender's z is up, without the materials `drop`; normals are
    interpolated, but for `flat`.
    """
    try:
        with np.load(path) as arrays:
            v, f = arrays["v"].astype(np.float32), arrays["f"].astype(np.int32)
            if drop:
                f = f[~np.isin(arrays["m"], drop)]
    except (EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path} holds no geometry: {error}") from error
    if up == "y":
        v = v[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    mesh = bpy.data.meshes.new(path.stem)
    mesh.vertices.add(len(v))
    mesh.vertices.foreach_set("co", v.ravel())
    mesh.loops.add(f.size)
    mesh.loops.foreach_set("vertex_index", f.ravel())
    mesh.polygons.add(len(f))
    mesh.polygons.foreach_set("loop_start", np.arange(0, f.size, 3, dtype=np.int32))
    if flat:
        mesh.shade_flat()
    mesh.update()
    material = with_nodes(bpy.data.materials.new("white"))
    tree = material.node_tree
    tree.nodes.clear()
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    return bpy.data.objects.new(path.stem, mesh)


def point_camera(scene: bpy.types.Scene, eye: Vector, target: Vector, fov: float) -> None:
    """Give the scene a camera; `fov` in radians."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.angle, camera.data.clip_start = eye, fov, 1e-4
    camera.rotation_euler = (target - eye).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera


def under_the_sky(scene: bpy.types.Scene, given: argparse.Namespace) -> None:
    """A sun and a constant world, and the camera that was asked for."""
    try:
        ex, ey, ez, tx, ty, tz, degrees = map(float, given.camera.split(","))
    except ValueError as error:
        raise UsageError("--camera takes seven numbers: ex,ey,ez,tx,ty,tz,fov_degrees") from error
    turn = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0))) if given.up == "y" else Matrix.Identity(3)
    point_camera(scene, turn @ Vector((ex, ey, ez)), turn @ Vector((tx, ty, tz)), math.radians(degrees))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle = given.sun, math.radians(1)
    sun.rotation_euler = (math.radians(15), math.radians(20), 0)
    scene.collection.objects.link(sun)
    scene.world = with_nodes(bpy.data.worlds.new("World"))
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    background.inputs["Strength"].default_value = given.world


def on_a_stage(scene: bpy.types.Scene, placed: bpy.types.Object) -> None:
    """A floor, an area light as wide as the object is large, and a camera in front of it."""
    corners = np.array(placed.bound_box)
    low, high = corners.min(0), corners.max(0)
    middle, extent = (low + high) / 2, float((high - low).max())
    bpy.ops.mesh.primitive_plane_add(size=6 * extent, location=(middle[0], middle[1], low[2]))
    bpy.context.object.data.materials.append(placed.data.materials[0])
    light = bpy.data.objects.new("Area", bpy.data.lights.new("Area", "AREA"))
    light.data.size, light.data.energy = extent, 40 * extent * extent
    light.location = (middle[0], middle[1], high[2] + 1.5 * extent)
    scene.collection.objects.link(light)
    eye = Vector((middle[0], middle[1] - 1.6 * extent, middle[2] + 0.5 * extent))
    point_camera(scene, eye, Vector(middle.tolist()), math.radians(40))
    scene.world = bpy.data.worlds.new("World")


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("out", type=Path)
    how = parser.add_mutually_exclusive_group(required=True)
    how.add_argument("--camera", help="ex,ey,ez,tx,ty,tz,fov_degrees, in the axes of the file")
    how.add_argument("--stage", action="store_true", help="on a floor, under an area light, seen from the front")
    parser.add_argument("--up", choices=("y", "z"), default="z", help="the axis of the file that points up")
    parser.add_argument("--drop", type=int, action="append", default=[], help="leave out triangles of this material id")
    parser.add_argument(
        "--flat", action="store_true", help="shade every triangle with its own normal; else normals are interpolated"
    )
    parser.add_argument("--sun", type=float, default=4.0, help="irradiance of the sun [W/m²]")
    parser.add_argument("--world", type=float, default=0.5, help="radiance of the world")
    given = parser.parse_args()
    return exit_code("mesh_to_blend.py", lambda: run(given), errors=ERRORS)


def run(given: argparse.Namespace) -> int:
    """Make the file that was asked for; the exit code."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    placed = mesh_object(given.mesh, given.up, given.drop, given.flat)
    scene.collection.objects.link(placed)
    if given.stage:
        on_a_stage(scene, placed)
    else:
        under_the_sky(scene, given)
    scene.render.resolution_x = scene.render.resolution_y = 1280
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(given.out.resolve()))
    except RuntimeError as error:  # as Blender reports what it cannot write
        raise OSError(str(error).strip()) from error
    return 0


if __name__ == "__main__":
    sys.exit(main())
