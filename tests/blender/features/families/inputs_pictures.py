"""Input nodes whose effect a plane does not show: paths, instances, surroundings."""

import bpy

from tests.blender.features.build import ball, diffuse, floor, look, material_graph, studio
from tests.blender.features.compare import add_world
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_object


def _two(graph: Graph, factor, first=(0.8, 0.3, 0.2), second=(0.2, 0.4, 0.8)):
    """Two diffuse surfaces mixed by a node's output."""
    colors = [graph.value("ShaderNodeBsdfDiffuse", {"Color": color}) for color in (first, second)]
    return graph.value("ShaderNodeMixShader", {0: factor, 1: colors[0], 2: colors[1]})


# Outputs that say for a ray that meets the ball what they do not say where light is aimed at the ball
_OF_THE_RAY = ("Is Diffuse Ray", "Is Reflection Ray", "Diffuse Depth", "Transparent Depth")


def _light_path(output: str, scale: float = 1.0) -> None:
    @feature(f"Light Path: {output}", "Inputs", "picture")
    def build(scene: bpy.types.Scene) -> None:
        """A ball whose colour depends on the kind of ray, near a mirror, glass, and a floor that it lights."""
        add_world(scene, 0.1, (0.6, 0.75, 1.0))
        floor(4.0, (0.7, 0.7, 0.7))

        def surface(graph: Graph):
            factor = graph.value("ShaderNodeLightPath", output=output)
            if scale != 1.0:
                factor = graph.math("MULTIPLY", factor, scale)
            both = [
                graph.value("ShaderNodeEmission", {"Color": color, "Strength": 2.5})
                for color in ((0.9, 0.2, 0.1), (0.1, 0.4, 0.9))
            ]
            glow = graph.value("ShaderNodeMixShader", {0: factor, 1: both[0], 2: both[1]})
            return graph.value("ShaderNodeMixShader", {0: 0.5, 1: glow, 2: graph.value("ShaderNodeBsdfTransparent")})

        def mirror(graph: Graph):
            return graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.9, 0.9), "Roughness": 0.0})

        def glass(graph: Graph):
            return graph.value("ShaderNodeBsdfGlass", {"Color": (0.95, 0.95, 0.95), "Roughness": 0.0, "IOR": 1.3})

        glow = material_graph(ball("Glow", (0, 0.6, 0.7), 0.7), surface)
        if output in _OF_THE_RAY:
            # Where light is aimed at the ball its emission is that for no kind of ray, in both engines: a picture of
            # both depends on how often each engine aims. Rays alone find what the node means
            glow.data.materials[0].cycles.emission_sampling = "NONE"
        material_graph(ball("Mirror", (-1.2, 0.2, 0.6), 0.6), mirror)
        material_graph(ball("Glass", (1.1, -0.5, 0.5), 0.5), glass)
        look(scene, (0, -5, 2.2), (0, 0, 0.5), lens=45)


for _output, _scale in (
    ("Is Camera Ray", 1.0),
    ("Is Diffuse Ray", 1.0),
    ("Is Glossy Ray", 1.0),
    ("Is Singular Ray", 1.0),
    ("Is Reflection Ray", 1.0),
    ("Is Transmission Ray", 1.0),
    ("Ray Length", 0.1),
    ("Ray Depth", 0.3),
    ("Diffuse Depth", 0.4),
    ("Glossy Depth", 0.4),
    ("Transmission Depth", 0.3),
    ("Transparent Depth", 0.5),
):
    _light_path(_output, _scale)


@feature("Light Path: Is Shadow Ray", "Inputs", "picture")
def shadow_ray(scene: bpy.types.Scene) -> None:
    """A ball without shadow."""

    def surface(graph: Graph):
        shadow = graph.value("ShaderNodeLightPath", output="Is Shadow Ray")
        base = graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.5, 0.2)})
        return graph.value("ShaderNodeMixShader", {0: shadow, 1: base, 2: graph.value("ShaderNodeBsdfTransparent")})

    studio(scene, surface)


@feature("Object Info: of instances", "Inputs", "picture")
def instances(scene: bpy.types.Scene) -> None:
    """Random numbers and positions of the objects of a collection that is placed three times."""
    add_world(scene, 0.8, (0.9, 0.9, 1.0))
    floor()
    parts = bpy.data.collections.new("Parts")
    obj = ball("Part", (0, 0, 0.5), 0.5, 16, 8)

    def surface(graph: Graph):
        info = graph.node("ShaderNodeObjectInfo")
        position = graph.vector_math("MULTIPLY_ADD", info.outputs["Location"], (0.2, 0.2, 0.2), (0.4, 0.4, 0.4))
        return _two(graph, info.outputs["Random"], second=position)

    material_graph(obj, surface)
    scene.collection.objects.unlink(obj)
    parts.objects.link(obj)
    for i in range(3):
        copy = add_object(f"Copy {i}", None)
        copy.instance_type, copy.instance_collection = "COLLECTION", parts
        copy.location = (1.3 * i - 1.3, 0.3 * i, 0)
    look(scene, (0, -5, 2.5), (0, 0, 0.4), lens=40)


@feature("Attribute: instancer", "Inputs", "picture")
def attribute_instancer(scene: bpy.types.Scene) -> None:
    add_world(scene, 0.8, (0.9, 0.9, 1.0))
    floor()
    parts = bpy.data.collections.new("Parts")
    obj = ball("Part", (0, 0, 0.5), 0.5, 16, 8)
    material_graph(
        obj,
        lambda graph: graph.value(
            "ShaderNodeBsdfDiffuse",
            {
                "Color": graph.value(
                    "ShaderNodeAttribute", output="Color", attribute_type="INSTANCER", attribute_name="tint"
                )
            },
        ),
    )
    scene.collection.objects.unlink(obj)
    parts.objects.link(obj)
    for i in range(3):
        copy = add_object(f"Copy {i}", None)
        copy.instance_type, copy.instance_collection = "COLLECTION", parts
        copy.location = (1.3 * i - 1.3, 0.3 * i, 0)
        copy["tint"] = (0.8 - 0.3 * i, 0.2 + 0.3 * i, 0.5)
    look(scene, (0, -5, 2.5), (0, 0, 0.4), lens=40)


def _from_instancer(scene: bpy.types.Scene, placement: str, output: str) -> None:
    """A copy of a ball on each face or vertex of a mesh, coloured by the position on the mesh."""
    add_world(scene, 0.8, (0.9, 0.9, 1.0))
    parent = diffuse(add_object("Parent", bpy.data.meshes.new("Parent")), (0.5, 0.5, 0.5))
    parent.data.from_pydata([(-1.2, 0, 0), (0, 0.6, 0.4), (1.2, 0, 0.2), (0, -0.8, -0.3)], [], [(0, 1, 2), (0, 2, 3)])
    uv = parent.data.uv_layers.new(name="UVMap")
    for i, layer in enumerate(uv.data):
        layer.uv = (0.15 * i, 1 - 0.12 * i)
    child = ball("Child", (0, 0, 0), 0.35, 16, 8)
    child.parent = parent
    parent.instance_type = placement

    def surface(graph: Graph):
        position = graph.value("ShaderNodeTexCoord", None, output, from_instancer=True)
        if output == "Generated":  # from -1/2 to 0 or so
            position = graph.vector_math("MULTIPLY_ADD", position, (0.4, 0.4, 0.4), (0.6, 0.6, 0.6))
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": position})

    material_graph(child, surface)
    look(scene, (0, -5, 2.5), (0, 0, 0), lens=40)


@feature("Texture Coordinate: from an instancer", "Inputs", "picture")
def from_instancer(scene: bpy.types.Scene) -> None:
    _from_instancer(scene, "FACES", "UV")


@feature("Texture Coordinate: generated, from an instancer", "Inputs", "picture")
def generated_from_instancer(scene: bpy.types.Scene) -> None:
    _from_instancer(scene, "VERTS", "Generated")
