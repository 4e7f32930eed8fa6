"""Portals of the world: area lamps through which it is sampled, and which give no light."""

import bpy

from tests.blender.features.build import add_world, ball, diffuse, lamp, look, quad, world_graph
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature


def room(shape: str = "RECTANGLE", **lamps) -> bpy.types.Object:
    """A white room with a ball, a window in the wall at x = 2, and a portal in that; returns the portal."""
    white = (0.7, 0.7, 0.7)
    quad("Floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], white)
    quad("Ceiling", [(-2, -2, 2.5), (-2, 2, 2.5), (2, 2, 2.5), (2, -2, 2.5)], white)
    quad("Left", [(-2, -2, 0), (-2, 2, 0), (-2, 2, 2.5), (-2, -2, 2.5)], (0.7, 0.3, 0.2))
    quad("Back", [(-2, 2, 0), (2, 2, 0), (2, 2, 2.5), (-2, 2, 2.5)], white)
    quad("Front", [(-2, -2, 0), (-2, -2, 2.5), (2, -2, 2.5), (2, -2, 0)], white)
    for name, (y0, y1), (z0, z1) in (
        ("Below", (-2, 2), (0, 1)),
        ("Above", (-2, 2), (1.8, 2.5)),
        ("Before", (-2, -0.4), (1, 1.8)),
        ("Behind", (0.4, 2), (1, 1.8)),
    ):
        quad(name, [(2, y0, z0), (2, y1, z0), (2, y1, z1), (2, y0, z1)], white)
    diffuse(ball("Ball", (0, 0.6, 0.6), 0.6), (0.3, 0.4, 0.8))
    portal = lamp("AREA", (2, 0, 1.4), target=(0, 0, 1.4), shape=shape, size=0.8, size_y=0.8, **lamps)
    portal.data.cycles.is_portal = True
    return portal


@feature("Portal: a world of one colour", "World", "picture", samples=384)
def even(scene: bpy.types.Scene) -> None:
    add_world(scene, 20.0, (0.6, 0.75, 1.0))
    room()
    look(scene, (-0.5, -1.7, 1.4), (0, 0.6, 0.9), lens=24)


@feature("Portal: a sky", "World", "picture", samples=384)
def sky(scene: bpy.types.Scene) -> None:
    """A world that varies by direction, with a portal that faces inwards and one that faces outwards."""

    def surface(graph: Graph):
        direction = graph.value("ShaderNodeTexCoord", output="Generated")
        bright = graph.math("MULTIPLY", graph.value("ShaderNodeSeparateXYZ", {0: direction}), 60.0, clamp=False)
        return graph.value(
            "ShaderNodeBackground", {"Color": (0.9, 0.8, 0.6), "Strength": graph.math("MAXIMUM", bright, 5.0)}
        )

    world_graph(scene, surface)
    room("ELLIPSE")
    outwards = lamp("AREA", (2, 0, 1.4), target=(4, 0, 1.4), size=0.8)
    outwards.data.cycles.is_portal = True
    look(scene, (-0.5, -1.7, 1.4), (0, 0.6, 0.9), lens=24)
