"""Motion blur: cameras, objects, instances and vertices that move, and how the shutter opens."""

from __future__ import annotations

import math

import bpy
import numpy as np

from tests.blender.features.build import ball, box, floor, lamp, look, material_graph, shaded
from tests.blender.features.compare import add_world
from tests.blender.features.families.curves.strands import tuft
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_grid


def linear(action_owner) -> None:
    """Make all keys of an object or data go along lines."""
    animation = action_owner.animation_data
    action = animation.action
    if hasattr(action, "fcurves"):
        curves = action.fcurves
    else:
        curves = action.layers[0].strips[0].channelbag(animation.action_slot).fcurves
    for curve in curves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
        curve.extrapolation = "LINEAR"


def keyed(owner, name: str, before, after, straight: bool = True) -> None:
    """`owner`'s property `name` is `before` in frame 9 and `after` in frame 11."""
    for frame, value in ((9, before), (11, after)):
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)
    if straight:
        linear(owner)


def stage(scene: bpy.types.Scene, length: float = 1.0) -> None:
    """A floor and a sun, in frame 10 of an animation, with a shutter that is open for `length` frames."""
    add_world(scene, 0.5)
    floor()
    lamp("SUN", (0, 0, 5), target=(1, 2, 0), energy=2.0, angle=0.3)
    look(scene, (0, -5, 2.5), (0, 0, 0.6))
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, length
    scene.frame_set(10)


def blurred(name: str, samples: int = 256, **more):
    """Register a picture of things that move, in frame 10."""

    def enter(build):
        @feature(f"Motion blur: {name}", "Surface", "picture", samples=samples, **more)
        def filled(scene: bpy.types.Scene) -> None:
            build(scene)
            scene.frame_set(10)

        return filled

    return enter


def _position(position: str) -> None:
    @blurred(f"an object that moves, {position.lower()} of frame", quick=position == "CENTER")
    def build(scene: bpy.types.Scene) -> None:
        stage(scene)
        scene.render.motion_blur_position = position
        made = box("Box", (0, 0, 0.6), (1, 1, 1), 0.3, (0.8, 0.3, 0.1))
        keyed(made, "location", (-1.5, 0.5, 0.6), (1.5, -0.5, 1.0))


for _each in ("START", "CENTER", "END"):
    _position(_each)


def _turning(steps: int) -> None:
    @blurred(f"an object that turns and grows, {steps} steps")
    def build(scene: bpy.types.Scene) -> None:
        stage(scene)
        made = box("Box", (0, 0, 0.9), (1.6, 0.3, 1.2), 0, (0.2, 0.5, 0.8))
        made.cycles.motion_steps = steps
        keyed(made, "rotation_euler", (0, 0, 0), (0.6, 2.6, 1.0))
        keyed(made, "scale", (1.6, 0.3, 1.2), (1.0, 0.8, 0.5))


_turning(1)
_turning(3)


@blurred("a camera that moves and zooms", quick=True)
def camera(scene: bpy.types.Scene) -> None:
    stage(scene)
    box("Box", (0.4, 0, 0.6), (1, 1, 1), 0.3, (0.8, 0.3, 0.1))
    ball("Ball", (-0.8, 0.5, 0.5), 0.5)
    view = scene.camera
    turned = view.rotation_euler.copy()
    keyed(view, "location", (-0.5, -5, 2.2), (0.4, -4.6, 2.6))
    keyed(view, "rotation_euler", turned, (turned.x, turned.y + 0.1, turned.z + 0.1))
    keyed(view.data, "lens", 30, 45)


@blurred("a panorama that turns")
def panorama(scene: bpy.types.Scene) -> None:
    stage(scene)
    box("Box", (0.4, 0, 0.6), (1, 1, 1), 0.3, (0.8, 0.3, 0.1))
    view = scene.camera
    view.data.type = "PANO"
    (view.data if hasattr(view.data, "panorama_type") else view.data.cycles).panorama_type = "EQUIRECTANGULAR"
    view.location = (0, -2, 1)
    keyed(view, "rotation_euler", (math.pi / 2, 0, -0.3), (math.pi / 2, 0, 0.3))


@blurred("vertices that move by a shape key, smooth", quick=True)
def shape_key(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = ball("Ball", (0, 0, 1), 1.0)
    shaded(made, "ShaderNodeBsdfDiffuse", Color=(0.3, 0.7, 0.3, 1))
    made.shape_key_add(name="Basis")
    key = made.shape_key_add(name="Long")
    for point in key.data:
        point.co.x *= 1.8
        point.co.z *= 0.5
    key.value = 0.0  # a new key of Blender 5 has 1
    key.keyframe_insert("value", frame=9)
    key.value = 1.0
    key.keyframe_insert("value", frame=11)
    linear(made.data.shape_keys)


@blurred("vertices that move by a modifier, and the object with them")
def modifier(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = box("Box", (0, 0, 0.8), (1, 1, 1.4), 0.2, (0.7, 0.6, 0.2))
    made.modifiers.new("Subdivision", "SUBSURF").subdivision_type = "SIMPLE"
    made.modifiers["Subdivision"].levels = made.modifiers["Subdivision"].render_levels = 3
    twist = made.modifiers.new("Twist", "SIMPLE_DEFORM")
    twist.deform_method, twist.deform_axis = "TWIST", "Z"
    made.cycles.motion_steps = 3
    keyed(twist.id_data, "location", (-0.4, 0, 0.8), (0.4, 0, 0.8))
    for frame, angle in ((9, 0.0), (11, 2.0)):
        twist.angle = angle
        twist.keyframe_insert("angle", frame=frame)
    linear(made)


@blurred("vertices with a velocity")
def velocity(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = box("Box", (0, 0, 0.8), (1, 1, 1), 0.2, (0.7, 0.6, 0.2))
    made.modifiers.new("Triangles", "TRIANGULATE")
    attribute = made.data.attributes.new("velocity", "FLOAT_VECTOR", "POINT")
    values = np.array([(24 * vertex.co.z, 0, 6 * vertex.co.x) for vertex in made.data.vertices], np.float32)
    attribute.data.foreach_set("vector", values.ravel())


def _textured(name: str, output: str, deforms: bool) -> None:
    @blurred(name)
    def build(scene: bpy.types.Scene) -> None:
        stage(scene)
        made = ball("Ball", (0, 0, 1), 0.9)

        def surface(graph):
            coordinates = graph.value("ShaderNodeTexCoord", output=output)
            color = graph.value("ShaderNodeTexChecker", {"Vector": coordinates, "Scale": 4.0}, output="Color")
            bump = graph.value("ShaderNodeBump", {"Height": graph.value("ShaderNodeTexNoise", {"Vector": coordinates})})
            return graph.value("ShaderNodeBsdfDiffuse", {"Color": color, "Normal": bump})

        material_graph(made, surface)
        if deforms:
            squash = made.modifiers.new("Squash", "SIMPLE_DEFORM")
            squash.deform_method, squash.deform_axis = "STRETCH", "Z"
            for frame, factor in ((9, -0.4), (11, 0.8)):
                squash.factor = factor
                squash.keyframe_insert("factor", frame=frame)
            linear(made)
        else:
            keyed(made, "rotation_euler", (0, 0, 0), (0.3, 0.5, 1.2))
            keyed(made, "scale", (1, 1, 1), (1.3, 0.8, 1.0))


_textured("object coordinates and bumps of what turns", "Object", False)
_textured("generated coordinates of what turns", "Generated", False)
_textured("generated coordinates of what deforms", "Generated", True)


@blurred("a mirror that deforms, smooth", samples=512)
def mirror(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = ball("Ball", (0, 0, 1), 1.0, segments=12, rings=6)
    shaded(made, "ShaderNodeBsdfAnisotropic", Color=(0.9, 0.9, 0.9, 1), Roughness=0.2)
    box("Box", (-1.8, 0.6, 0.5), (0.8, 0.8, 1.0), 0.2, (0.9, 0.2, 0.1))
    stretch = made.modifiers.new("Stretch", "SIMPLE_DEFORM")
    stretch.deform_method, stretch.deform_axis = "BEND", "Z"
    for frame, angle in ((9, 0.0), (11, 1.5)):
        stretch.angle = angle
        stretch.keyframe_insert("angle", frame=frame)
    linear(made)


@blurred("instances that move", quick=True)
def instances(scene: bpy.types.Scene) -> None:
    stage(scene)
    part = box("Part", (0, 0, 0), (0.4, 0.4, 0.4), 0.3, (0.3, 0.3, 0.8))
    group = bpy.data.collections.new("Group")
    scene.collection.objects.unlink(part) if part.name in scene.collection.objects else None
    group.objects.link(part)
    for i in range(4):
        placed = bpy.data.objects.new(f"Placed {i}", None)
        placed.instance_type, placed.instance_collection = "COLLECTION", group
        scene.collection.objects.link(placed)
        keyed(placed, "location", (i - 2, 0, 0.3), (i - 1.2, 0.3 * i, 0.6 + 0.2 * i))
        keyed(placed, "rotation_euler", (0, 0, 0), (0, i * 0.8, 0))


@blurred("a shutter with a curve")
def curve(scene: bpy.types.Scene) -> None:
    stage(scene)
    mapping = scene.render.motion_blur_shutter_curve
    points = mapping.curves[0].points
    points[0].location, points[-1].location = (0, 1), (1, 0)
    mapping.update()
    made = box("Box", (0, 0, 0.6), (0.6, 0.6, 0.6), 0.3, (0.8, 0.3, 0.1))
    keyed(made, "location", (-2.5, 0.5, 0.6), (2.5, -0.5, 1.0))


def _rolling(duration: float) -> None:
    @blurred(f"rolling shutter, {duration:g} of the time", quick=duration > 0)
    def build(scene: bpy.types.Scene) -> None:
        stage(scene)
        scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", duration
        made = box("Box", (0, 0, 0.9), (0.8, 0.8, 1.8), 0.3, (0.8, 0.3, 0.1))
        keyed(made, "location", (-2, 0, 0.9), (2, 0, 0.9))


_rolling(0.0)
_rolling(0.3)


@blurred("objects that are told to stand still")
def still(scene: bpy.types.Scene) -> None:
    stage(scene)
    for x in (-0.8, 0.8):
        made = box("Box", (x, 0, 0.6), (0.7, 0.7, 0.7), 0.3, (0.8, 0.3, 0.1))
        made.cycles.use_motion_blur = x > 0
        keyed(made, "location", (x - 0.7, 0, 0.6), (x + 0.7, 0, 0.9))


@blurred("a light of triangles that moves", samples=512)
def emitter(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = ball("Lamp", (0, 0, 1.2), 0.5, smooth=False)
    shaded(made, "ShaderNodeEmission", Color=(1, 0.6, 0.3, 1), Strength=5.0)
    keyed(made, "location", (-1.5, 0, 1.0), (1.5, 0, 1.6))


@blurred("a lamp that moves")
def moving_lamp(scene: bpy.types.Scene) -> None:
    stage(scene)
    box("Box", (0.4, 0, 0.6), (1, 1, 1), 0.3, (0.8, 0.3, 0.1))
    light = lamp("POINT", (0, 0, 2), energy=200.0, shadow_soft_size=0.1)
    keyed(light, "location", (-1.5, -1, 2.0), (1.5, -1, 2.4))


@blurred("subsurface scattering and glass that move", samples=512)
def volumes(scene: bpy.types.Scene) -> None:
    stage(scene)
    wax = ball("Wax", (-0.9, 0, 0.7), 0.7)
    shaded(wax, "ShaderNodeSubsurfaceScattering", Color=(0.9, 0.5, 0.3, 1), Scale=0.3)
    keyed(wax, "location", (-1.4, 0, 0.7), (-0.4, 0, 0.9))
    glass = ball("Glass", (0.9, 0, 0.7), 0.6)
    shaded(glass, "ShaderNodeBsdfGlass", Roughness=0.3)
    keyed(glass, "location", (0.9, 0, 0.7), (0.9, 0.4, 1.4))


@blurred("hair on what deforms", samples=256, quick=True)
def hair(scene: bpy.types.Scene) -> None:
    stage(scene)
    ground = add_grid("Emitter", 6)
    shaded(ground, "ShaderNodeBsdfDiffuse", Color=(0.3, 0.6, 0.2, 1))
    twist = ground.modifiers.new("Twist", "SIMPLE_DEFORM")
    twist.deform_method, twist.deform_axis = "TWIST", "Z"
    for frame, angle in ((9, 0.0), (11, 1.2)):
        twist.angle = angle
        twist.keyframe_insert("angle", frame=frame)
    linear(ground)
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 60, 1.0
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.4, 0.08
    keyed(ground, "location", (-0.3, 0, 0.02), (0.3, 0, 0.02))


@blurred("strands with a velocity", samples=256)
def strands(scene: bpy.types.Scene) -> None:
    stage(scene)
    made = tuft(count=40, radius=0.05)
    material_graph(made, lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.5, 0.3, 1)}))
    points = np.empty(3 * len(made.data.position_data), np.float32)
    made.data.position_data.foreach_get("vector", points)
    values = np.zeros((len(points) // 3, 3), np.float32)
    values[:, 0] = 18 * points.reshape(-1, 3)[:, 2]
    made.data.attributes.new("velocity", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", values.ravel())
