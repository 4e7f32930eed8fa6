"""Input nodes that need rays: Ambient Occlusion and Bevel."""

import bpy

from tests.blender.features.build import ball, box, floor, lamp, look, material_graph, studio, world_graph
from tests.blender.features.compare import add_world
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_object

_WARM = (0.9, 0.6, 0.3)


def _glossy(graph: Graph, normal):
    inputs = {"Base Color": (0.8, 0.5, 0.2), "Roughness": 0.35, "Normal": normal}
    return graph.value("ShaderNodeBsdfPrincipled", inputs)


def _box(build, name: str = "Box") -> bpy.types.Object:
    obj = box(name, (0, 0, 0.8), (1.4, 1.4, 1.4), 0.5, (0.8, 0.5, 0.2))
    obj.data.materials.clear()
    return material_graph(obj, build)


def _corner(scene: bpy.types.Scene, build) -> None:
    """A box and a ball, close to each other and to the floor, all of one material."""
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)
    _box(build)
    material_graph(ball("Ball", (0.9, -0.9, 0.6), 0.6), build)
    material_graph(floor(), build)
    look(scene, (0.6, -4.5, 2.6), (0.3, -0.2, 0.6), lens=40)


@feature("Bevel", "Inputs", "picture", quick=True)
def bevel(scene: bpy.types.Scene) -> None:
    studio(scene).hide_render = True
    _box(
        lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Normal": graph.value("ShaderNodeBevel", {"Radius": 0.4})})
    )


@feature("Bevel: of a bent normal", "Inputs", "picture")
def bevel_bent(scene: bpy.types.Scene) -> None:
    """With a bump in front, more samples than by default, and another object within the radius, which has no say."""

    def surface(graph: Graph):
        waves = graph.value("ShaderNodeTexWave", {"Scale": 3.0})
        bumped = graph.value("ShaderNodeBump", {"Height": waves, "Strength": 0.4, "Distance": 0.1})
        return _glossy(graph, graph.value("ShaderNodeBevel", {"Radius": 0.25, "Normal": bumped}, samples=8))

    _corner(scene, surface)


@feature("Bevel: of mirrored instances", "Inputs", "picture")
def bevel_instances(scene: bpy.types.Scene) -> None:
    """One mesh placed three times, mirrored and seen from inside; half of its faces are smooth."""
    studio(scene).hide_render = True
    first = _box(lambda graph: _glossy(graph, graph.value("ShaderNodeBevel", {"Radius": 0.2})))
    first.scale, first.location = (0.8, 0.8, 0.8), (-1.0, 0, 0.5)
    for polygon in first.data.polygons:
        polygon.use_smooth = polygon.index % 2 == 0
    mirrored = add_object("Mirrored", first.data)
    mirrored.scale, mirrored.location, mirrored.rotation_euler.z = (-0.8, 0.8, 0.8), (0.6, 0, 0.5), 0.3
    around = add_object("Around", first.data)
    around.scale, around.location = (9, -9, 6), (0, 0, 2.9)
    around.visible_diffuse = around.visible_glossy = around.visible_transmission = around.visible_shadow = False


@feature("Ambient Occlusion", "Inputs", "picture", quick=True)
def ambient_occlusion(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        color = graph.value("ShaderNodeAmbientOcclusion", {"Color": _WARM, "Distance": 1.0})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color})

    _corner(scene, surface)


@feature("Ambient Occlusion: of what emits", "Inputs", "picture")
def of_emission(scene: bpy.types.Scene) -> None:
    """Beside things that are black: light sampling takes nothing to be occluded, a ray that meets the ball does not, so
    that how bright others are depends on how often lights are sampled, in Cycles too.
    """

    def surface(graph: Graph):
        color = graph.value("ShaderNodeAmbientOcclusion", {"Color": _WARM, "Distance": 1.0})
        return graph.value("ShaderNodeEmission", {"Color": color})

    material_graph(ball("Ball", (0, 0, 1), 1.0), surface)
    floor(color=(0, 0, 0))
    box("Box", (1.2, -0.4, 0.5), (1, 1, 1), 0.3, (0, 0, 0))
    look(scene, (0, -4.5, 2.2), (0, 0, 0.85), lens=50)


@feature("Ambient Occlusion: through a color ramp", "Inputs", "picture")
def ramped(scene: bpy.types.Scene) -> None:
    """Dirt in corners: what comes out is not linear in what rays find."""

    def surface(graph: Graph):
        seen = graph.value("ShaderNodeAmbientOcclusion", {"Distance": 0.8}, output="AO", samples=32)
        ramp = graph.node("ShaderNodeValToRGB", {"Fac": seen})
        first, last = ramp.color_ramp.elements
        first.position, first.color = 0.35, (0.05, 0.02, 0.01, 1)
        last.position, last.color = 0.8, (0.8, 0.7, 0.5, 1)
        inputs = {"Base Color": ramp.outputs["Color"], "Roughness": 0.4}
        return graph.value("ShaderNodeBsdfPrincipled", inputs)

    _corner(scene, surface)


@feature("Ambient Occlusion: inside, of the object alone", "Inputs", "picture")
def inside(scene: bpy.types.Scene) -> None:
    """How thin things are, beside what other objects hide."""

    def surface(graph: Graph):
        thick = graph.value("ShaderNodeAmbientOcclusion", {"Distance": 0.7}, output="AO", inside=True)
        own = graph.value("ShaderNodeAmbientOcclusion", {"Distance": 2.0}, output="AO", only_local=True, samples=5)
        color = graph.value("ShaderNodeCombineColor", {0: thick, 1: own, 2: 0.3})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color})

    _corner(scene, surface)


@feature("Ambient Occlusion: of a rounded normal", "Inputs", "picture")
def nested(scene: bpy.types.Scene) -> None:
    """Requests that depend on others, a distance that varies, and one that is the world's."""

    def surface(graph: Graph):
        rounded = graph.value("ShaderNodeBevel", {"Radius": 0.3})
        far = graph.value("ShaderNodeAmbientOcclusion", {"Distance": 0.0, "Normal": rounded}, output="AO")
        near = graph.value("ShaderNodeAmbientOcclusion", {"Distance": far, "Color": _WARM}, samples=3)
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": near, "Normal": rounded})

    _corner(scene, surface)
    scene.world.light_settings.distance = 1.5


@feature("Ambient Occlusion: behind glass, through holes", "Inputs", "picture")
def transparent(scene: bpy.types.Scene) -> None:
    """Surfaces that rays of paths pass hide all the same; how much passes depends on occlusion."""

    def surface(graph: Graph):
        seen = graph.value("ShaderNodeAmbientOcclusion", {"Distance": 0.7}, output="AO")
        base = graph.value("ShaderNodeBsdfDiffuse", {"Color": _WARM})
        holes = graph.value("ShaderNodeBsdfTransparent")
        return graph.value("ShaderNodeMixShader", {0: seen, 1: base, 2: holes})

    _corner(scene, surface)
    pane = box("Pane", (0, -2, 1), (2.5, 0.1, 2.5), 0.2, (1, 1, 1))
    pane.data.materials.clear()
    material_graph(pane, lambda graph: graph.value("ShaderNodeBsdfGlass", {"Roughness": 0.0, "IOR": 1.2}))


@feature("Ambient Occlusion: of lamps and worlds", "Inputs", "picture")
def of_lights(scene: bpy.types.Scene) -> None:
    """Nothing is occluded there."""
    studio(scene)

    def shine(graph: Graph):
        color = graph.value("ShaderNodeAmbientOcclusion", {"Color": _WARM, "Distance": 5.0})
        return graph.value("ShaderNodeBackground", {"Color": color, "Strength": 0.4})

    world_graph(scene, shine)
    lit = lamp("POINT", (1.2, -1.2, 1.6), energy=30.0)
    if bpy.app.version < (5, 0):
        lit.data.use_nodes = True
    tree = lit.data.node_tree
    node = tree.nodes.new("ShaderNodeAmbientOcclusion")
    node.inputs["Color"].default_value = (0.3, 0.6, 0.9, 1)
    emission = next(each for each in tree.nodes if each.type == "EMISSION")
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])
