"""Make the demo scene: python scripts/make_demo.py [--lights] OUT.blend (needs bpy).

A still life made with Blender's own tools: mesh primitives, modifiers (bevel, subdivision, array), collection
instances and a Suzanne; glass, metal, rough and emissive materials; an area light and a tinted world. With --lights
another scene is made: a few surfaces under every kind of light.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
from lib.lights_scene import add_scene
from lib.node_trees import with_nodes
from lib.output import leave
from mathutils import Vector

import raybatch_addon
from raybatch_addon.core.files import whole_file

RESOLUTION = (960, 540)
SAMPLE_COUNT = 32


def principled(name, color, roughness, metallic=0.0, ior=1.5):
    """A material of one Principled BSDF."""
    material = with_nodes(bpy.data.materials.new(name))
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*color, 1.0)
    inputs["Roughness"].default_value = roughness
    inputs["Metallic"].default_value = metallic
    inputs["IOR"].default_value = ior
    return material


def node_material(name, *shaders, mix=0.5):
    """A material of one shader node, or of two and a Mix node; a shader is (node type, {input: value})."""
    material = with_nodes(bpy.data.materials.new(name))
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    made = []
    for kind, values in shaders:
        node = tree.nodes.new(kind)
        for key, value in values.items():
            node.inputs[key].default_value = value
        made.append(node)
    surface = made[0]
    if len(made) == 2:
        surface = tree.nodes.new("ShaderNodeMixShader")
        surface.inputs[0].default_value = mix
        tree.links.new(made[0].outputs[0], surface.inputs[1])
        tree.links.new(made[1].outputs[0], surface.inputs[2])
    tree.links.new(surface.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def materials():
    """Every material of the scene by name."""
    return {
        "floor": principled("Floor", (0.20, 0.19, 0.21), 0.5),
        "gold": principled("Brushed gold", (1.0, 0.62, 0.26), 0.28, metallic=1.0),
        "steel": principled("Polished steel", (0.80, 0.83, 0.88), 0.06, metallic=1.0),
        "teal": principled("Teal glaze", (0.012, 0.16, 0.19), 0.12),
        "coral": principled("Coral clay", (0.72, 0.11, 0.055), 0.65),
        "stone": node_material(
            "Rough stone",
            ("ShaderNodeBsdfDiffuse", {"Color": (0.55, 0.50, 0.45, 1), "Roughness": 0.0}),
            ("ShaderNodeBsdfGlossy", {"Color": (0.9, 0.85, 0.8, 1), "Roughness": 0.35}),
            mix=0.12,
        ),
        "glass": node_material(
            "Clear glass", ("ShaderNodeBsdfGlass", {"Color": (0.97, 0.99, 1, 1), "IOR": 1.5, "Roughness": 0.0})
        ),
        "amber": node_material(
            "Frosted amber", ("ShaderNodeBsdfGlass", {"Color": (1, 0.62, 0.28, 1), "IOR": 1.45, "Roughness": 0.12})
        ),
        "neon": node_material("Neon", ("ShaderNodeEmission", {"Color": (1.0, 0.2, 0.05, 1), "Strength": 5.0})),
        "neon_blue": node_material(
            "Blue lamp", ("ShaderNodeEmission", {"Color": (0.06, 0.3, 1.0, 1), "Strength": 7.0})
        ),
    }


def finish(name, material, smooth=True, collection=None):
    """Name the object that an operator just added, give it its material and, if asked, another collection."""
    thing = bpy.context.object
    thing.name = thing.data.name = name
    thing.data.materials.append(material)
    if smooth:
        thing.data.polygons.foreach_set("use_smooth", [True] * len(thing.data.polygons))
    if collection is not None:
        for owner in thing.users_collection:
            owner.objects.unlink(thing)
        collection.objects.link(thing)
    return thing


def bevelled(thing, width, segments=4):
    """Round the edges of `thing`."""
    modifier = thing.modifiers.new("Bevel", "BEVEL")
    modifier.width, modifier.segments = width, segments
    modifier.harden_normals = True
    modifier.limit_method = "ANGLE"
    return thing


def add_studio(mats):
    """Floor and wall in one sweep: an L-profile whose corner a bevel modifier rounds."""
    mesh = bpy.data.meshes.new("Backdrop")
    w, front, back, top = 14.0, -9.0, 4.2, 9.0
    vertices = [(-w, front, 0), (w, front, 0), (w, back, 0), (-w, back, 0), (w, back, top), (-w, back, top)]
    mesh.from_pydata(vertices, [], [(0, 1, 2, 3), (3, 2, 4, 5)])
    mesh.materials.append(mats["floor"])
    mesh.polygons.foreach_set("use_smooth", [True, True])
    backdrop = bpy.data.objects.new("Backdrop", mesh)
    bpy.context.scene.collection.objects.link(backdrop)
    modifier = backdrop.modifiers.new("Bevel", "BEVEL")
    modifier.width, modifier.segments = 3.0, 24


def add_centre(mats):
    """Suzanne on her pedestal, before a ring of light."""
    for radius, depth, z, material in ((1.15, 0.22, 0.11, "stone"), (0.92, 0.16, 0.30, "teal")):
        bpy.ops.mesh.primitive_cylinder_add(vertices=96, radius=radius, depth=depth, location=(0, 0, z))
        bevelled(finish("Pedestal", mats[material]), 0.03)
    bpy.ops.mesh.primitive_monkey_add(
        size=1.75, location=(0, -0.1, 1.22), rotation=(math.radians(-9), 0, math.radians(16))
    )
    suzanne = finish("Suzanne", mats["gold"])
    subdivision = suzanne.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    bpy.ops.mesh.primitive_torus_add(
        major_segments=160,
        minor_segments=24,
        major_radius=1.36,
        minor_radius=0.05,
        location=(0, 0.9, 1.5),
        rotation=(math.radians(90), 0, 0),
    )
    finish("Ring of light", mats["neon"])


def add_sides(mats):
    """A twisted tower of slabs on one side, glass on the other."""
    bpy.ops.object.empty_add(location=(2.35, 0.35, 0.09 + 0.185), rotation=(0, 0, math.radians(8.5)))
    turn = bpy.context.object
    turn.name = "Turn of the tower"
    bpy.ops.mesh.primitive_cube_add(size=1, location=(2.35, 0.35, 0.09))
    slab = finish("Tower", mats["coral"])
    slab.scale = (0.86, 0.86, 0.16)
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    bevelled(slab, 0.035)
    array = slab.modifiers.new("Array", "ARRAY")
    array.count, array.use_relative_offset, array.use_object_offset = 13, False, True
    array.offset_object = turn

    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=0.72, location=(-2.0, -0.45, 0.72))
    finish("Glass ball", mats["glass"])
    bpy.ops.mesh.primitive_cylinder_add(
        vertices=6, radius=0.42, depth=1.9, location=(-2.95, 0.95, 0.95), rotation=(0, 0, 0.3)
    )
    bevelled(finish("Amber column", mats["amber"], smooth=False), 0.05)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.36, location=(1.35, -1.15, 0.36))
    finish("Steel ball", mats["steel"])
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.05, depth=3.4, location=(3.65, 1.9, 1.7))
    bevelled(finish("Blue lamp", mats["neon_blue"]), 0.04)


def add_pebbles(mats):
    """A collection of three small things, placed many times as collection instances."""
    collection = bpy.data.collections.new("Pebbles")
    for name, material, radius, place in (
        ("Gold pebble", "gold", 0.085, (0, 0, 0.085)),
        ("Coral pebble", "coral", 0.06, (0.17, 0.05, 0.06)),
        ("Glass pebble", "glass", 0.075, (0.05, -0.18, 0.075)),
    ):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=radius, location=place)
        finish(name, mats[material], collection=collection)
    golden_angle = math.pi * (3 - math.sqrt(5))
    number = 0
    for k in range(60):  # a sunflower spiral around the pedestal, thinned where other things stand
        radius, angle = 0.42 * math.sqrt(k + 9), k * golden_angle
        place = Vector((radius * math.cos(angle), radius * math.sin(angle) - 0.6, 0))
        taken = ((0, 0, 1.4), (-2.0, -0.45, 1.0), (2.35, 0.35, 1.0), (-2.75, 0.95, 0.7), (1.35, -1.15, 0.6))
        if any((place - Vector((x, y, 0))).length < r for x, y, r in taken) or place.y > 1.6:
            continue
        instance = bpy.data.objects.new(f"Pebbles {number}", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", collection
        instance.location, instance.rotation_euler = place, (0, 0, 2.1 * k)
        instance.scale = [0.8 + 0.5 * ((k * 0.618) % 1)] * 3
        bpy.context.scene.collection.objects.link(instance)
        number += 1


def add_light_and_camera():
    """A soft box from the upper left, a warm fill from the front, a dusky world, and a camera with a little depth of
    field.
    """
    scene = bpy.context.scene
    for name, place, size, energy, color in (
        ("Soft box", (-4.2, -3.6, 5.2), (3.2, 2.2), 400.0, (1.0, 0.93, 0.84)),
        ("Fill", (2.6, -8.5, 3.4), (5.0, 3.2), 190.0, (1.0, 0.80, 0.66)),
    ):
        data = bpy.data.lights.new(name, "AREA")
        data.shape, data.energy, data.color = "RECTANGLE", energy, color
        data.size, data.size_y = size
        light = bpy.data.objects.new(name, data)
        light.location = place
        light.rotation_euler = (Vector((0, 0, 1.0)) - light.location).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(light)

    world = with_nodes(bpy.data.worlds.new("Dusk"))
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.16, 0.24, 0.46, 1)
    background.inputs["Strength"].default_value = 0.45
    scene.world = world

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.5, -8.8, 2.5)
    camera.rotation_euler = (Vector((0.12, 0, 1.22)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 47
    camera.data.dof.use_dof = True
    camera.data.dof.focus_object = bpy.data.objects["Suzanne"]
    camera.data.dof.aperture_fstop = 1.8
    scene.collection.objects.link(camera)
    scene.camera = camera


def make_demo() -> None:
    """Build the demo in an empty Blender."""
    mats = materials()
    add_studio(mats)
    add_centre(mats)
    add_sides(mats)
    add_pebbles(mats)
    add_light_and_camera()
    bpy.context.scene.raybatch.clamp_indirect = 4.0  # takes the sparks out of the glass's caustics


def save(add: Callable[[], None], path: Path) -> None:
    """Let `add` build a scene in an empty Blender, and save it at `path`, whole or not at all."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    raybatch_addon.register()
    add()
    scene = bpy.context.scene
    scene.render.engine = "RAYBATCH"
    scene.render.resolution_x, scene.render.resolution_y = RESOLUTION
    scene.render.image_settings.file_format = "PNG"
    scene.raybatch.sample_count = SAMPLE_COUNT
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), check_existing=False, compress=True)


if __name__ == "__main__":
    named = [each for each in sys.argv[1:] if each != "--lights"]
    if len(named) != 1 or not named[0].endswith(".blend"):
        sys.exit("usage: make_demo.py [--lights] OUT.blend")
    save(add_scene if "--lights" in sys.argv else make_demo, Path(named[0]).absolute())
    leave(0)
