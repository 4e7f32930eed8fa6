"""Objects to put into a scene."""

from __future__ import annotations

import bmesh
import bpy
from mathutils import Vector

from tests.blender.features.compare import add_world
from tests.blender.features.graph import Graph
from tests.support.blender_builders import add_grid, add_mesh, add_object, material_of, node_tree


def shaded(obj: bpy.types.Object, kind: str, distribution: str | None = None, **inputs) -> bpy.types.Object:
    """`obj` with a material of one shader node; inputs by name, with _ for a space."""
    tree, surface = node_tree(material_of(obj, f"{obj.name} material"))
    node = tree.nodes.new(kind)
    if distribution is not None:
        node.distribution = distribution
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], surface)
    return obj


def material_graph(obj: bpy.types.Object, build) -> bpy.types.Object:
    """`obj` with a material whose surface is the shader that `build(graph)` returns."""
    material = material_of(obj, f"{obj.name} material")
    tree, surface = node_tree(material)
    graph = Graph(tree, obj)
    graph.set(surface, build(graph))
    return obj


def world_graph(scene: bpy.types.Scene, build) -> bpy.types.World:
    """A new world whose surface is the shader that `build(graph)` returns."""
    world = add_world(scene, 1.0)
    tree = world.node_tree
    tree.nodes.clear()
    graph = Graph(tree)
    graph.set(tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"], build(graph))
    return world


def studio(scene: bpy.types.Scene, build=None, smooth: bool = True, world: float = 0.6) -> bpy.types.Object:
    """A ball over a floor under a wide sun and a pale sky.

    The ball has the shader that `build(graph)` returns; returns the ball.
    """
    add_world(scene, world, (0.6, 0.75, 1.0))
    floor()
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)
    made = ball("Ball", (0, 0, 1), 1.0, segments=32, rings=16, smooth=smooth)
    if build is not None:
        material_graph(made, build)
    look(scene, (0, -4.5, 2.2), (0, 0, 0.85), lens=50)
    return made


def diffuse(obj: bpy.types.Object, color) -> bpy.types.Object:
    """`obj` with a diffuse material."""
    return shaded(obj, "ShaderNodeBsdfDiffuse", Color=(*color, 1))


def principled(obj: bpy.types.Object, color, **inputs) -> bpy.types.Object:
    """`obj` with Blender's standard material."""
    return shaded(obj, "ShaderNodeBsdfPrincipled", Base_Color=(*color, 1), **inputs)


def quad(name: str, corners, color) -> bpy.types.Object:
    """One diffuse face."""
    return diffuse(add_mesh(name, corners, [(0, 1, 2, 3)]), color)


def box(name: str, position, size, turn: float, color) -> bpy.types.Object:
    """A diffuse box, turned about the vertical axis."""
    h = 0.5
    corners = [(x, y, z) for x in (-h, h) for y in (-h, h) for z in (-h, h)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    obj = add_mesh(name, corners, faces)
    obj.location, obj.scale, obj.rotation_euler.z = position, size, turn
    return diffuse(obj, color)


def ball(
    name: str, position, radius: float, segments: int = 32, rings: int = 16, smooth: bool = True
) -> bpy.types.Object:
    """A UV sphere with UV coordinates."""
    mesh = bpy.data.meshes.new(name)
    shape = bmesh.new()
    shape.loops.layers.uv.verify()
    bmesh.ops.create_uvsphere(shape, u_segments=segments, v_segments=rings, radius=radius, calc_uvs=True)
    for face in shape.faces:
        face.smooth = smooth
    shape.to_mesh(mesh)
    shape.free()
    obj = add_object(name, mesh)
    obj.location = position
    return obj


def look(scene: bpy.types.Scene, eye, target, lens: float = 35.0) -> None:
    """Aim the scene's camera."""
    camera = scene.camera
    camera.location, camera.data.lens = eye, lens
    camera.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y").to_euler()


def lamp(kind: str, position, target=None, **values) -> bpy.types.Object:
    """A new light of `kind`, with its properties."""
    data = bpy.data.lights.new(kind.title(), kind)
    for name, value in values.items():
        setattr(data, name, value)
    obj = add_object(data.name, data)
    obj.location = position
    if target is not None:
        obj.rotation_euler = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_euler()
    return obj


def floor(size: float = 8.0, color=(0.5, 0.4, 0.3)) -> bpy.types.Object:
    """A diffuse square at z = 0."""
    obj = add_grid("Floor", 1)
    obj.scale = (size, size, 1)
    return diffuse(obj, color)
