"""Small things to put into a scene."""

import warnings

import bpy
import numpy as np

from raybatch_addon.export.scene import export_scene


def add_mesh(name, vertices, faces, scene=None):
    """An object with a new mesh, linked to the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    return add_object(name, mesh, scene)


def add_object(name, data, scene=None):
    """A new object of `data`, linked to the scene."""
    obj = bpy.data.objects.new(name, data)
    (scene or bpy.context.scene).collection.objects.link(obj)
    return obj


def add_triangle(name="Triangle"):
    """One triangle in the plane z = 0."""
    return add_mesh(name, [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])


def add_grid(name, edge):
    """`edge` x `edge` squares from -1 to 1 in the plane z = 0."""
    steps = np.linspace(-1, 1, edge + 1)
    x, y = np.meshgrid(steps, steps)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    corner = (np.arange(edge)[:, None] * (edge + 1) + np.arange(edge)).ravel()
    faces = np.stack([corner, corner + 1, corner + edge + 2, corner + edge + 1], 1)
    return add_mesh(name, vertices.tolist(), faces.tolist())


def add_moving_grids():
    """A grid that waves with time, and one that moves by keyframes."""
    waves, moving = add_grid("Waves", 6), add_grid("Moving", 3)
    wave = waves.modifiers.new("Wave", "WAVE")
    wave.height, wave.speed = 0.4, 0.2
    for number in (1, 5):
        moving.location = (number / 4, 0, 0.5)
        moving.keyframe_insert("location", frame=number)
    return waves, moving


def saved_for_cpu(scene, folder):
    """The file, with a world, that renders `scene` on the CPU, in a new folder inside `folder`."""
    scene.world = bpy.data.worlds.new("World")
    scene.raybatch.device = "cpu"
    path = folder / "scene" / "a.blend"
    path.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def exported():
    """The current scene as the core gets it."""
    return export_scene(bpy.context.evaluated_depsgraph_get())


def node_tree(block):
    """The empty node tree of a material, with its output; returns (tree, output's Surface socket)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # needed up to 4.5, always on from 5.0
        block.use_nodes = True
    tree = block.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    return tree, output.inputs["Surface"]


def material_of(obj, name="Material"):
    """A new material in the first slot of `obj`."""
    material = bpy.data.materials.new(name)
    obj.data.materials.append(material)
    return material
