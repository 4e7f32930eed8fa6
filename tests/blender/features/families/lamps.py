"""Lights whose graphs are not constant."""

from __future__ import annotations

import bpy
import numpy as np

from tests.blender.features.build import diffuse, floor, lamp, look, quad, shaded
from tests.blender.features.compare import add_world
from tests.blender.features.graph import Graph
from tests.blender.features.images import image_of, pattern
from tests.blender.features.registry import feature


def lamp_graph(light: bpy.types.Object) -> tuple[Graph, bpy.types.Node]:
    """The graph of a light, and its emission."""
    if bpy.app.version < (5, 0):
        light.data.use_nodes = True
    graph = Graph(light.data.node_tree, light)
    return graph, next(node for node in graph.tree.nodes if node.type == "EMISSION")


def stage(scene: bpy.types.Scene) -> None:
    """A floor and a wall, seen from above."""
    add_world(scene, 0.05)
    floor()
    quad("Wall", [(-4, 1.5, 0), (4, 1.5, 0), (4, 1.5, 4), (-4, 1.5, 4)], (0.4, 0.5, 0.6))
    look(scene, (0, -5, 3), (0, 0, 0.5))


def profile(asymmetric: bool) -> bpy.types.Text:
    """A photometric file: a beam with a ring around it; if `asymmetric`, different on every side."""
    text = bpy.data.texts.new("Lamp.ies")
    if asymmetric:
        vertical, horizontal = range(0, 181, 15), range(0, 361, 30)
        rows = [
            [800 + 600 * np.cos(np.radians(h - 40)) * np.sin(np.radians(v)) + 2 * v for v in vertical]
            for h in horizontal
        ]
    else:
        vertical, horizontal = range(0, 91, 5), (0,)
        rows = [[2000 * np.exp(-((v / 15) ** 2)) + 900 * np.exp(-(((v - 35) / 6) ** 2)) for v in vertical]]
    lines = [" ".join(map(str, each)) for each in (vertical, horizontal)] + [
        " ".join(f"{value:.2f}" for value in row) for row in rows
    ]
    counts = f"1 1000 1.0 {len(vertical)} {len(horizontal)} 1 2 0 0 0"
    text.write("\n".join(["IESNA:LM-63-1995", "TILT=NONE", counts, "1.0 1.0 100", *lines, ""]))
    return text


def _by_profile(kind: str, asymmetric: bool, **values) -> None:
    @feature(f"Light with IES: {kind.lower()}", "Utility", "picture")
    def build(scene: bpy.types.Scene) -> None:
        stage(scene)
        light = lamp(kind, (0.4, 0, 2.2), target=(0, 0.4, 0), energy=2.0, **values)
        light.rotation_euler.rotate_axis("Z", 0.6)
        light.scale = (1.2, 0.9, 1.0)
        graph, emission = lamp_graph(light)
        node = graph.node("ShaderNodeTexIES", {"Strength": 1.5}, mode="INTERNAL")
        node.ies = profile(asymmetric)
        graph.set(emission.inputs["Strength"], node.outputs[0])


_by_profile("POINT", True, shadow_soft_size=0.05)
_by_profile("SPOT", False, shadow_soft_size=0.1, spot_size=1.4, spot_blend=0.2)
_by_profile("AREA", True, shape="DISK", size=0.3)


@feature("Light with a gobo: spot", "Utility", "picture")
def gobo(scene: bpy.types.Scene) -> None:
    stage(scene)
    light = lamp("SPOT", (-0.5, -1, 2.5), target=(0, 0.5, 0), energy=300.0, shadow_soft_size=0.02, spot_size=1.0)
    graph, emission = lamp_graph(light)
    parts = graph.node("ShaderNodeSeparateXYZ", {0: graph.value("ShaderNodeTexCoord", output="Normal")})
    flat = [
        graph.math("MULTIPLY_ADD", graph.math("DIVIDE", parts.outputs[i], parts.outputs[2]), 0.9, 0.5) for i in (0, 1)
    ]
    position = graph.value("ShaderNodeCombineXYZ", {0: flat[0], 1: flat[1]})
    node = graph.node("ShaderNodeTexImage", {"Vector": position}, interpolation="Closest", extension="CLIP")
    node.image = image_of(pattern())
    graph.set(emission.inputs["Color"], node.outputs["Color"])


@feature("Light with an image: spot, its own coordinates", "Utility", "picture")
def spot_image(scene: bpy.types.Scene) -> None:
    stage(scene)
    light = lamp(
        "SPOT",
        (0.5, -1, 2.5),
        target=(0, 0.5, 0),
        energy=300.0,
        shadow_soft_size=0.15,
        use_soft_falloff=False,
        spot_size=1.1,
    )
    graph, emission = lamp_graph(light)
    node = graph.node("ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeNewGeometry", output="Parametric")})
    node.image = image_of(pattern())
    graph.set(emission.inputs["Color"], node.outputs["Color"])


@feature("Light with an image: area, seen and mirrored", "Utility", "picture")
def area_image(scene: bpy.types.Scene) -> None:
    stage(scene)
    shaded(bpy.data.objects["Floor"], "ShaderNodeBsdfAnisotropic", Color=(0.6, 0.6, 0.6, 1), Roughness=0.3)
    light = lamp("AREA", (0, 1.2, 1.2), target=(0, 0, 0.9), energy=40.0, shape="RECTANGLE", size=2.0, size_y=1.0)
    light.visible_camera = True
    graph, emission = lamp_graph(light)
    node = graph.node("ShaderNodeTexImage")  # without link, by the node's own coordinates
    node.image = image_of(pattern())
    graph.set(emission.inputs["Color"], node.outputs["Color"])


@feature("Light with a texture: sphere, seen and inside", "Utility", "picture")
def sphere_texture(scene: bpy.types.Scene) -> None:
    stage(scene)
    for position, radius in (((-1.0, 0, 0.9), 0.5), ((1.4, 0.9, 0.7), 0.9)):  # the wall is inside the second
        light = lamp("POINT", position, energy=40.0, shadow_soft_size=radius, use_soft_falloff=False)
        light.visible_camera = True
        graph, emission = lamp_graph(light)
        coordinates = graph.value("ShaderNodeTexCoord", output="Normal")
        colors = {"Color1": (1, 0.3, 0.1), "Color2": (0.1, 0.4, 1)}
        checks = graph.value("ShaderNodeTexChecker", {"Vector": coordinates, "Scale": 3.1} | colors, "Color")
        graph.set(emission.inputs["Color"], checks)


@feature("Light with a texture: sun", "Utility", "picture")
def sun_texture(scene: bpy.types.Scene) -> None:
    stage(scene)
    light = lamp("SUN", (0, 0, 5), target=(1, 2, 1), energy=3.0, angle=0.7)
    graph, emission = lamp_graph(light)
    position = graph.value("ShaderNodeTexCoord", output="UV")
    graph.set(emission.inputs["Color"], graph.value("ShaderNodeTexGradient", {"Vector": position}, "Color"))
    graph.set(
        emission.inputs["Strength"], graph.value("ShaderNodeLightFalloff", {"Strength": 2.0, "Smooth": 0.5}, "Constant")
    )


@feature("Light Falloff: area and spot, smooth", "Utility", "picture")
def falloff_of_shapes(scene: bpy.types.Scene) -> None:
    stage(scene)
    area = lamp(
        "AREA", (-1.2, -0.3, 1.0), target=(-1.2, 0.5, 0), energy=15.0, shape="ELLIPSE", size=0.8, size_y=0.4, spread=2.0
    )
    spot = lamp("SPOT", (1.2, -0.5, 1.4), target=(1.2, 0.5, 0), energy=40.0, shadow_soft_size=0.2, spot_size=1.2)
    for light, output in ((area, "Linear"), (spot, "Constant")):
        graph, emission = lamp_graph(light)
        graph.set(
            emission.inputs["Strength"], graph.value("ShaderNodeLightFalloff", {"Strength": 1.5, "Smooth": 1.0}, output)
        )


@feature("Light with a texture: through a veil, and without shadow", "Utility", "picture")
def veiled(scene: bpy.types.Scene) -> None:
    stage(scene)
    sheet = quad("Veil", [(-2, -1, 0.8), (0, -1, 0.8), (0, 1, 0.8), (-2, 1, 0.8)], (0.5, 0.5, 0.5))
    shaded(sheet, "ShaderNodeBsdfTransparent", Color=(0.9, 0.6, 0.3, 1))
    diffuse(quad("Shelf", [(0.4, -1, 0.8), (2, -1, 0.8), (2, 1, 0.8), (0.4, 1, 0.8)], (0.5, 0.5, 0.5)), (0.5, 0.3, 0.3))
    for x, shadow in ((-1.0, True), (1.2, False)):
        light = lamp("POINT", (x, 0, 1.8), energy=20.0, shadow_soft_size=0.1)
        light.data.use_shadow = shadow
        graph, emission = lamp_graph(light)
        ray = graph.node("ShaderNodeLightPath")
        graph.set(
            emission.inputs["Strength"], graph.math("ADD", ray.outputs["Ray Length"], ray.outputs["Transparent Depth"])
        )
