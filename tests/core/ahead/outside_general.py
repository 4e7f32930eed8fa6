"""Scenes that the general tier has no code for: kernels are specialised on them, and their first renders wait."""

from __future__ import annotations

import dataclasses

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.description import (
    ClosureKind,
    Frame,
    Grid,
    Image,
    ImageEncoding,
    Material,
    Scene,
    Volume,
)
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.core.wavefront.tier import GENERAL_CLOSURES_MOST
from tests.stability.volume_scenes import boxed
from tests.support.feature_scenes import furry, lit, shiny


def of_program(builder: ProgramBuilder, *kinds: ClosureKind) -> Material:
    """A material of closures of `kinds`, which `builder` makes."""
    return Material("of a program", kinds=kinds, program=builder.finish())


def textured() -> Scene:
    """Diffuse surfaces with an image."""
    builder = ProgramBuilder()
    place = (0, Interpolation.LINEAR, Extension.REPEAT, Projection.FLAT, 0)
    color, _ = builder.value("image", *place, builder.value("uv", -1, 0))
    builder.closure("diffuse", color, builder.value("normals")[0])
    scene = lit(of_program(builder, ClosureKind.DIFFUSE, ClosureKind.OWN_NORMAL))
    squares = np.full((8, 8, 1), 128, np.uint8)
    return dataclasses.replace(scene, images=(Image("grey", squares, ImageEncoding.LINEAR),))


def counting_portals() -> Material:
    """Shines by the number of portals on the way."""
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("splat", builder.value("portal_depth")))
    return of_program(builder, ClosureKind.EMISSION)


def faceted_hair() -> Material:
    """Fibres of facets."""
    builder = ProgramBuilder()
    builder.closure("facet_hair", (0.3,) * 3, (0.5,) * 3, 0.3, 0.8, 1.55, 0.03, (1.0,) * 3, (0.0,) * 3)
    return of_program(builder, ClosureKind.FACET_HAIR, ClosureKind.TRANSPARENT)


def many_closures() -> Material:
    """More of them than there is room for."""
    builder = ProgramBuilder()
    for _ in range(GENERAL_CLOSURES_MOST + 1):
        builder.closure("diffuse", (0.01,) * 3, builder.value("normals")[0])
    return of_program(builder, ClosureKind.DIFFUSE, ClosureKind.OWN_NORMAL)


def many_registers() -> Material:
    """A program that has more of them."""
    material = counting_portals()
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("object_coordinates", 0))
    return dataclasses.replace(material, program=dataclasses.replace(builder.finish(), register_count=65))


def smooth_grid() -> Scene:
    """A volume whose grid is read by splines."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("volume_attribute_cubic", 0, 0.0)[0])
    scene = boxed(Volume(program=builder.finish()))
    grid = Grid("density", freeze(np.ones((2, 2, 2), np.float32)), np.eye(3, 4))
    mesh = dataclasses.replace(scene.meshes[0], grids=(grid,))
    return dataclasses.replace(scene, meshes=(mesh, *scene.meshes[1:]), attributes=(("GRID", "density"),))


# Scene and changes of `feature_scenes.SETTINGS`, by the name in docs/architecture.md of what general kernels lack
SPECIALISED = {
    "`mis` OFF": (lit(), {"mis": "OFF"}),
    "other sequences than SOBOL": (lit(), {"sample_sequence": "BLUE_NOISE"}),
    "images that are filtered over footprints": (textured(), {"texture_filter": "FOOTPRINT"}),
    "Transparent Glass": (lit(shiny(), Frame(32, 32, transparent=True, glass_roughness=0.1)), {}),
    "Portal Depth": (lit(counting_portals()), {}),
    "Huang's hair": (furry(faceted_hair()), {}),
    "graphs of more than 64 registers": (lit(many_registers()), {}),
    "materials of more than 16 closures": (lit(many_closures()), {}),
    "cubic interpolation of volumes": (smooth_grid(), {}),
}
# The scene in `ALL_FEATURES`, by the name of what only those for a GPU lack
SPECIALISED_ON_A_GPU = {
    "Ray Portal": "sent on elsewhere",
    "linked light": "linked light",
    "light groups": "groups",
    "portals of the world": "portal of the world",
    "lights with few bounces": "few bounces of lights",
    "the pass Vector of panoramas": "the pass Vector of a panorama",
    "shadow catchers": "shadow catchers",
    "rays for programs": "rays for programs",
}
