"""Closures against Cycles' own, value by value.

Quads that are tilted by known angles are seen from above and lit by suns without extent: a pixel is the BSDF times the
cosine for one pair of directions, without noise. The same material, exported, gives the closures that our kernels
evaluate there.
"""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector

from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.export.materials import export_material
from tests.blender.features.compare import by_cycles, set_alike, set_bounces
from tests.core.shading.bsdf import closure_probe as probe
from tests.support.blender_builders import add_mesh, node_tree

pytestmark = pytest.mark.skipif(bpy.app.version < (5, 2), reason="the models are those of Cycles 5.2")

COSINES = (1.0, 0.95, 0.85, 0.7, 0.5, 0.35, 0.2, 0.1)
SUNS = np.array(
    [
        (0, 0, 1),
        (0.5, 0.3, 1),
        (1, 0, 0.4),
        (0.8, -0.7, 0.3),
        (-0.4, 0.2, 0.9),
        (1, 0.1, 0.1),
        (-0.5, 0.4, -0.6),
        (0.1, 0, -1),
    ],
    float,
)
SUNS /= np.linalg.norm(SUNS, axis=1, keepdims=True)
COLOR, TINT = (0.8, 0.5, 0.9), (0.6, 0.8, 1.0)
TANGENT = (1.0, 0.3, 0.2)
EXACT = 2e-5  # roundings of float32
TABLES = 6e-3  # our tables of albedos have 32 entries an axis, and those of Cycles 16 or 32
SERIES = 6e-3  # films: sensitivities every 5 nm, and two interpolations
# Cycles approximates Smith's term of Beckmann's facets by a rational fit, which is off by 0.4 %
FIT = 8e-3

GLOSSY, METALLIC, GLASS = "ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfMetallic", "ShaderNodeBsdfGlass"
DIFFUSE, REFRACTION, SHEEN = "ShaderNodeBsdfDiffuse", "ShaderNodeBsdfRefraction", "ShaderNodeBsdfSheen"
GOLD = {"IOR": (0.2, 0.9, 1.1), "Extinction": (3.9, 2.4, 2.2)}


def _of(distribution: str, **more) -> dict:
    return {"distribution": distribution, **more}


CASES = {
    "diffuse": (DIFFUSE, {}, {"Color": COLOR}, EXACT),
    "Oren-Nayar": (DIFFUSE, {}, {"Color": COLOR, "Roughness": 0.5}, EXACT),
    "Oren-Nayar 1": (DIFFUSE, {}, {"Color": COLOR, "Roughness": 1.0}, EXACT),
    "translucent": ("ShaderNodeBsdfTranslucent", {}, {"Color": COLOR}, 1e-4),
    "GGX": (GLOSSY, _of("GGX"), {"Color": COLOR, "Roughness": 0.5}, EXACT),
    "multiscatter GGX": (GLOSSY, _of("MULTI_GGX"), {"Color": COLOR, "Roughness": 0.5}, TABLES),
    "multiscatter GGX 1": (GLOSSY, _of("MULTI_GGX"), {"Color": COLOR, "Roughness": 1.0}, TABLES),
    "Beckmann": (GLOSSY, _of("BECKMANN"), {"Color": COLOR, "Roughness": 0.5}, FIT),
    "Beckmann 1": (GLOSSY, _of("BECKMANN"), {"Color": COLOR, "Roughness": 1.0}, FIT),
    "Ashikhmin-Shirley": (GLOSSY, _of("ASHIKHMIN_SHIRLEY"), {"Color": COLOR, "Roughness": 0.5}, EXACT),
    "Ashikhmin-Shirley 1": (GLOSSY, _of("ASHIKHMIN_SHIRLEY"), {"Color": COLOR, "Roughness": 1.0}, EXACT),
    "anisotropic GGX": (
        GLOSSY,
        _of("GGX"),
        {"Color": COLOR, "Roughness": 0.5, "Anisotropy": 0.6, "Tangent": TANGENT},
        EXACT,
    ),
    "anisotropic multiscatter GGX": (
        GLOSSY,
        _of("MULTI_GGX"),
        {"Color": COLOR, "Roughness": 0.7, "Anisotropy": -0.5, "Tangent": TANGENT},
        TABLES,
    ),
    "anisotropic Beckmann": (
        GLOSSY,
        _of("BECKMANN"),
        {"Color": COLOR, "Roughness": 0.5, "Anisotropy": 0.6, "Tangent": TANGENT},
        FIT,
    ),
    "anisotropic Ashikhmin-Shirley": (
        GLOSSY,
        _of("ASHIKHMIN_SHIRLEY"),
        {"Color": COLOR, "Roughness": 0.5, "Anisotropy": 0.6, "Tangent": TANGENT},
        5e-5,
    ),
    "metal": (
        METALLIC,
        _of("GGX", fresnel_type="F82"),
        {"Base Color": COLOR, "Edge Tint": TINT, "Roughness": 0.5},
        EXACT,
    ),
    "multiscatter metal": (
        METALLIC,
        _of("MULTI_GGX", fresnel_type="F82"),
        {"Base Color": COLOR, "Edge Tint": TINT, "Roughness": 0.8},
        TABLES,
    ),
    "metal of anisotropy 1": (
        METALLIC,
        _of("GGX", fresnel_type="F82"),
        {"Base Color": COLOR, "Roughness": 0.6, "Anisotropy": 1.0, "Tangent": TANGENT},
        EXACT,
    ),
    "conductor": (METALLIC, _of("GGX", fresnel_type="PHYSICAL_CONDUCTOR"), {**GOLD, "Roughness": 0.5}, EXACT),
    "multiscatter conductor": (
        METALLIC,
        _of("MULTI_GGX", fresnel_type="PHYSICAL_CONDUCTOR"),
        {**GOLD, "Roughness": 0.9},
        TABLES,
    ),
    "glass": (GLASS, _of("GGX"), {"Color": COLOR, "Roughness": 0.5, "IOR": 1.5}, 5e-5),
    "multiscatter glass": (GLASS, _of("MULTI_GGX"), {"Color": COLOR, "Roughness": 0.8, "IOR": 1.5}, TABLES),
    "Beckmann glass": (GLASS, _of("BECKMANN"), {"Color": COLOR, "Roughness": 0.5, "IOR": 1.5}, FIT),
    "refraction": (REFRACTION, _of("GGX"), {"Color": COLOR, "Roughness": 0.5, "IOR": 1.45}, EXACT),
    "Beckmann refraction": (REFRACTION, _of("BECKMANN"), {"Color": COLOR, "Roughness": 0.5, "IOR": 1.45}, FIT),
    "sheen": (SHEEN, _of("MICROFIBER"), {"Color": COLOR, "Roughness": 0.5}, 2e-4),
    "sheen 1": (SHEEN, _of("MICROFIBER"), {"Color": COLOR, "Roughness": 1.0}, 2e-4),
    "velvet": (SHEEN, _of("ASHIKHMIN"), {"Color": COLOR, "Roughness": 0.6}, 5e-5),
}
for _thickness, _index in ((0.5, 1.6), (200.0, 1.33), (500.0, 1.33), (1200.0, 2.0)):
    _film = {"Roughness": 0.5, "Thin Film Thickness": _thickness, "Thin Film IOR": _index}
    CASES |= {
        f"metal below {_thickness:g} nm": (
            METALLIC,
            _of("GGX", fresnel_type="F82"),
            {"Base Color": COLOR, "Edge Tint": TINT, **_film},
            SERIES,
        ),
        f"conductor below {_thickness:g} nm": (
            METALLIC,
            _of("GGX", fresnel_type="PHYSICAL_CONDUCTOR"),
            {**GOLD, **_film},
            SERIES,
        ),
        f"glass below {_thickness:g} nm": (GLASS, _of("GGX"), {"Color": COLOR, "IOR": 1.5, **_film}, SERIES),
    }


def _material(name: str) -> bpy.types.Material:
    kind, properties, inputs, _ = CASES[name]
    material = bpy.data.materials.new(name)
    tree, surface = node_tree(material)
    node = tree.nodes.new(kind)
    for key, value in properties.items():
        setattr(node, key, value)
    for key, value in inputs.items():
        if key == "Tangent":
            source = tree.nodes.new("ShaderNodeCombineXYZ")
            for axis in range(3):
                source.inputs[axis].default_value = value[axis]
            tree.links.new(source.outputs[0], node.inputs[key])
        else:
            node.inputs[key].default_value = (*value, 1.0) if node.inputs[key].type == "RGBA" else value
    tree.links.new(node.outputs[0], surface)
    return material


@pytest.fixture(scope="module")
def compared(addon, tmp_path_factory):
    """Exported closures by name, and Cycles' values by name: float64 [sun, cosine, 3]."""
    from tests.blender.features.compare import empty_scene

    scene = empty_scene()
    set_alike(scene)
    set_bounces(scene, 0)
    scene.world = None
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    vertices, faces = [], []
    for row in range(len(CASES)):
        for column, cosine in enumerate(COSINES):
            sine, half = np.sqrt(1 - cosine**2), 0.4 / cosine
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append((column + 0.5 + a * half * cosine, row + 0.5 + 0.4 * b, -a * half * sine))
            faces.append(range(len(vertices) - 4, len(vertices)))
    mesh = add_mesh("Quads", vertices, [tuple(face) for face in faces], scene).data
    for name in CASES:
        mesh.materials.append(_material(name))
    for index, face in enumerate(mesh.polygons):
        face.material_index = index // len(COSINES)
    exported = {name: export_material(mesh.materials[name])[0].closures for name in CASES}
    width, height = len(COSINES), len(CASES)
    scene.render.resolution_x, scene.render.resolution_y = width, height
    camera = scene.camera
    camera.location, camera.data.type, camera.data.ortho_scale, camera.data.clip_end = (
        (width / 2, height / 2, 100),
        "ORTHO",
        max(width, height),
        1e3,
    )
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle, sun.use_shadow = 1.0, 0.0, False
    lamp = bpy.data.objects.new("Sun", sun)
    scene.collection.objects.link(lamp)
    lamp.rotation_mode = "QUATERNION"
    pictures = []
    for direction in SUNS:
        lamp.rotation_quaternion = Vector(direction).to_track_quat("Z", "Y")
        pictures.append(by_cycles(scene, 0, 1, tmp_path_factory.mktemp("cycles") / "sun.exr"))
    values = np.array(pictures)
    return exported, {name: values[:, row, :width] for row, name in enumerate(CASES)}


def _refracts(normal: np.ndarray, sun: np.ndarray, index: float) -> bool:
    """Whether a facet could refract light from `sun` upwards; Cycles also evaluates half vectors that no facet has."""
    half = -(np.array([0, 0, 1.0]) + index * sun)
    half *= np.sign(half @ normal)
    return half[2] > 0 > half @ sun


@pytest.mark.parametrize("name", CASES)
def test_values_are_those_of_cycles(name, compared):
    exported, values = compared
    closures, theirs, tolerance = exported[name], values[name], CASES[name][3]
    assert len(closures) == 1
    passes = closures[0].kind in (K.GLASS, K.REFRACTION)
    for column, cosine in enumerate(COSINES):
        normal = np.array([np.sqrt(1 - cosine**2), 0, cosine])
        ours, _ = probe.evaluate(closures, (0, 0, 1), SUNS, probe.frame_of(normal, normal))
        for row, sun in enumerate(SUNS):
            if passes and sun @ normal < 0 and not _refracts(normal, sun, closures[0].ior):
                continue
            note = f"cosine {cosine}, sun {sun}"
            np.testing.assert_allclose(
                ours[row],
                theirs[row, column],
                rtol=tolerance,
                atol=2e-4 * theirs.max() * tolerance + 1e-9,
                err_msg=note,
            )
