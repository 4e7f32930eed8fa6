"""Settings of a scene as its viewports have them, and what they leave out."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.settings.settings import RenderSettings
from ..settings import settings_from

# What decides when a final render ends, which in a viewport the number of samples does alone
_NO_END = dict(adaptive_sampling="OFF", error_estimate="OFF", error_target=0.0, time_limit=0.0)
SAMPLES_DEFAULT = 64


def live_settings(scene: bpy.types.Scene) -> RenderSettings:
    """The settings of viewports: those of the scene, but for their own number of samples and denoising. Raises
    `SettingsError`.
    """
    own = getattr(scene, "raybatch_viewport", None)
    samples, denoise = (own.samples, own.denoise) if own is not None else (SAMPLES_DEFAULT, False)
    settings = settings_from(scene).replace(sample_count=samples, denoise="ON" if denoise else "OFF", **_NO_END)
    return settings.replace(tile_order="TILE_FIRST")  # whole pictures come at their own pace


def pixel_side(scene: bpy.types.Scene, ui_scale: float = 1.0) -> int:
    """Side of the finest pixels of a viewport, in pixels of the screen, as `Scene.render.preview_pixel_size` has it."""
    chosen = scene.render.preview_pixel_size
    return max(1, round(ui_scale)) if chosen == "AUTO" else int(chosen)


def left_out(scene: bpy.types.Scene) -> list[str]:
    """What a final render of `scene` has and its viewports do not, by name."""
    render = scene.render
    lines = []
    if render.use_motion_blur:
        lines.append("motion blur")
    if render.use_multiview:
        lines.append("stereoscopy")
    settings = settings_from(scene)
    ends: dict[str, Any] = {
        "adaptive sampling": settings.is_adaptive,
        "time limit": settings.time_limit > 0,
        "stop at error": settings.error_target > 0,
    }
    return lines + [name for name, is_on in ends.items() if is_on]
