#!/usr/bin/env python3
"""Measures raybatch_addon/core/shading/bsdf/sheen.npz, the fit of a layer of fibres that `shading/bsdf/sheen.py`
describes. Needs bpy 5.2.

Cycles renders quads of known tilt and roughness under suns without extent, so that each pixel is one value of its
sheen, without noise. The inverse square root of such a value over the cosine is linear in three numbers that hold the
lobe's albedo, scale and tilt: eight suns determine them. Takes a minute; the file is part of the repository.
"""

import math
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

SIZE = 32  # of the table in roughness and cosine
# The places that are measured: along a row of the table the lobe is linear, so that two of the first cell show what is
# at its end
COSINES = np.array([0.4, 0.8, *range(1, SIZE)]) / (SIZE - 1)
ROUGHNESS_LEAST = 1e-3  # Cycles takes what is below as this
ROUGHNESSES = np.array([ROUGHNESS_LEAST, *(np.arange(1, SIZE) / (SIZE - 1))])
SUNS = np.array(
    [
        (1, 0, 0.05),
        (1, 0.5, 0.3),
        (0.5, 0.3, 1),
        (0.2, -0.6, 1),
        (1, -0.8, 0.9),
        (1, 0, 1),
        (0.9, 0.2, -0.05),
        (0.3, 0, 0.2),
    ]
)
ALBEDO_LEAST = 1e-6  # of a lobe that differs from nothing


def build_scene():
    """The quads, a row for each roughness; returns (scene, sun)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.world = "CYCLES", None
    cycles = scene.cycles
    cycles.samples, cycles.max_bounces, cycles.use_denoising, cycles.use_adaptive_sampling = 1, 0, False, False
    cycles.light_sampling_threshold = cycles.sample_clamp_direct = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    image = scene.render.image_settings
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = (
        len(COSINES),
        len(ROUGHNESSES),
        100,
    )

    vertices = []
    for row in range(len(ROUGHNESSES)):
        for column, cosine in enumerate(COSINES):
            half, sine = 0.4 / cosine, math.sqrt(1 - cosine**2)
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append((column + 0.5 + a * half * cosine, row + 0.5 + 0.4 * b, -a * half * sine))
    mesh = bpy.data.meshes.new("Quads")
    mesh.from_pydata(vertices, [], np.arange(len(vertices)).reshape(-1, 4).tolist())
    for roughness in ROUGHNESSES:
        material = bpy.data.materials.new("Sheen")
        tree = material.node_tree
        tree.nodes.clear()
        sheen, output = tree.nodes.new("ShaderNodeBsdfSheen"), tree.nodes.new("ShaderNodeOutputMaterial")
        sheen.inputs["Color"].default_value, sheen.inputs["Roughness"].default_value = (1, 1, 1, 1), roughness
        tree.links.new(sheen.outputs[0], output.inputs["Surface"])
        mesh.materials.append(material)
    for index, face in enumerate(mesh.polygons):
        face.material_index = index // len(COSINES)
    scene.collection.objects.link(bpy.data.objects.new("Quads", mesh))

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.clip_end = (len(COSINES) / 2, len(ROUGHNESSES) / 2, 1000), 1e4
    camera.data.type, camera.data.ortho_scale = "ORTHO", max(len(COSINES), len(ROUGHNESSES))
    scene.collection.objects.link(camera)
    scene.camera = camera
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy, light.angle, light.use_shadow = 1.0, 0.0, False
    sun = bpy.data.objects.new("Sun", light)
    sun.rotation_mode = "QUATERNION"
    scene.collection.objects.link(sun)
    return scene, sun


def measured_values() -> np.ndarray:
    """BSDF times cosine, shape [sun, roughness, cosine]."""
    scene, sun = build_scene()
    values = []
    with tempfile.TemporaryDirectory() as folder:
        for number, direction in enumerate(SUNS):
            sun.rotation_quaternion = Vector(direction).to_track_quat("Z", "Y")
            scene.render.filepath = str(Path(folder) / f"{number}.exr")
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(scene.render.filepath)
            image.colorspace_settings.name = "Non-Color"
            pixels = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(pixels)
            values.append(pixels.reshape(image.size[1], image.size[0], -1)[..., 0])
    return np.array(values, np.float64)


def lobe_of(values: np.ndarray, cosine: float) -> tuple[float, float, float]:
    """Albedo, scale and tilt from the values under each sun; albedo 0 where there is nothing to see."""
    sine = math.sqrt(1 - cosine**2)
    normal = np.array([sine, 0, cosine])
    along = np.array([-cosine, 0, sine]) if sine > 0 else np.array([1.0, 0, 0])
    local = SUNS / np.linalg.norm(SUNS, axis=1, keepdims=True) @ np.stack([along, np.cross(normal, along), normal], 1)
    lit = (local[:, 2] > 1e-3) & (values > 0)
    if lit.sum() < 3:
        return 0.0, 0.0, 0.0
    x, y, z = local[lit].T
    inverse = np.sqrt(z / values[lit])
    p, q, r = np.linalg.lstsq(
        np.stack([x * x + y * y, 2 * x * z, z * z], 1) / inverse[:, None], np.ones(lit.sum()), rcond=None
    )[0]
    scale = 1 / math.sqrt(r / p - (q / p) ** 2)
    return math.pi * scale**2 / p**2, scale, scale * q / p


def at_nodes(places: np.ndarray) -> np.ndarray:
    """From the measured places to those of the table, shape [SIZE, SIZE]."""
    first = places[:, 0] + (places[:, 0] - places[:, 1])
    table = np.concatenate([first[:, None], places[:, 2:]], 1)
    part = ROUGHNESS_LEAST * (SIZE - 1)
    table[0] = (table[0] - part * table[1]) / (1 - part)
    return table


def main():
    """Measures and writes the file."""
    values = measured_values()
    lobes = np.array(
        [[lobe_of(values[:, i, j], cosine) for j, cosine in enumerate(COSINES)] for i in range(len(ROUGHNESSES))]
    )
    nothing = ~np.isfinite(lobes).all(-1) | (lobes[..., 0] < ALBEDO_LEAST)
    lobes[nothing, 0] = 0
    for i in range(SIZE - 2, -1, -1):  # where there is no lobe its shape goes on
        lobes[i, nothing[i], 1:] = lobes[i + 1, nothing[i], 1:]
    albedo, scale, tilt = (at_nodes(lobes[..., k]).astype(np.float32) for k in range(3))
    np.savez_compressed(
        Path(__file__).parents[2] / "raybatch_addon/core/shading/bsdf/sheen.npz",
        albedo=np.clip(albedo, 0, 1),
        scale=np.maximum(scale, 0),
        tilt=tilt,
    )


if __name__ == "__main__":
    main()
