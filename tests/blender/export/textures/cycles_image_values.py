"""What Cycles makes of an image texture, with the very coordinates at which it did."""

from __future__ import annotations

import bpy
import numpy as np
import OpenEXR

from tests.support.blender_builders import add_mesh, material_of, node_tree

SIZE = 32  # pixels of an edge


def set_up(scene: bpy.types.Scene, uv=(-1.3, 2.1)):
    """A plane before a flat camera, with texture coordinates from `uv[0]` to `uv[1]`; returns its node tree."""
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.max_bounces = "CPU", 1, 0
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2.0
    plane = add_mesh("Plane", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    layer = plane.data.uv_layers.new(name="UVMap")
    low, high = uv
    for corner, place in zip(layer.data, ((low, low), (high, low), (high, high), (low, high))):
        corner.uv = place
    tree, _ = node_tree(material_of(plane))
    return plane, tree


def values_by_cycles(scene: bpy.types.Scene, tree, path, **sockets) -> dict[str, np.ndarray]:
    """The values of output sockets in every pixel of one render, float64 [SIZE * SIZE, 3]."""
    layer = bpy.context.view_layer
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL").inputs["Surface"])
    for name, socket in sockets.items():
        layer.aovs.add().name = name
        node = tree.nodes.new("ShaderNodeOutputAOV")
        node.aov_name = name
        tree.links.new(socket, node.inputs["Color"])
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"
    scene.render.filepath = str(path / "values.exr")
    bpy.ops.render.render(write_still=True)
    return {name: _layer_of(scene.render.filepath, name) for name in sockets}


def _layer_of(path: str, name: str) -> np.ndarray:
    channels = {}
    for part in OpenEXR.File(path, separate_channels=True).parts:
        channels |= {
            (key if "." in key else f"{part.name()}.{key}"): value.pixels for key, value in part.channels.items()
        }
    found = [next(pixels for key, pixels in channels.items() if key.endswith(f".{name}.{letter}")) for letter in "RGB"]
    return np.stack(found, -1)[::-1].reshape(-1, 3).astype(float)
