"""Shader nodes: a ball with each, over a floor, under a sun and a sky."""

import bpy

from tests.blender.features.build import add_world, ball, diffuse, floor, lamp, look, material_graph, studio
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature

COLOR = (0.8, 0.5, 0.2)


def shader(name: str, kind: str, quick: bool = False, properties: dict | None = None, **inputs) -> None:
    """A feature that is one shader node with values."""

    @feature(name, "Shaders", "picture", quick=quick)
    def build(scene: bpy.types.Scene) -> None:
        def surface(graph: Graph):
            node = graph.node(kind, **(properties or {}))
            graph.fill(
                node,
                {
                    socket.identifier: inputs[socket.name.replace(" ", "_")]
                    for socket in node.inputs
                    if socket.name.replace(" ", "_") in inputs
                },
            )
            return node.outputs[0]

        studio(scene, surface)


shader("Diffuse BSDF", "ShaderNodeBsdfDiffuse", quick=True, Color=COLOR, Roughness=0.0)
for _component in ("DIFFUSE", "GLOSSY"):
    for _name, _size, _smooth in (("", 0.5, 0.0), (" with an edge", 0.3, 0.4)):
        shader(
            f"Toon BSDF: {_component.lower()}{_name}",
            "ShaderNodeBsdfToon",
            False,
            {"component": _component},
            Color=COLOR,
            Size=_size,
            Smooth=_smooth,
        )
shader("Diffuse BSDF: Oren-Nayar", "ShaderNodeBsdfDiffuse", Color=COLOR, Roughness=0.8)
for _name, _distribution, _roughness in (
    ("GGX", "GGX", 0.35),
    ("multiscatter GGX", "MULTI_GGX", 0.7),
    ("Beckmann", "BECKMANN", 0.4),
    ("Ashikhmin-Shirley", "ASHIKHMIN_SHIRLEY", 0.35),
    ("sharp", "GGX", 0.0),
):
    shader(
        f"Glossy BSDF: {_name}",
        "ShaderNodeBsdfAnisotropic",
        False,
        {"distribution": _distribution},
        Color=COLOR,
        Roughness=_roughness,
    )
for _distribution, _name in (("GGX", "GGX"), ("MULTI_GGX", "multiscatter GGX"), ("BECKMANN", "Beckmann")):
    shader(
        f"Glass BSDF: {_name}",
        "ShaderNodeBsdfGlass",
        False,
        {"distribution": _distribution},
        Color=(0.9, 0.8, 0.95),
        Roughness=0.4,
        IOR=1.45,
    )
shader("Glass BSDF: sharp", "ShaderNodeBsdfGlass", True, Color=(0.9, 0.8, 0.95), Roughness=0.0, IOR=1.45)
shader(
    "Glass BSDF: thin film",
    "ShaderNodeBsdfGlass",
    Color=(1, 1, 1),
    Roughness=0.1,
    IOR=1.45,
    Thin_Film_Thickness=450.0,
    Thin_Film_IOR=1.6,
)
shader(
    "Refraction BSDF: GGX",
    "ShaderNodeBsdfRefraction",
    False,
    {"distribution": "GGX"},
    Color=(0.9, 0.8, 0.95),
    Roughness=0.3,
    IOR=1.3,
)
shader(
    "Refraction BSDF: Beckmann",
    "ShaderNodeBsdfRefraction",
    False,
    {"distribution": "BECKMANN"},
    Color=(0.9, 0.8, 0.95),
    Roughness=0.3,
    IOR=1.3,
)
shader("Translucent BSDF", "ShaderNodeBsdfTranslucent", Color=COLOR)
shader("Transparent BSDF", "ShaderNodeBsdfTransparent", Color=(0.7, 0.4, 0.9))
shader(
    "Sheen BSDF: microfiber", "ShaderNodeBsdfSheen", False, {"distribution": "MICROFIBER"}, Color=COLOR, Roughness=0.4
)
shader("Sheen BSDF: Ashikhmin", "ShaderNodeBsdfSheen", False, {"distribution": "ASHIKHMIN"}, Color=COLOR, Roughness=0.4)
shader(
    "Metallic BSDF: F82 tint",
    "ShaderNodeBsdfMetallic",
    False,
    {"fresnel_type": "F82"},
    Base_Color=COLOR,
    Edge_Tint=(0.6, 0.9, 0.7),
    Roughness=0.3,
)
shader(
    "Metallic BSDF: physical conductor",
    "ShaderNodeBsdfMetallic",
    False,
    {"fresnel_type": "PHYSICAL_CONDUCTOR"},
    IOR=(0.27, 0.68, 1.32),
    Extinction=(3.61, 2.63, 2.29),
    Roughness=0.3,
)
shader(
    "Metallic BSDF: thin film",
    "ShaderNodeBsdfMetallic",
    False,
    {"fresnel_type": "F82"},
    Base_Color=COLOR,
    Roughness=0.3,
    Thin_Film_Thickness=400.0,
    Thin_Film_IOR=1.5,
)
for _name, _method in (("random walk", "RANDOM_WALK"), ("legacy", "RANDOM_WALK_LEGACY")):
    shader(
        f"Subsurface Scattering: {_name}",
        "ShaderNodeSubsurfaceScattering",
        False,
        {"falloff": _method},
        Color=COLOR,
        Scale=0.3,
        Radius=(1.0, 0.5, 0.3),
        Roughness=0.7,
        IOR=1.4,
        Anisotropy=0.3,
    )
shader("Emission", "ShaderNodeEmission", Color=COLOR, Strength=1.5)


@feature("Glossy BSDF: anisotropy and tangent", "Shaders", "picture")
def glossy_anisotropic(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        tangent = graph.value("ShaderNodeTangent", direction_type="RADIAL", axis="Z")
        return graph.value(
            "ShaderNodeBsdfAnisotropic",
            {"Color": COLOR, "Roughness": 0.4, "Anisotropy": 0.7, "Rotation": 0.15, "Tangent": tangent},
        )

    studio(scene, surface)


@feature("Metallic BSDF: anisotropy", "Shaders", "picture")
def metallic_anisotropic(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        tangent = graph.value("ShaderNodeTangent", direction_type="RADIAL", axis="X")
        return graph.value(
            "ShaderNodeBsdfMetallic",
            {"Base Color": COLOR, "Roughness": 0.4, "Anisotropy": 0.6, "Tangent": tangent},
            fresnel_type="F82",
        )

    studio(scene, surface)


@feature("Holdout", "Shaders", "picture")
def holdout(scene: bpy.types.Scene) -> None:
    studio(scene, lambda graph: graph.value("ShaderNodeHoldout"))
    diffuse(ball("Other", (0.9, -0.8, 0.4), 0.4), COLOR)


@feature("Holdout: mixed", "Shaders", "picture")
def holdout_mixed(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        base = graph.value("ShaderNodeBsdfDiffuse", {"Color": COLOR})
        return graph.value("ShaderNodeMixShader", {0: 0.4, 1: graph.value("ShaderNodeHoldout"), 2: base})

    studio(scene, surface)


@feature("Mix Shader", "Shaders", "picture", quick=True)
def mix_shader(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        checker = graph.value(
            "ShaderNodeTexChecker", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.9}, "Fac"
        )
        glossy = graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.9, 0.9), "Roughness": 0.2})
        return graph.value(
            "ShaderNodeMixShader", {0: checker, 1: graph.value("ShaderNodeBsdfDiffuse", {"Color": COLOR}), 2: glossy}
        )

    studio(scene, surface)


@feature("Mix Shader: constant factor, nested", "Shaders", "picture")
def mix_constant(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        inner = graph.value(
            "ShaderNodeMixShader",
            {
                0: 0.3,
                1: graph.value("ShaderNodeBsdfTransparent"),
                2: graph.value("ShaderNodeBsdfTranslucent", {0: COLOR}),
            },
        )
        return graph.value(
            "ShaderNodeMixShader",
            {0: 0.6, 1: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.2, 0.5, 0.8)}), 2: inner},
        )

    studio(scene, surface)


@feature("Add Shader", "Shaders", "picture")
def add_shader(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        glow = graph.value("ShaderNodeEmission", {"Color": (0.1, 0.3, 0.6), "Strength": 0.5})
        glossy = graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.3, 0.3, 0.3), "Roughness": 0.3})
        both = graph.value("ShaderNodeAddShader", {0: glow, 1: glossy})
        return graph.value(
            "ShaderNodeAddShader", {0: both, 1: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.4, 0.3, 0.2)})}
        )

    studio(scene, surface)


@feature("Shaders with textured sockets", "Shaders", "picture")
def textured_sockets(scene: bpy.types.Scene) -> None:
    """Colour and roughness of one node, IOR of another, all from textures."""
    add_world(scene, 0.6, (0.6, 0.75, 1.0))
    floor()
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)

    def glossy(graph: Graph):
        noise = graph.node(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.0}
        )
        return graph.value(
            "ShaderNodeBsdfAnisotropic", {"Color": noise.outputs["Color"], "Roughness": noise.outputs["Fac"]}
        )

    def glass(graph: Graph):
        gradient = graph.value(
            "ShaderNodeTexGradient", {"Vector": graph.value("ShaderNodeTexCoord", output="Generated")}, "Fac"
        )
        return graph.value(
            "ShaderNodeBsdfGlass", {"Color": (0.9, 0.95, 1), "Roughness": 0.1, "IOR": graph.math("ADD", gradient, 1.1)}
        )

    material_graph(ball("Left", (-0.8, 0, 0.75), 0.75), glossy)
    material_graph(ball("Right", (0.8, 0, 0.75), 0.75), glass)
    look(scene, (0, -5, 2), (0, 0, 0.6), lens=50)
