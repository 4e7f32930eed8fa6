"""A scene for animations: a landscape with a ball that flies over it."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from lib.node_trees import with_nodes

_BALL_SEGMENTS, _BALL_RINGS = 50, 51  # 5,000 triangles


@dataclass(frozen=True)
class SceneSize:
    """How large a generated scene is."""

    edge: int  # quads along an edge of the landscape
    waves: int = 0  # quads along an edge of a cloth that waves; 0: there is none

    @property
    def triangles(self) -> int:
        """Of all objects together."""
        return 2 * self.edge**2 + 2 * self.waves**2 + 2 * _BALL_SEGMENTS * (_BALL_RINGS - 1)


# `small` is for memory over very many frames: there is also a mesh that Blender makes anew for each of them
SIZES = {"large": SceneSize(edge=706), "small": SceneSize(edge=70, waves=40)}


def make_moving_scene(size: SceneSize, frame_count: int) -> None:
    """Blender's file becomes a new one with the scene alone, which moves in frames 1 to `frame_count`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, frame_count
    _add(scene, _grid("Landscape", size.edge, hilly=True), (0.35, 0.3, 0.2))
    if size.waves:
        cloth = _add(scene, _grid("Cloth", size.waves), (0.2, 0.3, 0.7))
        cloth.scale, cloth.location = (0.3, 0.3, 0.3), (2.0, 2.0, 1.0)
        wave = cloth.modifiers.new("Wave", "WAVE")
        wave.height, wave.width, wave.speed = 0.6, 1.5, 0.25
    _fly(_add(scene, _ball(), (0.8, 0.1, 0.1)), frame_count)
    _add_light_and_camera(scene)


def _add(scene: bpy.types.Scene, mesh: bpy.types.Mesh, color: tuple[float, float, float]) -> bpy.types.Object:
    material = with_nodes(bpy.data.materials.new(mesh.name))
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*color, 1)
    mesh.materials.append(material)
    added = bpy.data.objects.new(mesh.name, mesh)
    scene.collection.objects.link(added)
    return added


def _grid(name: str, edge: int, hilly: bool = False) -> bpy.types.Mesh:
    """A square of `edge` x `edge` quads, 10 m wide."""
    steps = np.linspace(-5, 5, edge + 1)
    y, x = np.meshgrid(steps, steps, indexing="ij")
    z = 0.3 * np.sin(2.1 * x) * np.cos(1.7 * y) + 0.03 * np.sin(23 * x + 17 * y) if hilly else np.zeros_like(x)
    first = (np.arange(edge)[:, None] * (edge + 1) + np.arange(edge)).ravel()
    quads = np.stack([first, first + 1, first + edge + 2, first + edge + 1], 1)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(x.size)
    mesh.vertices.foreach_set("co", np.stack([x, y, z], -1).astype(np.float32).ravel())
    mesh.loops.add(quads.size)
    mesh.loops.foreach_set("vertex_index", quads.astype(np.int32).ravel())
    mesh.polygons.add(len(quads))
    mesh.polygons.foreach_set("loop_start", np.arange(0, quads.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _ball() -> bpy.types.Mesh:
    import bmesh

    built, mesh = bmesh.new(), bpy.data.meshes.new("Ball")
    bmesh.ops.create_uvsphere(built, u_segments=_BALL_SEGMENTS, v_segments=_BALL_RINGS, radius=0.6)
    built.to_mesh(mesh)
    built.free()
    return mesh


def _fly(ball: bpy.types.Object, frame_count: int) -> None:
    for frame, place in ((1, (-3.0, -1.0, 1.2)), (max(2, frame_count), (3.0, 1.0, 1.8))):
        ball.location = place
        ball.keyframe_insert("location", frame=frame)


def _add_light_and_camera(scene: bpy.types.Scene) -> None:
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy = 3.0
    lamp = bpy.data.objects.new("Sun", sun)
    lamp.rotation_euler = (0.7, 0.2, 0.4)
    scene.collection.objects.link(lamp)
    scene.world = with_nodes(bpy.data.worlds.new("Sky"))
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.4, 0.6, 1)
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.location, scene.camera.rotation_euler = (0.0, -11.0, 6.0), (1.1, 0.0, 0.0)
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    scene.render.resolution_percentage = 100
