"""Shadow catchers: shadows and light that a photograph's ground gets of what is rendered into it."""

from __future__ import annotations

import bpy

from tests.blender.features.build import ball, diffuse, floor, lamp, look, material_graph, principled, quad, shaded
from tests.blender.features.compare import add_world
from tests.blender.features.families.volumes import volume_of, world_volume
from tests.blender.features.registry import feature

CATCHER = "Shadow Catcher"
# A ball there is seen beside no floor: a pixel of both has few paths that meet a catcher, and their ratio is noise
HIGH = 2.2


def stage(
    scene: bpy.types.Scene, apart: bool, transparent: bool = True, height: float = 0.7
) -> dict[str, bpy.types.Object]:
    """A ball on a floor that catches its shadow, or above it, below a lamp and a pale sky; `apart`: in a pass of its
    own.
    """
    scene.view_layers[0].cycles.use_pass_shadow_catcher = apart
    scene.render.film_transparent = transparent
    add_world(scene, 0.25, (0.6, 0.75, 1.0))
    shape = {"shape": "DISK", "size": 0.8}
    light = lamp("AREA", (2.0, -1.5, 3.0), target=(0, 0, 0.5), energy=200.0, color=(1, 0.85, 0.7), **shape)
    ground = floor(4.0)
    ground.is_shadow_catcher = True
    look(scene, (0, -5, 2.6), (0, 0, 0.5))
    painted = diffuse(ball("Ball", (0, 0, height), 0.7), (0.8, 0.3, 0.2))
    return {"floor": ground, "ball": painted, "lamp": light}


def bare(obj: bpy.types.Object) -> bpy.types.Object:
    """`obj` without its material, for another."""
    obj.data.materials.clear()
    return obj


@feature("Shadow Catcher: its pass", "Shadow catchers", "picture", quick=True, shows=CATCHER)
def of_its_own(scene: bpy.types.Scene) -> None:
    stage(scene, True, height=HIGH)


@feature("Shadow Catcher: Combined beside its pass", "Shadow catchers", "picture")
def beside(scene: bpy.types.Scene) -> None:
    stage(scene, True)


@feature("Shadow Catcher: shadows in a transparent film", "Shadow catchers", "picture", quick=True)
def laid(scene: bpy.types.Scene) -> None:
    stage(scene, False)


@feature(
    "Shadow Catcher: shadows before a world",
    "Shadow catchers",
    "picture",
    finding="At the rim of the ball Cycles weighs the world by the part of a pixel that catchers cover twice, which "
    "makes a dark line; RayBatch does not",
)
def before_a_world(scene: bpy.types.Scene) -> None:
    stage(scene, False, transparent=False)


@feature("Shadow Catcher: its pass with a world", "Shadow catchers", "picture", shows=CATCHER)
def with_a_world(scene: bpy.types.Scene) -> None:
    stage(scene, True, transparent=False, height=HIGH)


@feature("Shadow Catcher: a glossy one", "Shadow catchers", "picture", shows=CATCHER)
def glossy(scene: bpy.types.Scene) -> None:
    principled(bare(stage(scene, True, height=HIGH)["floor"]), (0.8, 0.8, 0.7), Roughness=0.3, Metallic=1.0)


@feature("Shadow Catcher: a textured one", "Shadow catchers", "picture", shows=CATCHER)
def textured(scene: bpy.types.Scene) -> None:
    def checks(graph):
        texture = graph.value("ShaderNodeTexChecker", {"Scale": 6.0, "Color1": (0.8, 0.2, 0.1, 1)})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": texture})

    material_graph(bare(stage(scene, True, height=HIGH)["floor"]), checks)


@feature("Shadow Catcher: seen in a mirror", "Shadow catchers", "picture")
def in_a_mirror(scene: bpy.types.Scene) -> None:
    on = stage(scene, False)
    shaded(bare(on["ball"]), "ShaderNodeBsdfGlossy", Color=(0.9, 0.9, 0.9, 1), Roughness=0.0)


@feature("Shadow Catcher: through veils", "Shadow catchers", "picture", shows=CATCHER)
def through(scene: bpy.types.Scene) -> None:
    stage(scene, True)
    for x, color in ((-1.0, (0.5, 0.4, 0.7, 1)), (-0.6, (0.9, 0.6, 0.5, 1))):
        corners = [(x - 0.6, -1.2 + x / 9, 0.1), (x + 0.6, -1.2, 0.1), (x + 0.6, -1.2, 1.3), (x - 0.6, -1.2, 1.3)]
        shaded(bare(quad("Veil", corners, (0, 0, 0))), "ShaderNodeBsdfTransparent", Color=color)


@feature("Shadow Catcher: below glass", "Shadow catchers", "picture")
def glass(scene: bpy.types.Scene) -> None:
    on = stage(scene, False)
    shaded(bare(on["ball"]), "ShaderNodeBsdfGlass", Color=(0.9, 1, 0.9, 1), Roughness=0.0)
    # through sharp glass paths find a lamp by chance alone, a small one so seldom that few pixels are all of the noise
    on["lamp"].data.size, on["lamp"].data.energy = 3.0, 300.0


@feature("Shadow Catcher: indirect light", "Shadow catchers", "picture", shows=CATCHER)
def indirect(scene: bpy.types.Scene) -> None:
    on = stage(scene, True)
    wall = quad("Wall", [(-3, 1.5, 0), (3, 1.5, 0), (3, 1.5, 3), (-3, 1.5, 3)], (0.6, 0.6, 0.6))
    wall.is_shadow_catcher = True
    diffuse(bare(on["ball"]), (0.9, 0.2, 0.05))


@feature("Shadow Catcher: light of an object that emits", "Shadow catchers", "picture", shows=CATCHER)
def luminous(scene: bpy.types.Scene) -> None:
    on = stage(scene, True, height=HIGH)
    shaded(bare(on["ball"]), "ShaderNodeEmission", Color=(1, 0.5, 0.2, 1), Strength=3.0)


@feature("Shadow Catcher: a lamp that is none", "Shadow catchers", "picture", shows=CATCHER)
def without_a_lamp(scene: bpy.types.Scene) -> None:
    stage(scene, True, height=HIGH)
    shape = {"shape": "DISK", "size": 1.0}
    lamp("AREA", (-2.5, -0.5, 2.0), target=(0, 0, 0.5), energy=60.0, **shape).is_shadow_catcher = False


@feature("Shadow Catcher: with holdouts", "Shadow catchers", "picture")
def holdouts(scene: bpy.types.Scene) -> None:
    on = stage(scene, False)
    hole = ball("Hole", (-1.2, -0.6, 0.5), 0.5)
    diffuse(hole, (0.5, 0.5, 0.5)).is_holdout = True
    on["ball"].location.x = 0.6


@feature("Shadow Catcher: instances", "Shadow catchers", "picture")
def instanced(scene: bpy.types.Scene) -> None:
    on = stage(scene, False)
    tiles = bpy.data.collections.new("Tiles")
    scene.collection.objects.unlink(on["floor"])
    tiles.objects.link(on["floor"])
    on["floor"].is_shadow_catcher, on["floor"].scale = False, (1.5, 1.5, 1)
    for x, catches in ((-1.6, True), (1.6, False)):
        placed = bpy.data.objects.new("Placed", None)
        placed.instance_type, placed.instance_collection, placed.location.x = "COLLECTION", tiles, x
        placed.is_shadow_catcher = catches
        scene.collection.objects.link(placed)


def fog(graph):
    """Coloured fog."""
    return graph.value("ShaderNodeVolumeScatter", {"Color": (0.8, 0.7, 0.9), "Density": 0.05})


@feature("Shadow Catcher: in fog, below smoke", "Shadow catchers", "picture", shows=CATCHER)
def in_fog(scene: bpy.types.Scene) -> None:
    on = stage(scene, True)
    volume_of(on["ball"], lambda graph: graph.value("ShaderNodeVolumeScatter", {"Density": 3.0}))
    world_volume(scene, fog)


@feature("Shadow Catcher: shadows in fog", "Shadow catchers", "picture")
def laid_in_fog(scene: bpy.types.Scene) -> None:
    stage(scene, False)
    world_volume(scene, fog)
