"""What paths may do: limits of bounces by kind and switches of caustics, with a ball of glass and one of metal in a
bright corner, and materials whose transparency shadow rays do not see.
"""

import bpy

from tests.blender.features.build import add_world, ball, diffuse, floor, lamp, look, quad, shaded
from tests.blender.features.families.surfaces import veils
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_grid


def corner(scene: bpy.types.Scene) -> None:
    """A floor with a wall behind it, and two balls that throw light on both."""
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    diffuse(floor(), (0.7, 0.6, 0.5))
    quad("Wall", [(-3, 2, 0), (3, 2, 0), (3, 2, 3), (-3, 2, 3)], (0.8, 0.8, 0.8))
    lamp("AREA", (0, -2, 4), target=(0, 0.5, 0.5), energy=150.0, size=2.0)
    shaded(ball("Glass", (-0.8, 0.4, 0.8), 0.8), "ShaderNodeBsdfGlass", Roughness=0.2, IOR=1.45)
    shaded(ball("Metal", (0.9, 0.4, 0.8), 0.8), "ShaderNodeBsdfAnisotropic", Roughness=0.25)
    look(scene, (0, -4.5, 2.0), (0, 0.4, 0.8), lens=45)


def limited(kind: str, count: int) -> None:
    """A feature with `count` bounces of one kind."""

    @feature(f"Bounces: {count} {kind}", "Surface", "picture")
    def build(scene: bpy.types.Scene) -> None:
        corner(scene)
        setattr(scene.cycles, f"{kind}_bounces", count)
        setattr(scene.raybatch, f"{kind}_bounce_max", count)


limited("diffuse", 0)
limited("diffuse", 1)
limited("glossy", 0)
limited("transmission", 1)


def without(kind: str) -> None:
    """A feature without caustics of one kind."""

    @feature(f"Caustics: not {kind}", "Surface", "picture")
    def build(scene: bpy.types.Scene) -> None:
        corner(scene)
        if kind in ("reflective", "reflective or refractive"):
            scene.cycles.caustics_reflective, scene.raybatch.caustics_reflective = False, "OFF"
        if kind in ("refractive", "reflective or refractive"):
            scene.cycles.caustics_refractive, scene.raybatch.caustics_refractive = False, "OFF"


without("reflective or refractive")
without("reflective")
without("refractive")


@feature("Filter Glossy", "Surface", "picture")
def filter_glossy(scene: bpy.types.Scene) -> None:
    """Sharp glass and metal that throw light: roughened to what comes from diffuse surfaces."""
    corner(scene)
    for name in ("Glass", "Metal"):
        node = next(n for n in bpy.data.materials[f"{name} material"].node_tree.nodes if "Roughness" in n.inputs)
        node.inputs["Roughness"].default_value = 0.05
    scene.cycles.blur_glossy = scene.raybatch.filter_glossy = 4.0


@feature("Transparent Shadows off", "Surface", "picture", quick=True)
def opaque_shadow(scene: bpy.types.Scene) -> None:
    """The upper veil blocks the light that is aimed at, the lower one lets it pass; the camera sees through both."""
    veils(scene, sun_angle=0.0)
    bpy.data.objects["Veil 1"].active_material.use_transparent_shadow = False
    veil = add_grid("Even veil", 1)
    veil.location = (-1.2, 0.6, 0.5)
    shaded(veil, "ShaderNodeBsdfTransparent", Color=(0.9, 0.7, 0.5, 1)).active_material.use_transparent_shadow = False


@feature("Transparent Shadows off under an area lamp", "Surface", "picture")
def opaque_shadow_of_lamp(scene: bpy.types.Scene) -> None:
    """Rays that were not aimed at the lamp meet it through the veil all the same, with the share that is theirs."""
    floor()
    veil = add_grid("Veil", 1)
    veil.location, veil.scale = (0, 0, 0.6), (1.2, 1.2, 1)
    shaded(veil, "ShaderNodeBsdfTransparent", Color=(0.9, 0.7, 0.5, 1)).active_material.use_transparent_shadow = False
    lamp("AREA", (0, 0, 2), energy=60.0, size=2.0)
    look(scene, (0, -5, 3.5), (0, 0, 0.4), lens=45)


@feature("Max Bounces of lamps", "Surface", "picture")
def lamps_with_few_bounces(scene: bpy.types.Scene) -> None:
    """Two lamps that light what paths meet first alone, and one that lights one bounce more; what mirrors show of them
    stays, and the share that scattered rays find.
    """
    corner(scene)
    shaded(ball("Mirror", (0.0, -0.6, 0.4), 0.4), "ShaderNodeBsdfAnisotropic", Roughness=0.0)
    bpy.data.objects["Area"].data.cycles.max_bounces = 0
    point = lamp("POINT", (-1.5, -0.5, 1.5), energy=60.0, shadow_soft_size=0.2)
    sun = lamp("SUN", (0, 0, 5), target=(1, 2, 1), energy=1.5, angle=0.3)
    point.data.cycles.max_bounces, sun.data.cycles.max_bounces = 1, 0
    point.visible_camera = True
