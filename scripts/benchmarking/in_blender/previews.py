"""How long previews of materials, worlds and lights take: asked for as Blender's panels do."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from lib.node_trees import with_nodes

import raybatch_addon
from benchmarking.progress import Steps
from raybatch_addon.blender import preview
from raybatch_addon.core.errors import SceneError

BOUND_SECONDS = 1.0  # of a preview whose kernels are loaded


@dataclass(frozen=True)
class _Kind:
    """What is previewed: how it is made, and what an edit of it is."""

    make: Callable[[], Any]
    edit: Callable[[Any, int], None]


def _material() -> bpy.types.Material:
    return with_nodes(bpy.data.materials.new("Previewed"))


def _color_material(material: bpy.types.Material, step: int) -> None:
    base = material.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    base.default_value = (0.1 + 0.8 * (step % 7) / 7, 0.3, 0.2, 1)


def _world() -> bpy.types.World:
    return with_nodes(bpy.data.worlds.new("Previewed"))


def _color_world(world: bpy.types.World, step: int) -> None:
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1 + 0.8 * (step % 7) / 7, 0.3, 0.2, 1)


def _light() -> bpy.types.Light:
    return bpy.data.lights.new("Previewed", "AREA")


def _color_light(light: bpy.types.Light, step: int) -> None:
    light.color = (0.1 + 0.8 * (step % 7) / 7, 0.3, 0.2)


KINDS = {
    "material": _Kind(_material, _color_material),
    "world": _Kind(_world, _color_world),
    "light": _Kind(_light, _color_light),
}


def measure_previews(runs: int) -> dict[str, Any]:
    """The report of `benchmark.py previews`; raises `RayBatchError`."""
    raybatch_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.engine = "RAYBATCH"
    steps, rows = Steps(len(KINDS)), []
    for name, kind in KINDS.items():
        steps.begin(f"previews: {name}")
        rows.append({"of": name, **_measured(kind, runs)})
        steps.end()
    steps.close()
    settings = preview.PREVIEW_SETTINGS
    return {
        "device": settings.device,
        "samples_per_pixel": settings.sample_count,
        "time_limit_seconds": settings.time_limit,
        "bound_seconds": BOUND_SECONDS,
        "previews": rows,
        "within_bound": all(each["most"] <= BOUND_SECONDS for each in rows),
    }


def _measured(kind: _Kind, runs: int) -> dict[str, Any]:
    """The first preview, which loads what it needs, and `runs` more, each of another color."""
    block, seconds, size = kind.make(), [], (0, 0)
    shown = np.zeros(0)
    for step in range(runs + 1):
        kind.edit(block, step)
        start = time.perf_counter()
        block.preview_ensure()
        block.asset_generate_preview()  # without a window it is there when this returns
        seconds.append(time.perf_counter() - start)
        size, before = tuple(block.preview.image_size), shown
        shown = np.array(block.preview.image_pixels_float[:])
        if not shown.any() or np.array_equal(shown, before):
            raise SceneError(f"a preview of “{block.name}” shows nothing new; --verbose passes on what Blender says")
    first, warm = seconds[0], sorted(seconds[1:])
    return {
        "pixels": list(size),
        "first": round(first, 4),
        "median": round(statistics.median(warm), 4),
        "most": round(warm[-1], 4),
        "runs": runs,
    }
