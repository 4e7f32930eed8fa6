"""Surfaces that send rays on elsewhere."""

import bpy

from tests.blender.features.build import add_world, ball, diffuse, floor, lamp, look, material_graph, quad
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_mesh


def stage(scene: bpy.types.Scene) -> None:
    """A floor under a sun and a sky, with a red ball, and far off a blue one on a floor of its own."""
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.4)
    floor()
    diffuse(ball("Near", (1.1, 0.6, 0.6), 0.6), (0.8, 0.2, 0.15))
    there = floor(2.0, (0.3, 0.6, 0.3))
    there.location = (20, 1, 0)
    diffuse(ball("Far", (20, 1.5, 0.7), 0.7), (0.15, 0.3, 0.8))
    look(scene, (0, -4.5, 1.6), (0, 0, 0.8), lens=40)


def gate() -> bpy.types.Object:
    """An upright square without material."""
    return add_mesh("Gate", [(-1.2, 0, 0.05), (0.6, 0, 0.05), (0.6, 0, 1.8), (-1.2, 0, 1.8)], [(0, 1, 2, 3)])


@feature("Ray Portal BSDF: position", "Shaders", "picture", quick=True)
def position(scene: bpy.types.Scene) -> None:
    """A gate to a place far off, tinted."""
    stage(scene)

    def surface(graph: Graph):
        here = graph.value("ShaderNodeNewGeometry", output="Position")
        there = graph.vector_math("ADD", here, (20.0, 0.0, 0.0))
        return graph.value("ShaderNodeBsdfRayPortal", {"Color": (0.9, 0.8, 0.7), "Position": there})

    material_graph(gate(), surface)


@feature("Ray Portal BSDF: direction", "Shaders", "picture")
def direction(scene: bpy.types.Scene) -> None:
    """A ball that lets rays go on from where they meet it, along normals of any length."""
    stage(scene)

    def surface(graph: Graph):
        normal = graph.value("ShaderNodeNewGeometry", output="Normal")
        along = graph.vector_math("MULTIPLY", normal, (2.5, 2.5, 2.5))
        return graph.value("ShaderNodeBsdfRayPortal", {"Direction": along})

    material_graph(ball("Portal", (-0.4, -0.6, 0.9), 0.8), surface)


@feature("Ray Portal BSDF: one position, and a direction", "Shaders", "picture")
def place_and_direction(scene: bpy.types.Scene) -> None:
    """Every ray that meets the gate comes out of one point, mirrored."""
    stage(scene)

    def surface(graph: Graph):
        incoming = graph.value("ShaderNodeNewGeometry", output="Incoming")
        mirrored = graph.vector_math("MULTIPLY", incoming, (1.0, -1.0, -1.0))
        place = graph.value("ShaderNodeCombineXYZ", {0: 20.0, 1: -2.0, 2: 1.2})
        return graph.value("ShaderNodeBsdfRayPortal", {"Position": place, "Direction": mirrored})

    material_graph(gate(), surface)


@feature("Ray Portal BSDF: mixed", "Shaders", "picture")
def mixed(scene: bpy.types.Scene) -> None:
    """A gate that is partly diffuse, in front of a lamp; nothing shines through it.

    Mixed with Transparent BSDF, Cycles counts light behind the gate twice: with more of it than without the gate.
    """
    stage(scene)
    lamp("AREA", (-0.3, 1.5, 1.2), target=(-0.3, 0, 0.8), energy=60.0, size=0.6)

    def surface(graph: Graph):
        here = graph.value("ShaderNodeNewGeometry", output="Position")
        there = graph.vector_math("ADD", here, (20.0, 0.0, 0.0))
        portal = graph.value("ShaderNodeBsdfRayPortal", {"Position": there})
        base = graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.7, 0.6, 0.3)})
        return graph.value("ShaderNodeMixShader", {0: 0.6, 1: base, 2: portal})

    material_graph(gate(), surface)


@feature("Ray Portal BSDF: what the ray is like behind it", "Shaders", "picture")
def light_path(scene: bpy.types.Scene) -> None:
    """What is seen through a gate shows how long the ray is there, and how many surfaces it has passed."""
    stage(scene)

    def surface(graph: Graph):
        here = graph.value("ShaderNodeNewGeometry", output="Position")
        return graph.value("ShaderNodeBsdfRayPortal", {"Position": graph.vector_math("ADD", here, (20.0, 0.0, 0.0))})

    def shown(graph: Graph):
        path = graph.node("ShaderNodeLightPath")
        length, passed = (path.outputs[name] for name in ("Ray Length", "Transparent Depth"))
        color = graph.value(
            "ShaderNodeCombineXYZ",
            {0: graph.math("MULTIPLY", length, 0.2), 1: graph.math("MULTIPLY", passed, 0.4), 2: 0.1},
        )
        return graph.value("ShaderNodeEmission", {"Color": color})

    material_graph(gate(), surface)
    wall = quad("Wall", [(17, 4, 0), (23, 4, 0), (23, 4, 3), (17, 4, 3)], (0.5, 0.5, 0.5))
    wall.data.materials.clear()
    material_graph(wall, shown)


@feature("Light Path: Portal Depth", "Inputs", "picture")
def portal_depth(scene: bpy.types.Scene) -> None:
    """A floor and a ball whose colour says how many gates lie before them: none, one, or two behind each other."""
    stage(scene)
    far = ball("Deep", (39.6, 1.2, 0.7), 0.6)

    def by_depth(graph: Graph):
        depth = graph.value("ShaderNodeLightPath", output="Portal Depth")
        color = graph.value("ShaderNodeCombineXYZ", {0: graph.math("MULTIPLY", depth, 0.3), 1: 0.2, 2: 0.6})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color})

    def gate_to(step: float):
        def surface(graph: Graph):
            here = graph.value("ShaderNodeNewGeometry", output="Position")
            return graph.value("ShaderNodeBsdfRayPortal", {"Position": graph.vector_math("ADD", here, (step, 0, 0))})

        return surface

    for obj in [far, *(each for each in bpy.data.objects if each.name.startswith(("Floor", "Far")))]:
        obj.data.materials.clear()
        material_graph(obj, by_depth)
    material_graph(gate(), gate_to(20.0))
    second = gate()
    second.location, second.scale = (20.3, 0.4, 0.2), (0.5, 1.0, 0.6)
    material_graph(second, gate_to(20.0))
