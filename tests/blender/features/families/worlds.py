"""Worlds that light a ball and a floor, and are seen behind them."""

import math

import bpy

from tests.blender.features.build import (
    add_world,
    ball,
    diffuse,
    floor,
    lamp,
    look,
    material_graph,
    principled,
    shaded,
    world_graph,
)
from tests.blender.features.graph import Graph
from tests.blender.features.images import image_of, sky_map
from tests.blender.features.registry import feature


def _stage(scene: bpy.types.Scene, build, roughness: float = 0.15, map_resolution: int = 256) -> None:
    """A diffuse and a shiny ball on a floor, in the world that `build(graph)` shades."""
    world = world_graph(scene, build)
    # size of the table that Cycles samples the world by: its own choice takes long to fill
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", map_resolution
    floor(3.0)
    diffuse(ball("Matt", (-0.8, 0, 0.75), 0.75), (0.8, 0.6, 0.4))
    shaded(
        ball("Shiny", (0.8, 0, 0.75), 0.75), "ShaderNodeBsdfAnisotropic", Color=(0.9, 0.9, 0.9, 1), Roughness=roughness
    )
    look(scene, (0, -5.5, 1.6), (0, 0, 0.8), lens=40)


def _background(graph: Graph, color, strength=1.0):
    return graph.value("ShaderNodeBackground", {"Color": color, "Strength": strength})


@feature("Background", "World", "picture")
def background(scene: bpy.types.Scene) -> None:
    _stage(scene, lambda graph: _background(graph, (0.3, 0.5, 0.9), 1.3))


@feature("World: any graph", "World", "picture", quick=True)
def any_graph(scene: bpy.types.Scene) -> None:
    def build(graph: Graph):
        direction = graph.value("ShaderNodeTexCoord", output="Generated")
        noise = graph.value("ShaderNodeTexNoise", {"Vector": direction, "Scale": 1.5}, "Color")
        gradient = graph.value("ShaderNodeSeparateXYZ", {0: direction}, "Z")
        return _background(graph, noise, graph.math("MULTIPLY_ADD", gradient, 0.5, 0.8))

    _stage(scene, build)


@feature("World: mixed backgrounds", "World", "picture")
def mixed(scene: bpy.types.Scene) -> None:
    def build(graph: Graph):
        up = graph.math(
            "GREATER_THAN",
            graph.value("ShaderNodeSeparateXYZ", {0: graph.value("ShaderNodeTexCoord", output="Generated")}, "Z"),
            0.1,
        )
        return graph.value(
            "ShaderNodeMixShader",
            {0: up, 1: _background(graph, (0.5, 0.3, 0.1)), 2: _background(graph, (0.2, 0.5, 1.0), 1.5)},
        )

    _stage(scene, build)


@feature("World: seen by the camera otherwise", "World", "picture")
def light_path(scene: bpy.types.Scene) -> None:
    def build(graph: Graph):
        camera = graph.value("ShaderNodeLightPath", output="Is Camera Ray")
        return graph.value(
            "ShaderNodeMixShader",
            {0: camera, 1: _background(graph, (0.5, 0.6, 0.8)), 2: _background(graph, (0.8, 0.2, 0.1))},
        )

    _stage(scene, build)


def _map(pixels, interpolation: str = "Linear", projection: str = "EQUIRECTANGULAR", rotation: float = 0.0):
    def build(graph: Graph):
        vector = graph.value("ShaderNodeTexCoord", output="Generated")
        if rotation:
            vector = graph.value("ShaderNodeMapping", {"Vector": vector, "Rotation": (0.2, 0.0, rotation)})
        node = graph.node(
            "ShaderNodeTexEnvironment", {"Vector": vector}, projection=projection, interpolation=interpolation
        )
        node.image = image_of(pixels, "Sky", float_buffer=True)
        return _background(graph, node.outputs["Color"])

    return build


@feature("Environment map", "World", "picture", quick=True)
def environment(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map()))


@feature("Environment map: rotated", "World", "picture")
def environment_rotated(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map(), rotation=1.2))


@feature("Environment map: mirror ball", "World", "picture")
def environment_mirror(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map(), projection="MIRROR_BALL"))


@feature("Environment map: a sun of 1e4 times the sky", "World", "picture")
def environment_sun(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map(256, sun=1e4), interpolation="Closest"), 0.3)


@feature("Environment map: unlinked coordinates", "World", "picture")
def environment_unlinked(scene: bpy.types.Scene) -> None:
    def build(graph: Graph):
        node = graph.node("ShaderNodeTexEnvironment")
        node.image = image_of(sky_map(), "Sky", float_buffer=True)
        return _background(graph, node.outputs["Color"])

    _stage(scene, build)


def _sky(name: str, strength: float, **properties) -> None:
    @feature(f"Sky Texture: {name}", "World", "picture")
    def build(scene: bpy.types.Scene) -> None:
        _stage(
            scene, lambda graph: _background(graph, graph.value("ShaderNodeTexSky", None, **properties), strength), 0.3
        )


_sky("single scattering", 0.1, sky_type="SINGLE_SCATTERING", sun_disc=False, sun_elevation=0.5, sun_rotation=0.8)
_sky("multiple scattering", 0.1, sky_type="MULTIPLE_SCATTERING", sun_disc=False, sun_elevation=0.5, sun_rotation=0.8)
_sky(
    "multiple scattering, low sun, haze",
    0.2,
    sky_type="MULTIPLE_SCATTERING",
    sun_disc=False,
    sun_elevation=0.05,
    sun_rotation=2.0,
    aerosol_density=3.0,
    altitude=1000.0,
)
_sky(
    "single scattering with sun disc",
    0.1,
    sky_type="SINGLE_SCATTERING",
    sun_disc=True,
    sun_elevation=0.7,
    sun_rotation=0.8,
    sun_size=math.radians(2.0),
)
_sky(
    "multiple scattering with sun disc",
    0.1,
    sky_type="MULTIPLE_SCATTERING",
    sun_disc=True,
    sun_elevation=0.7,
    sun_rotation=0.8,
    sun_intensity=0.5,
)
_sky("Preetham", 1.0, sky_type="PREETHAM", turbidity=3.0, sun_direction=(0.3, -0.4, 0.8))
_sky("Hosek-Wilkie", 3.0, sky_type="HOSEK_WILKIE", turbidity=3.0, ground_albedo=0.3, sun_direction=(0.3, -0.4, 0.8))


@feature("World: transparent to the camera", "World", "picture")
def film_transparent(scene: bpy.types.Scene) -> None:
    scene.render.film_transparent = True
    _stage(scene, _map(sky_map()))


@feature("World: transparent to the camera through glass", "World", "picture")
def film_glass(scene: bpy.types.Scene) -> None:
    """Of four balls in a row those of sharp and of smooth glass are clear, and those of rough glass and of Principled
    BSDF, rough too, are not; others are behind them.
    """
    scene.render.film_transparent = scene.cycles.film_transparent_glass = True
    scene.cycles.film_transparent_roughness = 0.1
    add_world(scene, 0.6, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)
    for x, roughness in ((-1.5, 0.0), (-0.5, 0.08), (0.5, 0.3)):
        shaded(ball(f"Glass {x}", (x, 0, 0.5), 0.48), "ShaderNodeBsdfGlass", Roughness=roughness, IOR=1.3)
    principled(ball("Ball", (1.5, 0, 0.5), 0.48), (0.8, 0.9, 0.7), Roughness=0.2, Transmission_Weight=0.9)
    for x in (-1.2, 0.8):
        diffuse(ball(f"Behind {x}", (x, 2.0, 0.6), 0.3), (0.8, 0.3, 0.2))
    shaded(ball("Hole", (-0.3, 2.0, 0.6), 0.25), "ShaderNodeHoldout")
    look(scene, (0, -5, 0.9), (0, 0, 0.5), lens=45)


@feature("World and textured material", "World", "picture")
def with_material(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map()))

    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.0}, "Color"
        )
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": noise})

    material_graph(ball("Textured", (0, -1.3, 0.4), 0.4), surface)


@feature("World: length of rays", "World", "picture")
def world_by_length(scene: bpy.types.Scene) -> None:
    """Rays into the world are longer than any other, and the world's graph may ask."""

    def build(graph: Graph):
        far = graph.math("GREATER_THAN", graph.value("ShaderNodeLightPath", output="Ray Length"), 1000.0)
        return _background(graph, (0.6, 0.75, 1.0), far)

    _stage(scene, build)


@feature("World: Max Bounces", "World", "picture")
def world_with_few_bounces(scene: bpy.types.Scene) -> None:
    _stage(scene, _map(sky_map()))
    scene.world.cycles.max_bounces = 0


if bpy.app.version >= (5, 0):  # worlds have it from there on

    @feature("World: without shadow", "World", "picture")
    def world_without_shadow(scene: bpy.types.Scene) -> None:
        _stage(scene, _map(sky_map()))
        scene.world.cycles.use_shadows = False
