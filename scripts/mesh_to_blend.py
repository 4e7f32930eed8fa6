"""Make a .blend of bare geometry, so that other engines can render it too. Needs bpy.

python scripts/mesh_to_blend.py MESH OUT.blend --camera ex,ey,ez,tx,ty,tz,fov [--up y]
    under a sun and a constant world
python scripts/mesh_to_blend.py MESH OUT.blend --stage [--up y]
    on a floor, under one area light, seen from the front

MESH is geometry as `scripts/render.py` takes it: .obj, .ply, .gltf, .glb, or an .npz that holds `v` float32 [n, 3], `f`
int32 [m, 3] and perhaps `m` [m], a material id a triangle. Everything is diffuse and white.
"""

import argparse
import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import UsageError, exit_code
from lib.geometry_files import read_mesh
from lib.node_trees import with_nodes
from rendering.imported import UP_DEFAULT, import_objects, up_axis

from raybatch_addon.core.errors import RayBatchError, SceneError

ERRORS = (RayBatchError, OSError)


def triangles_of(path: Path, up: str, drop: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of a file, float32 [n, 3], turned so that z is up, and its triangles, int32 [m, 3], without those of the
    materials `drop`. `up`: the axis that the file has up. Uses the open scene.
    """
    suffix = path.suffix.lower()
    if suffix not in (".npz", *UP_DEFAULT):
        raise UsageError(f"{path} cannot be read: convert it to one of .npz, {', '.join(UP_DEFAULT)}")
    if not path.is_file():
        raise SceneError(f"there is no file {path}")
    if suffix != ".npz":
        if drop:
            raise UsageError("--drop names materials of an .npz, whose array m numbers them")
        return imported_triangles(path, up)
    mesh, _ = read_mesh(path)
    v, f = mesh.positions, mesh.triangles
    if drop:
        with np.load(path) as arrays:
            if "m" not in arrays:
                raise UsageError(f"{path} has no array m, so that --drop names no materials")
            f = f[~np.isin(arrays["m"], drop)]
        if not len(f):
            raise UsageError(f"{path}: --drop leaves no triangles")
    return (v[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32) if up == "y" else v), f


def imported_triangles(path: Path, up: str) -> tuple[np.ndarray, np.ndarray]:
    """The same of a file that Blender's importers read, whose objects are removed again."""
    import_objects(path, up)
    bpy.context.view_layer.update()
    vertices, triangles, count = [], [], 0
    for thing in [each for each in bpy.context.scene.objects if each.type == "MESH"]:
        data = thing.data
        data.calc_loop_triangles()
        v, f = np.zeros(3 * len(data.vertices), np.float32), np.zeros(3 * len(data.loop_triangles), np.int32)
        data.vertices.foreach_get("co", v)
        data.loop_triangles.foreach_get("vertices", f)
        matrix = np.array(thing.matrix_world)
        used, found = np.unique(f, return_inverse=True)  # the camera is placed by vertices of faces alone
        corners = found.reshape(-1, 3).astype(np.int32) + count
        vertices.append((v.reshape(-1, 3)[used] @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32))
        triangles.append(corners if np.linalg.det(matrix[:3, :3]) >= 0 else corners[:, ::-1])
        count += len(used)
    if not any(map(len, triangles)):
        raise SceneError(f"{path} has no faces to render; is it damaged?")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return np.concatenate(vertices), np.concatenate(triangles)


def mesh_object(name: str, v: np.ndarray, f: np.ndarray, flat: bool) -> bpy.types.Object:
    """An object of the vertices `v` and triangles `f`; normals are interpolated, but for `flat`."""
    mesh = bpy.data.meshes.new(name)
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
    return bpy.data.objects.new(name, mesh)


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
    parser.add_argument(
        "--up", choices=("y", "z"), help="the axis of the file that points up (default: z for .npz and .ply, else y)"
    )
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
    given.up = up_axis(given.mesh, given.up)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    v, f = triangles_of(given.mesh, given.up, given.drop)
    scene = bpy.context.scene
    placed = mesh_object(given.mesh.stem, v, f, given.flat)
    scene.collection.objects.link(placed)
    if given.stage:
        on_a_stage(scene, placed)
    else:
        under_the_sky(scene, given)
    scene.render.resolution_x = scene.render.resolution_y = 1280
    given.out.absolute().parent.mkdir(parents=True, exist_ok=True)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(given.out.resolve()))
    except RuntimeError as error:  # as Blender reports what it cannot write
        raise OSError(str(error).removeprefix("Error:").strip()) from error
    return 0


if __name__ == "__main__":
    sys.exit(main())
