"""Sets of schedule settings to start from: by the panel's menu, and `scripts/render.py --preset`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..errors import SettingsError
from .settings import SETTINGS


@dataclass(frozen=True)
class Preset:
    """Schedule settings that differ from their defaults."""

    label: str
    description: str
    settings: dict[str, Any] = field(default_factory=dict)


PRESETS = {
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
    """Every schedule setting by name as the preset `name` has it, but for where to render (group DEVICE); raises
    `SettingsError`.
    """
    preset = PRESETS.get(name.strip().upper())
    if preset is None:
        raise SettingsError(f"no preset is called {name!r}; the presets are {', '.join(PRESETS)}")
    defaults = {
        info.name: info.default for info in SETTINGS.values() if info.effect == "schedule" and info.group != "DEVICE"
    }
    return defaults | preset.settings
