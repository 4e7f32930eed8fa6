"""Features of hair, curves and point clouds, as round curves and as ribbons."""

import bpy
import numpy as np

from tests.blender.features.build import add_world, floor, lamp, look, material_graph
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_grid, add_object


def _light(scene: bpy.types.Scene, shape: str = "THICK") -> None:
    scene.cycles_curves.shape = shape
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.1)
    floor()
    look(scene, (0, -4.5, 2.2), (0, 0, 0.7), lens=50)


def tuft(name: str = "Tuft", count: int = 60, steps: int = 7, radius: float = 0.04) -> bpy.types.Object:
    """A Curves object of bent strands that become thin, with a colour at each point."""
    rng = np.random.default_rng(5)
    along = np.linspace(0, 1, steps)
    points = np.zeros((count, steps, 3))
    points[:, :, :2] = rng.uniform(-1, 1, (count, 1, 2)) + rng.normal(0, 0.5, (count, 1, 2)) * along[:, None] ** 2
    points[:, :, 2] = 1.4 * along
    curves = bpy.data.hair_curves.new(name)
    curves.add_curves([steps] * count)
    curves.position_data.foreach_set("vector", points.astype(np.float32).ravel())
    radii = curves.attributes.new("radius", "FLOAT", "POINT")
    radii.data.foreach_set("value", np.tile(radius * (1 - 0.8 * along), count).astype(np.float32))
    colors = np.ones((count, steps, 4), np.float32)
    colors[:, :, 0], colors[:, :, 1] = along, rng.random((count, 1))
    curves.attributes.new("tone", "FLOAT_COLOR", "POINT").data.foreach_set("color", colors.ravel())
    return add_object(name, curves)


def _principled(**values):
    def build(graph: Graph):
        node = graph.node("ShaderNodeBsdfHairPrincipled", {})
        node.parametrization = values.get("parametrization", "COLOR")
        for name, value in values.items():
            for socket in node.inputs:
                if socket.name == name:
                    socket.default_value = value
        return node.outputs[0]

    return build


@feature("Curves: Principled Hair by colour", "Curves", "picture")
def by_color(scene: bpy.types.Scene) -> None:
    _light(scene)
    material_graph(tuft(), _principled(Color=(0.8, 0.4, 0.2, 1.0), Offset=0.1, Coat=0.5))


@feature("Curves: Principled Hair by melanin, at random", "Curves", "picture", quick=True)
def by_melanin(scene: bpy.types.Scene) -> None:
    _light(scene)
    values = {"Melanin": 0.4, "Random Color": 0.7, "Random Roughness": 0.4, "Radial Roughness": 0.6}
    material_graph(tuft(), _principled(parametrization="MELANIN", **values))


@feature("Curves: an attribute as the colour of a diffuse surface", "Curves", "picture")
def attribute(scene: bpy.types.Scene) -> None:
    _light(scene)
    material_graph(
        tuft(),
        lambda graph: graph.value(
            "ShaderNodeBsdfDiffuse", {"Color": graph.value("ShaderNodeAttribute", None, "Color", attribute_name="tone")}
        ),
    )


@feature("Curves Info: intercept and random", "Curves", "picture")
def info(scene: bpy.types.Scene) -> None:
    _light(scene)

    def build(graph: Graph):
        node = graph.node("ShaderNodeHairInfo", {})
        color = graph.node("ShaderNodeCombineColor", {})
        graph.tree.links.new(node.outputs["Intercept"], color.inputs[0])
        graph.tree.links.new(node.outputs["Random"], color.inputs[1])
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color.outputs[0]})

    material_graph(tuft(), build)


@feature("Curves: scaled and turned, in two places", "Curves", "picture")
def placed(scene: bpy.types.Scene) -> None:
    _light(scene)
    first = tuft()
    material_graph(first, lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.7, 0.3, 0.2, 1.0)}))
    first.scale, first.location = (0.5, 0.5, 0.5), (-0.8, 0, 0)
    second = add_object("Second", first.data)
    second.scale, second.rotation_euler, second.location = (0.7, 0.7, 0.7), (0.4, 0.1, 0.8), (0.8, 0, 0)


@feature("Particle hair with children", "Curves", "picture")
def particle_hair(scene: bpy.types.Scene) -> None:
    _light(scene)
    ground = add_grid("Emitter", 4)
    ground.location.z = 0.02
    material_graph(ground, lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.3, 0.6, 0.2, 1.0)}))
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 40, 1.0
    settings.child_type, settings.rendered_child_count = "SIMPLE", 5
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.2, 0.06


def _cloud(corners: tuple, sizes: tuple[float, float]) -> bpy.types.PointCloud:
    """60 points between these corners of a box, with radii between these sizes [m]."""
    rng = np.random.default_rng(6)
    cloud = bpy.data.pointclouds.new("Points")
    cloud.resize(60)
    cloud.attributes["position"].data.foreach_set("vector", rng.uniform(*corners, (60, 3)).astype(np.float32).ravel())
    radii = cloud.attributes.get("radius") or cloud.attributes.new("radius", "FLOAT", "POINT")
    radii.data.foreach_set("value", rng.uniform(*sizes, 60).astype(np.float32))
    return cloud


@feature("Point cloud", "Curves", "picture", quick=True)
def points(scene: bpy.types.Scene) -> None:
    _light(scene)
    cloud = _cloud(((-1, -1, 0.2), (1, 1, 1.6)), (0.03, 0.15))
    material_graph(
        add_object("Points", cloud), lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.5, 0.3, 1.0)})
    )


@feature("Curves: ribbons of Principled Hair", "Curves", "picture", quick=True)
def ribbons(scene: bpy.types.Scene) -> None:
    _light(scene, "RIBBONS")
    material_graph(tuft(), _principled(Color=(0.8, 0.4, 0.2, 1.0), Offset=0.1, Coat=0.5))


@feature("Curves: diffuse ribbons of two subdivisions", "Curves", "picture")
def coarse_ribbons(scene: bpy.types.Scene) -> None:
    _light(scene, "RIBBONS")
    scene.cycles_curves.subdivisions = 1
    color = {"Color": (0.3, 0.6, 0.2, 1.0)}
    material_graph(tuft(steps=4), lambda graph: graph.value("ShaderNodeBsdfDiffuse", color))


@feature("Curves: straight between points", "Curves", "picture", quick=True)
def straight(scene: bpy.types.Scene) -> None:
    _light(scene, "THICK_LINEAR")
    material_graph(tuft(steps=4), lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.3, 0.6, 0.2, 1.0)}))


def _huang(**values):
    build = _principled(**values)

    def made(graph: Graph):
        socket = build(graph)
        socket.node.model = "HUANG"
        for name in ("Aspect Ratio", "Roughness"):
            if name in values:
                socket.node.inputs[name].default_value = values[name]
        return socket

    return made


@feature("Curves: Principled Hair by Huang, round", "Curves", "picture", samples=512)
def round_facets(scene: bpy.types.Scene) -> None:
    _light(scene)
    material_graph(tuft(), _huang(Color=(0.8, 0.4, 0.2, 1.0), **{"Aspect Ratio": 1.0, "Roughness": 0.4}))


@feature("Curves: Principled Hair by Huang, elliptical ribbons", "Curves", "picture", samples=512)
def elliptical_facets(scene: bpy.types.Scene) -> None:
    _light(scene, "RIBBONS")
    values = {"Melanin": 0.4, "Roughness": 0.3, "Aspect Ratio": 0.7}
    material_graph(tuft(radius=0.05), _huang(parametrization="MELANIN", **values))


def _hair_bsdf(component: str, **values):
    return lambda graph: graph.value("ShaderNodeBsdfHair", values, component=component)


@feature("Hair BSDF: reflection", "Curves", "picture")
def hair_reflection(scene: bpy.types.Scene) -> None:
    _light(scene)
    values = {"Color": (0.8, 0.5, 0.2, 1.0), "Offset": 0.1, "RoughnessU": 0.3, "RoughnessV": 0.4}
    material_graph(tuft(), _hair_bsdf("Reflection", **values))


@feature("Hair BSDF: transmission", "Curves", "picture")
def hair_transmission(scene: bpy.types.Scene) -> None:
    _light(scene)
    values = {"Color": (0.8, 0.5, 0.2, 1.0), "Offset": -0.1, "RoughnessU": 0.4, "RoughnessV": 0.7}
    material_graph(tuft(), _hair_bsdf("Transmission", **values))


def _of_strand(output: str, factor: float):
    """A colour by one output of Curves Info."""

    def build(graph: Graph):
        value = graph.value("ShaderNodeHairInfo", output=output)
        color = graph.vector_math("MULTIPLY", value, (factor,) * 3)
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color})

    return build


@feature("Curves Info: length", "Curves", "picture")
def strand_length(scene: bpy.types.Scene) -> None:
    """Of curves at half of their size: the length is that before."""
    _light(scene)
    curves = tuft()
    curves.scale = (0.5, 0.5, 0.5)
    material_graph(curves, _of_strand("Length", 0.4))


@feature("Curves Info: thickness", "Curves", "picture")
def strand_thickness(scene: bpy.types.Scene) -> None:
    """Of curves at half of their size."""
    _light(scene)
    curves = tuft(radius=0.08)
    curves.scale = (0.5, 0.5, 0.5)
    material_graph(curves, _of_strand("Thickness", 6.0))


@feature("Curves Info: tangent normal", "Curves", "picture")
def strand_tangent_normal(scene: bpy.types.Scene) -> None:
    _light(scene)
    material_graph(tuft(), _of_strand("Tangent Normal", 0.9))


@feature("Point Info", "Curves", "picture")
def point_info(scene: bpy.types.Scene) -> None:
    """Of points at twice their size."""
    _light(scene)
    cloud = _cloud(((-0.5, -0.5, 0.1), (0.5, 0.5, 0.8)), (0.02, 0.08))

    def build(graph: Graph):
        node = graph.node("ShaderNodePointInfo", {})
        size = graph.math("MULTIPLY", node.outputs["Radius"], 5.0)
        place = graph.vector_math("MULTIPLY", node.outputs["Position"], (0.2, 0.2, 0.2))
        both = graph.vector_math("ADD", place, graph.value("ShaderNodeCombineXYZ", {"X": size}))
        color = graph.vector_math("ADD", both, graph.value("ShaderNodeCombineXYZ", {"Y": node.outputs["Random"]}))
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": graph.vector_math("ABSOLUTE", color)})

    points = add_object("Points", cloud)
    points.scale = (2, 2, 2)
    material_graph(points, build)
