"""Nodes that bend normals, and nodes that depend on lights."""

import bpy

from tests.blender.features.build import floor, lamp, look, studio
from tests.blender.features.compare import add_world
from tests.blender.features.graph import Graph
from tests.blender.features.images import image_of, pattern
from tests.blender.features.registry import feature


def _bumpy(name: str, quick: bool = False, smooth: bool = True, **values) -> None:
    @feature(f"Bump: {name}", "Utility", "picture", quick=quick)
    def build(scene: bpy.types.Scene) -> None:
        def surface(graph: Graph):
            noise = graph.value(
                "ShaderNodeTexNoise",
                {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 3.0},
                "Fac",
            )
            properties = {key: value for key, value in values.items() if key == "invert"}
            inputs = {key: value for key, value in values.items() if key != "invert"}
            bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 0.3} | inputs, **properties)
            return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4), "Normal": bump})

        studio(scene, surface, smooth)


_bumpy("noise", True)
_bumpy("flat faces, weaker, inverted", smooth=False, Strength=0.6, invert=True)


@feature("Bump: image", "Utility", "picture")
def bump_image(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        node = graph.node(
            "ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeTexCoord", output="UV")}, interpolation="Cubic"
        )
        node.image = image_of(pattern())
        bump = graph.value("ShaderNodeBump", {"Height": node.outputs["Color"], "Distance": 0.2})
        return graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.8, 0.7, 0.5), "Roughness": 0.4, "Normal": bump})

    studio(scene, surface)


@feature("Bump: two, one over the other", "Utility", "picture")
def bump_chain(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        coordinates = graph.value("ShaderNodeTexCoord", output="Object")
        wave = graph.value("ShaderNodeTexWave", {"Vector": coordinates, "Scale": 1.0}, "Fac")
        first = graph.value("ShaderNodeBump", {"Height": wave, "Distance": 0.2})
        noise = graph.value("ShaderNodeTexNoise", {"Vector": coordinates, "Scale": 4.0}, "Fac")
        second = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 0.1, "Normal": first})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4), "Normal": second})

    studio(scene, surface)


def _normal_map(space: str, strength: float = 1.0, **properties) -> None:
    name = space.replace("_", " ").lower() + "".join(f", {value}" for value in properties.values())
    if strength != 1:
        name += f", strength {strength}"

    @feature(f"Normal Map: {name}", "Utility", "picture")
    def build(scene: bpy.types.Scene) -> None:
        pixels = pattern()
        pixels[..., :2] = 0.5 + 0.5 * (pixels[..., :2] - 0.5)
        pixels[..., 2] = 0.9
        if space != "TANGENT":
            pixels[..., :3] = 0.5 + 0.5 * (pattern(seed=8)[..., :3] - 0.5) + (0.0, -0.3, 0.25)
        if space.startswith("BLENDER"):
            pixels[..., 1:3] = 1 - pixels[..., 1:3]

        def surface(graph: Graph):
            node = graph.node("ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeTexCoord", output="UV")})
            node.image = image_of(pixels, colorspace="Non-Color")
            normal = graph.value(
                "ShaderNodeNormalMap", {"Color": node.outputs["Color"], "Strength": strength}, space=space, **properties
            )
            return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4), "Normal": normal})

        studio(scene, surface).rotation_euler = (0.2, 0.3, 0.5)


_normal_map("TANGENT")
_normal_map("TANGENT", 0.5)
_normal_map("TANGENT", convention="DIRECTX")
for _space in ("OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD"):
    _normal_map(_space)


@feature("Displacement, as bump", "Utility", "picture")
def displacement(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 3.0}, "Fac"
        )
        moved = graph.value("ShaderNodeDisplacement", {"Height": noise, "Midlevel": 0.5, "Scale": 0.3})
        output = next(node for node in graph.tree.nodes if node.type == "OUTPUT_MATERIAL")
        graph.set(output.inputs["Displacement"], moved)
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4)})

    obj = studio(scene, surface)
    obj.data.materials[0].displacement_method = "BUMP"


def _displaced(name: str, kind: str, method: str, **properties) -> None:
    @feature(f"{kind}, {name}", "Utility", "picture")
    def build(scene: bpy.types.Scene) -> None:
        def surface(graph: Graph):
            place = graph.value("ShaderNodeTexCoord", output="UV" if method == "BOTH" else "Object")
            # by UV maps, since positions are those of the moved surface in the bumps of BOTH
            inputs = {"Vector": place, "Scale": 6.0 if method == "BOTH" else 2.0}
            if kind == "Displacement":
                height = graph.value("ShaderNodeTexNoise", inputs, "Fac")
                given = {"Height": height, "Midlevel": 0.5, "Scale": 0.3 if method == "BOTH" else 0.6}
            else:
                given = {"Vector": graph.value("ShaderNodeTexNoise", inputs, "Color"), "Midlevel": 0.5, "Scale": 0.5}
            moved = graph.value(f"ShaderNode{kind.replace(' ', '')}", given, **properties)
            output = next(node for node in graph.tree.nodes if node.type == "OUTPUT_MATERIAL")
            graph.set(output.inputs["Displacement"], moved)
            return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4)})

        obj = studio(scene, surface)
        obj.rotation_euler, obj.scale = (0.2, 0.3, 0.5), (1.0, 0.8, 1.1)
        obj.data.materials[0].displacement_method = method


for _space in ("OBJECT", "WORLD"):
    _displaced(f"true, {_space.lower()}", "Displacement", "DISPLACEMENT", space=_space)
for _space in ("OBJECT", "WORLD", "TANGENT"):
    _displaced(f"true, {_space.lower()}", "Vector Displacement", "DISPLACEMENT", space=_space)
_displaced("true and as bump", "Displacement", "BOTH")


def _falloff(output: str) -> None:
    @feature(f"Light Falloff: {output.lower()}", "Utility", "picture")
    def build(scene: bpy.types.Scene) -> None:
        add_world(scene, 0.1)
        floor()
        light = lamp("POINT", (0.3, 0, 1.2), energy=30.0, shadow_soft_size=0.2)
        if bpy.app.version < (5, 0):
            light.data.use_nodes = True
        tree = light.data.node_tree
        graph = Graph(tree)
        emission = next(node for node in tree.nodes if node.type == "EMISSION")
        graph.set(
            emission.inputs["Strength"], graph.value("ShaderNodeLightFalloff", {"Strength": 2.0, "Smooth": 0.5}, output)
        )
        look(scene, (0, -5, 3), (0, 0, 0.2))


for _output in ("Quadratic", "Linear", "Constant"):
    _falloff(_output)


@feature("Light with colours and textures", "Utility", "picture")
def light_graph(scene: bpy.types.Scene) -> None:
    add_world(scene, 0.1)
    floor()
    light = lamp("AREA", (0, 0, 2.0), target=(0, 0, 0), energy=60.0, shape="SQUARE", size=1.5)
    if bpy.app.version < (5, 0):
        light.data.use_nodes = True
    tree = light.data.node_tree
    graph = Graph(tree)
    emission = next(node for node in tree.nodes if node.type == "EMISSION")
    geometry = graph.value("ShaderNodeNewGeometry", output="Parametric")
    colors = {"Color1": (1, 0.3, 0.1), "Color2": (0.1, 0.4, 1)}
    checker = graph.value("ShaderNodeTexChecker", {"Vector": geometry, "Scale": 2.0, **colors}, "Color")
    graph.set(emission.inputs["Color"], checker)
    look(scene, (0, -4, 3), (0, 0, 0.2))


@feature("Light coloured by a blackbody", "Utility", "picture")
def light_blackbody(scene: bpy.types.Scene) -> None:
    studio(scene, lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.8, 0.8)}), world=0.2)
    light = lamp("POINT", (-1.5, -1.5, 2.0), energy=80.0, shadow_soft_size=0.2)
    if bpy.app.version < (5, 0):
        light.data.use_nodes = True
    graph = Graph(light.data.node_tree)
    emission = next(node for node in graph.tree.nodes if node.type == "EMISSION")
    graph.set(emission.inputs["Color"], graph.value("ShaderNodeBlackbody", {0: 2700.0}))
    graph.set(emission.inputs["Strength"], 1.5)
