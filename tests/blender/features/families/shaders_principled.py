"""The Principled BSDF of Blender 5.2, socket by socket."""

import bpy

from tests.blender.features.build import studio
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature

BASE = {"Base Color": (0.8, 0.45, 0.2), "Roughness": 0.4}
ALBEDO = (0.9, 0.9, 0.95)

SOCKETS = {
    "base and roughness": {},
    "smooth": {"Roughness": 0.0},
    "rough": {"Roughness": 1.0},
    "metallic": {"Metallic": 1.0, "Roughness": 0.25},
    "half metallic": {"Metallic": 0.5},
    "IOR": {"IOR": 2.2},
    "IOR below 1": {"IOR": 0.8, "Roughness": 0.3},
    "alpha": {"Alpha": 0.4},
    "diffuse roughness": {"Diffuse Roughness": 0.9},
    "specular level": {"Specular IOR Level": 0.9},
    "no specular": {"Specular IOR Level": 0.0},
    "specular tint": {"Specular Tint": (0.2, 0.9, 0.4), "IOR": 1.8},
    "specular tint of metal": {"Specular Tint": (0.9, 0.4, 0.5), "Metallic": 1.0, "Roughness": 0.3},
    "transmission": {"Transmission Weight": 1.0, "Roughness": 0.2, "Base Color": ALBEDO},
    "sharp transmission": {"Transmission Weight": 1.0, "Roughness": 0.0, "Base Color": ALBEDO},
    "half transmission": {"Transmission Weight": 0.5},
    "transmission with tint and level": {
        "Transmission Weight": 1.0,
        "Roughness": 0.3,
        "Specular Tint": (0.3, 0.8, 1.0),
        "Specular IOR Level": 0.8,
    },
    "coat": {"Coat Weight": 1.0, "Coat Roughness": 0.1, "Roughness": 0.8},
    "coat with tint": {"Coat Weight": 0.8, "Coat Roughness": 0.05, "Coat Tint": (0.9, 0.5, 0.3), "Coat IOR": 1.8},
    "coat over metal": {"Coat Weight": 1.0, "Coat Roughness": 0.3, "Coat Tint": (0.4, 0.7, 0.9), "Metallic": 1.0},
    "sheen": {"Sheen Weight": 1.0, "Sheen Roughness": 0.5, "Base Color": (0.1, 0.05, 0.15)},
    "sheen with tint": {"Sheen Weight": 0.7, "Sheen Roughness": 0.3, "Sheen Tint": (1.0, 0.4, 0.2)},
    "emission": {"Emission Color": (0.2, 0.5, 1.0), "Emission Strength": 0.8},
    "thin film": {
        "Thin Film Thickness": 500.0,
        "Thin Film IOR": 1.4,
        "Specular IOR Level": 1.0,
        "IOR": 1.8,
        "Roughness": 0.2,
    },
    "thin film of metal": {"Thin Film Thickness": 350.0, "Thin Film IOR": 1.6, "Metallic": 1.0, "Roughness": 0.25},
    "thin film of glass": {
        "Thin Film Thickness": 400.0,
        "Thin Film IOR": 1.6,
        "Transmission Weight": 1.0,
        "Roughness": 0.15,
        "Base Color": ALBEDO,
    },
    "thin wall": {"Thin Wall": True, "Transmission Weight": 1.0, "Roughness": 0.2},
    "thin film of a thin wall": {
        "Thin Wall": True,
        "Transmission Weight": 1.0,
        "Roughness": 0.2,
        "Thin Film Thickness": 400.0,
        "Thin Film IOR": 1.6,
    },
    "subsurface": {"Subsurface Weight": 1.0, "Subsurface Radius": (1.0, 0.4, 0.2), "Subsurface Scale": 0.2},
    "everything": {
        "Metallic": 0.3,
        "Roughness": 0.35,
        "IOR": 1.6,
        "Alpha": 0.9,
        "Diffuse Roughness": 0.3,
        "Specular IOR Level": 0.7,
        "Specular Tint": (0.9, 0.8, 1.0),
        "Transmission Weight": 0.3,
        "Coat Weight": 0.5,
        "Coat Roughness": 0.2,
        "Coat Tint": (1.0, 0.9, 0.8),
        "Sheen Weight": 0.4,
        "Emission Color": (0.1, 0.2, 0.4),
        "Emission Strength": 0.2,
    },
}
QUICK = ("coat",)


def _principled(name: str, inputs: dict, **properties) -> None:
    @feature(f"Principled BSDF: {name}", "Shaders", "picture", quick=name in QUICK)
    def build(scene: bpy.types.Scene) -> None:
        studio(scene, lambda graph: graph.value("ShaderNodeBsdfPrincipled", BASE | inputs, **properties))


for _name, _inputs in SOCKETS.items():
    _principled(_name, _inputs)
_SKIN = {
    "Subsurface Weight": 0.7,
    "Subsurface Radius": (1.0, 0.4, 0.2),
    "Subsurface Scale": 0.15,
    "Subsurface Anisotropy": 0.6,
    "Subsurface IOR": 1.4,
}
_principled("subsurface of skin", _SKIN, subsurface_method="RANDOM_WALK_SKIN")
_principled(
    "anisotropic subsurface", _SKIN | {"Subsurface Weight": 1.0, "Roughness": 0.2}, subsurface_method="RANDOM_WALK"
)
_principled("multiscatter GGX", {"Metallic": 1.0, "Roughness": 0.8}, distribution="MULTI_GGX")
_principled(
    "multiscatter GGX, transmission",
    {"Transmission Weight": 1.0, "Roughness": 0.6, "Base Color": ALBEDO},
    distribution="MULTI_GGX",
)


@feature("Principled BSDF: anisotropy and tangent", "Shaders", "picture")
def anisotropy(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        tangent = graph.value("ShaderNodeTangent", direction_type="RADIAL", axis="Z")
        inputs = {"Metallic": 1.0, "Anisotropic": 0.8, "Anisotropic Rotation": 0.1, "Tangent": tangent}
        return graph.value("ShaderNodeBsdfPrincipled", BASE | inputs)

    studio(scene, surface)


@feature("Principled BSDF: coat normal", "Shaders", "picture")
def coat_normal(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        wave = graph.value(
            "ShaderNodeTexWave", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.0}, "Fac"
        )
        bump = graph.value("ShaderNodeBump", {"Height": wave, "Distance": 0.1})
        return graph.value(
            "ShaderNodeBsdfPrincipled", BASE | {"Coat Weight": 1.0, "Coat Roughness": 0.15, "Coat Normal": bump}
        )

    studio(scene, surface)


@feature("Principled BSDF: subsurface of a bumped texture", "Shaders", "picture")
def subsurface_bump(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        coordinates = graph.value("ShaderNodeTexCoord", output="Object")
        noise = graph.node("ShaderNodeTexNoise", {"Vector": coordinates, "Scale": 3.0})
        bump = graph.value("ShaderNodeBump", {"Height": noise.outputs["Fac"], "Distance": 0.2})
        medium = {"Subsurface Weight": 0.8, "Subsurface Radius": (0.6, 0.5, 0.4), "Subsurface Scale": 0.1}
        return graph.value("ShaderNodeBsdfPrincipled", medium | {"Base Color": noise.outputs["Color"], "Normal": bump})

    studio(scene, surface)


@feature("Principled BSDF: textured", "Shaders", "picture", quick=True)
def textured(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        coordinates = graph.value("ShaderNodeTexCoord", output="Object")
        noise = graph.node("ShaderNodeTexNoise", {"Vector": coordinates, "Scale": 1.5})
        checker = graph.value("ShaderNodeTexChecker", {"Vector": coordinates, "Scale": 2.3}, "Fac")
        inputs = {"Base Color": noise.outputs["Color"], "Roughness": noise.outputs["Fac"], "Metallic": checker}
        return graph.value("ShaderNodeBsdfPrincipled", inputs)

    studio(scene, surface)
