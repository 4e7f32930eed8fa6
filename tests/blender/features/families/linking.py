"""Light linking: lights that reach some objects alone, and objects that block some lights alone."""

from __future__ import annotations

import bpy

from tests.blender.features.build import ball, diffuse, floor, lamp, look, quad, shaded
from tests.blender.features.compare import add_world
from tests.blender.features.registry import feature


def collection_of(emitter: bpy.types.Object, what: str, states: dict[bpy.types.Object, str]) -> None:
    """Give `emitter` a collection of what it lights (`what` is "receiver"), or of what blocks it ("blocker")."""
    collection = bpy.data.collections.new(f"{what} of {emitter.name}")
    for obj in states:
        collection.objects.link(obj)
    for obj, linked in zip(collection.objects, collection.collection_objects, strict=True):
        linked.light_linking.link_state = states[obj]
    setattr(emitter.light_linking, f"{what}_collection", collection)


def stage(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Two balls, one of them glossy, before a wall on a floor, below a dim sky."""
    add_world(scene, 0.1)
    objects = {
        "floor": floor(),
        "wall": quad("Wall", [(-4, 1.5, 0), (4, 1.5, 0), (4, 1.5, 4), (-4, 1.5, 4)], (0.4, 0.5, 0.6)),
        "chalk": diffuse(ball("Chalk", (-0.8, 0, 0.6), 0.6), (0.8, 0.3, 0.2)),
        "gloss": shaded(
            ball("Gloss", (0.8, 0, 0.6), 0.6), "ShaderNodeBsdfGlossy", Color=(0.7, 0.8, 0.9, 1), Roughness=0.5
        ),
    }
    look(scene, (0, -5, 2.2), (0, 0, 0.7))
    return objects


def lamps() -> list[bpy.types.Object]:
    """A wide lamp, a small ball of light and a sun."""
    return [
        lamp("AREA", (-1.5, -1.5, 2.5), target=(0, 0, 0.5), energy=120.0, shape="DISK", size=0.8, color=(1, 0.7, 0.5)),
        lamp("POINT", (1.6, -1.2, 1.8), energy=60.0, shadow_soft_size=0.4, color=(0.5, 0.8, 1)),
        lamp("SUN", (0, 0, 5), target=(1, 3, 0), energy=1.0, angle=0.2),
    ]


@feature("Light linking: included", "Light linking", "picture")
def included(scene: bpy.types.Scene) -> None:
    on, (area, point, sun) = stage(scene), lamps()
    collection_of(area, "receiver", {on["chalk"]: "INCLUDE", on["wall"]: "INCLUDE"})
    collection_of(point, "receiver", {on["gloss"]: "INCLUDE", on["floor"]: "INCLUDE"})
    collection_of(sun, "receiver", {on["gloss"]: "INCLUDE", on["wall"]: "INCLUDE"})


@feature("Light linking: excluded", "Light linking", "picture", quick=True)
def excluded(scene: bpy.types.Scene) -> None:
    on, (area, _, sun) = stage(scene), lamps()
    collection_of(area, "receiver", {on["gloss"]: "EXCLUDE", on["floor"]: "EXCLUDE"})
    collection_of(sun, "receiver", {on["chalk"]: "INCLUDE", on["wall"]: "EXCLUDE"})


@feature("Light linking: meshes that emit, and instances", "Light linking", "picture")
def meshes(scene: bpy.types.Scene) -> None:
    on = stage(scene)
    bulb = shaded(ball("Bulb", (0, -0.8, 1.6), 0.25, 16, 8), "ShaderNodeEmission", Color=(1, 0.8, 0.4, 1), Strength=8.0)
    strip = quad("Strip", [(-1.6, 1.2, 1.9), (1.6, 1.2, 1.9), (1.6, 1.2, 2.3), (-1.6, 1.2, 2.3)], (0, 0, 0))
    shaded(strip, "ShaderNodeEmission", Color=(0.4, 0.6, 1, 1), Strength=6.0)
    collection_of(bulb, "receiver", {on["chalk"]: "INCLUDE", on["floor"]: "INCLUDE"})
    collection_of(strip, "receiver", {on["floor"]: "EXCLUDE"})
    again = on["chalk"].copy()  # the mesh is shared
    again.location, again.scale = (0, -1.2, 0.25), (0.4, 0.4, 0.4)
    scene.collection.objects.link(again)


@feature("Shadow linking: blockers", "Light linking", "picture", quick=True)
def blockers(scene: bpy.types.Scene) -> None:
    on, (area, point, sun) = stage(scene), lamps()
    collection_of(area, "blocker", {on["chalk"]: "EXCLUDE"})
    collection_of(point, "blocker", {on["chalk"]: "INCLUDE"})
    collection_of(sun, "blocker", {on["gloss"]: "INCLUDE", on["wall"]: "EXCLUDE"})


@feature("Shadow linking: with light linking, meshes and veils", "Light linking", "picture")
def both(scene: bpy.types.Scene) -> None:
    on = stage(scene)
    bulb = shaded(ball("Bulb", (0, -0.9, 1.7), 0.25, 16, 8), "ShaderNodeEmission", Color=(1, 0.8, 0.4, 1), Strength=9.0)
    veil = shaded(
        quad("Veil", [(-1.6, -0.4, 1.3), (1.6, -0.4, 1.3), (1.6, 0.6, 1.3), (-1.6, 0.6, 1.3)], (0, 0, 0)),
        "ShaderNodeBsdfTransparent",
        Color=(0.5, 0.4, 0.7, 1),
    )
    area = lamp("AREA", (0, 0, 3), target=(0, 0, 0), energy=80.0, shape="DISK", size=0.6)
    collection_of(area, "blocker", {veil: "EXCLUDE", on["gloss"]: "EXCLUDE"})
    collection_of(bulb, "blocker", {on["chalk"]: "EXCLUDE"})
    collection_of(bulb, "receiver", {on["wall"]: "EXCLUDE"})
