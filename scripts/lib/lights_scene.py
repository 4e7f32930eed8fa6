"""A scene with every kind of light, which `make_demo.py --lights` saves.

A sun, a sky, two area lamps of different shapes, a point lamp, a spot, and a picture that glows light a floor, a wall,
a metal ball and a ball of skin. An engine that chooses one light at a time has to choose well here, for each point
another.
"""

import math

import bpy
from mathutils import Vector

from lib.node_trees import with_nodes


def add_surfaces() -> None:
    """Floor, wall, and the two balls."""
    skin = {"Base Color": (0.8, 0.5, 0.4, 1), "Subsurface Weight": 1.0, "Subsurface Scale": 0.1}
    plane, ball = bpy.ops.mesh.primitive_plane_add, bpy.ops.mesh.primitive_uv_sphere_add
    upright = (math.pi / 2, 0, 0)
    for name, add, material, where in (
        ("Floor", plane, _principled("Floor", {"Base Color": (0.6, 0.6, 0.6, 1), "Roughness": 0.8}), {"size": 40}),
        (
            "Wall",
            plane,
            _principled("Wall", {"Base Color": (0.7, 0.6, 0.5, 1)}),
            {"size": 8, "location": (0, 3, 3), "rotation": upright},
        ),
        ("Metal", ball, _principled("Metal", {"Metallic": 1.0, "Roughness": 0.25}), {"location": (-1.3, 0, 1)}),
        ("Skin", ball, _principled("Skin", skin), {"location": (1.3, 0, 1)}),
        ("Picture", plane, picture(), {"size": 1.2, "location": (0, 2.9, 2.5), "rotation": upright}),
    ):
        add(**where)
        made = bpy.context.object
        made.name = name
        made.data.materials.append(material)
        if add is ball:
            made.data.shade_smooth()


def _principled(name: str, values: dict) -> bpy.types.Material:
    material = with_nodes(bpy.data.materials.new(name))
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    for socket, value in values.items():
        inputs[socket].default_value = value
    return material


def picture() -> bpy.types.Material:
    """A chequered material that glows."""
    material = with_nodes(bpy.data.materials.new("Picture"))
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    emission, checker = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeTexChecker")
    emission.inputs["Strength"].default_value = 4.0
    tree.links.new(checker.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], tree.nodes["Material Output"].inputs["Surface"])
    return material


def add_lights() -> None:
    """All kinds of lamps, and a sky."""
    scene = bpy.context.scene
    for kind, energy, place, target, values in (
        ("SUN", 2.0, (3, -4, 6), (0, 0, 0), {"angle": 0.01}),
        ("AREA", 60.0, (-3, -2, 3), (0, 0, 1), {"size": 1.0}),
        ("AREA", 60.0, (3, -2, 3), (0, 0, 1), {"size": 1.2, "shape": "DISK"}),
        ("POINT", 30.0, (0, -1.5, 0.6), (0, 0, 0), {"shadow_soft_size": 0.1}),
        ("SPOT", 150.0, (-4, 1, 4), (-2, 2, 0), {"spot_size": 0.7, "shadow_soft_size": 0.05}),
    ):
        data = bpy.data.lights.new(kind.title(), kind)
        data.energy = energy
        for name, value in values.items():
            setattr(data, name, value)
        lamp = bpy.data.objects.new(data.name, data)
        lamp.location = place
        lamp.rotation_euler = (Vector(target) - lamp.location).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(lamp)
    world = scene.world = with_nodes(bpy.data.worlds.new("Sky"))
    tree = world.node_tree
    background = tree.nodes["Background"]
    background.inputs["Strength"].default_value = 0.05
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs["Color"], background.inputs["Color"])


def add_scene() -> None:
    """Everything, in an empty Blender."""
    add_surfaces()
    add_lights()
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0, -9, 3), (1.35, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
