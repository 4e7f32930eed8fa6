"""Sets of settings to start from: by the panels' menus, and `scripts/render.py --preset`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..errors import SettingsError
from .settings import SETTINGS


@dataclass(frozen=True)
class Preset:
    """Settings of the picture, or those of the schedule that differ from their defaults."""

    label: str
    description: str
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def changes_picture(self) -> bool:
        """Whether it sets samples and the like, and leaves the schedule as it is."""
        return any(SETTINGS[name].effect == "estimator" for name in self.settings)


def _picture(label: str, description: str, samples: int, noise: float, bounces: int, quality: str) -> Preset:
    settings = dict(
        sample_count=samples,
        adaptive_sampling="ON",
        noise_threshold=noise,
        bounce_max=bounces,
        denoise="ON",
        denoise_quality=quality,
    )
    return Preset(label, description, settings)


PRESETS = {
    "PREVIEW": _picture("Preview", "A first look, denoised", 32, 0.1, 4, "FAST"),
    "BALANCED": _picture("Balanced", "Few minutes for most scenes, denoised", 256, 0.03, 8, "BALANCED"),
    "FINAL": _picture("Final", "Little noise, and what is left denoised", 2048, 0.01, 12, "HIGH"),
    "AUTO": Preset("Automatic", "RayBatch chooses by device and scene"),
    # Table 4.2 of "Batching of divergent rays"; of its lists the values of the best run (table 4.3: Dragon, 31.4 s),
    # and the queues of 64 rays of chapter 6. What the thesis does not state (MIN_TREELETSIZE, QUEUECOUNT, the water
    # marks) is left to RayBatch, except that its treelets were cut where a child would have become smaller than the
    # size: they had 2,178 nodes on average (table 4.4).
    "THESIS": Preset(
        "Thesis",
        "The parameters of the thesis that RayBatch follows, its single warp included: slow",
        dict(
            batching="ON",
            sample_order="FRAME_FIRST",
            bucket_selection="MOST_FULL",
            top_level_traversal="NAIVE",
            ray_storage="DIRECT",
            ray_count=10_240,
            queue_size=64,
            treelet_size=800,
            treelet_size_min=800,
            top_level_depth_max=15,
            warp_count=1,
            register_cap=64,
            ray_sort="OFF",
            hit_sort="OFF",
        ),
    ),
    "UNBATCHED": Preset("Unbatched", "No queues: each ray visits the whole tree at once", dict(batching="OFF")),
}


def preset_settings(name: str) -> dict[str, Any]:
    """By name what the preset `name` sets: settings of the picture, or every one of the schedule but for where to
    render (group DEVICE). Raises `SettingsError`.
    """
    preset = PRESETS.get(name.strip().upper())
    if preset is None:
        raise SettingsError(f"no preset is called {name!r}; the presets are {', '.join(PRESETS)}")
    if preset.changes_picture:
        return dict(preset.settings)
    defaults = {
        info.name: info.default for info in SETTINGS.values() if info.effect == "schedule" and info.group != "DEVICE"
    }
    return defaults | preset.settings
