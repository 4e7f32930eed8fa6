"""The statistics of a render: one documented schema, as JSON-ready values (see docs/statistics.md)."""

from __future__ import annotations

import dataclasses
import platform
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from ..device.devices import device_description, device_memory_peak, host_memory_peak
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
    devices: Sequence[wp.Device],
    shares: Sequence[dict[str, Any]],
    settings: RenderSettings,
    features: SceneFeatures,
    frame: dict[str, Any],
    seconds: dict[str, float],
    rays: dict[str, int],
    samples: int,
    counts: dict[str, Any],
) -> dict[str, Any]:
    """The report of one render; `shares` says what each of `devices` did, and `counts` holds what else was counted (see
    the schema).
    """
    return {
        "engine": ENGINE,
        "versions": versions(),
        "device": device_description(devices[0]),
        "devices": [device_description(each) | share for each, share in zip(devices, shares, strict=True)],
        "settings": dataclasses.asdict(settings),
        "frame": frame,
        "seconds": seconds,
        "samples": samples,
        "rays": {**rays, "total": sum(rays.values())},
        "rays_per_second": round(sum(rays.values()) / seconds["render"]) if seconds.get("render") else 0,
        "left_out": features.left_out(),
        "memory_peak": {"host": host_memory_peak(), "device": max(map(device_memory_peak, devices))},
        **counts,
    }
