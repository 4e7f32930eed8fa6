"""The statistics of a render: one documented schema, as JSON-ready values (see docs/statistics.md)."""

from __future__ import annotations

import dataclasses
import platform
import sys
from typing import Any

import numpy as np
import warp as wp

from ..device.devices import device_description, host_memory_peak
from ..scene.features import SceneFeatures
from ..settings.settings import RenderSettings
from ..version import VERSION

ENGINE = "RayBatch"


def versions() -> dict[str, str]:
    """Versions of what the render ran on; Blender's only when it is there."""
    found = {
        "raybatch": VERSION,
        "python": platform.python_version(),
        "warp": wp.config.version,
        "numpy": np.__version__,
        "platform": platform.platform(),
    }
    bpy = sys.modules.get("bpy")
    if bpy is not None and hasattr(bpy, "app"):
        found["blender"] = bpy.app.version_string
    return found


def render_statistics(
    *,
    device: wp.Device,
    settings: RenderSettings,
    features: SceneFeatures,
    frame: dict[str, Any],
    seconds: dict[str, float],
    rays: dict[str, int],
    samples: int,
    counts: dict[str, Any],
) -> dict[str, Any]:
    """The report of one render; `counts` holds what else was counted (see the schema)."""
    return {
        "engine": ENGINE,
        "versions": versions(),
        "device": device_description(device),
        "settings": dataclasses.asdict(settings),
        "frame": frame,
        "seconds": seconds,
        "samples": samples,
        "rays": {**rays, "total": sum(rays.values())},
        "rays_per_second": round(sum(rays.values()) / seconds["render"]) if seconds.get("render") else 0,
        "left_out": features.left_out(),
        "memory_peak": {"host": host_memory_peak(), "device": _device_memory_peak(device)},
        **counts,
    }


def _device_memory_peak(device: wp.Device) -> int:
    """Largest device memory that Warp held so far [bytes]; on the CPU the host's figure holds."""
    if not device.is_cuda or not wp.is_mempool_enabled(device):
        return 0
    return int(wp.get_mempool_used_mem_high(device))
