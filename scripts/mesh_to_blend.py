"""Make a .blend of bare geometry: python scripts/mesh_to_blend.py MESH.npz OUT.blend --camera ex,ey,ez,tx,ty,tz,fov [--up y]

MESH.npz holds `v` float32 [n, 3], `f` int32 [m, 3] and perhaps `m` [m], a material id a triangle (as `scripts/render.py` takes
it). Everything is diffuse and white, under a sun and a constant world. So that other engines can render it too. Needs bpy.
"""

import argparse
import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector


def mesh_object(path: Path, up: str, drop: list[int]) -> bpy.types.Object:
    """The geometry of `path` as an object, turned so that Blender's z is up, without the materials `drop`."""
    with np.load(path) as arrays:
        v, f = arrays["v"].astype(np.float32), arrays["f"].astype(np.int32)
        if drop:
            f = f[~np.isin(arrays["m"], drop)]
    if up == "y":
        v = v[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    mesh = bpy.data.meshes.new(path.stem)
    mesh.vertices.add(len(v))
    mesh.vertices.foreach_set("co", v.ravel())
    mesh.loops.add(f.size)
    mesh.loops.foreach_set("vertex_index", f.ravel())
    mesh.polygons.add(len(f))
    mesh.polygons.foreach_set("loop_start", np.arange(0, f.size, 3, dtype=np.int32))
    mesh.update()
    material = bpy.data.materials.new("white")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    return bpy.data.objects.new(path.stem, mesh)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--camera", required=True, help="ex,ey,ez,tx,ty,tz,fov_degrees, in the axes of the file")
    parser.add_argument("--up", choices=("y", "z"), default="z")
    parser.add_argument("--drop", type=int, action="append", default=[], help="leave out triangles of this material id")
    parser.add_argument("--sun", type=float, default=4.0, help="irradiance of the sun [W/m²]")
    parser.add_argument("--world", type=float, default=0.5, help="radiance of the world")
    given = parser.parse_args()
    numbers = [float(n) for n in given.camera.split(",")]
    if len(numbers) != 7:
        sys.exit("--camera takes seven numbers: ex,ey,ez,tx,ty,tz,fov_degrees")

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.collection.objects.link(mesh_object(given.mesh, given.up, given.drop))
    turn = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0))) if given.up == "y" else Matrix.Identity(3)
    eye, target = turn @ Vector(numbers[:3]), turn @ Vector(numbers[3:6])
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.angle, camera.data.clip_start = eye, math.radians(numbers[6]), 1e-3
    camera.rotation_euler = (target - eye).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle = given.sun, math.radians(1)
    sun.rotation_euler = (math.radians(15), math.radians(20), 0)
    for item in (camera, sun):
        scene.collection.objects.link(item)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = given.world
    scene.render.resolution_x = scene.render.resolution_y = 1280
    bpy.ops.wm.save_as_mainfile(filepath=str(given.out.resolve()))


if __name__ == "__main__":
    main()
