"""Which settings have a say beside the others: panels grey those that have none."""

from __future__ import annotations

from typing import Any

from ..core.settings.settings import SETTINGS

# Heard where rays wait in queues alone
_OF_BATCHING = {"bucket_selection", "bucket_wait_max", "top_level_traversal", "geometry_budget", "geometry_store"} | {
    info.name for info in SETTINGS.values() if info.group in ("QUEUES", "TREELETS")
}
_OF_CUDA = {"top_level_traversal", "register_cap", "block_size"}


def is_heard(settings: Any, name: str) -> bool:
    """Whether a setting has a say: no other already says what it would, or leaves nothing to say."""
    if name.startswith("denoise_"):
        guided = name != "denoise_prefilter" or settings.denoise_inputs != "NONE"
        return name == "denoise_library" or (settings.denoise == "ON" and guided)
    is_adaptive = settings.adaptive_sampling == "ON"
    if name == "error_estimate":
        return not (settings.error_target > 0 or is_adaptive)
    if name in ("noise_threshold", "adaptive_samples_min"):
        return is_adaptive
    if name == "mis":
        return settings.nee != "OFF"
    if name == "filter_width":
        return settings.pixel_filter != "BOX"
    if name == "texture_filter_width":
        return settings.texture_filter != "OFF"
    devices = {each.strip() for each in settings.device.lower().split(",")}
    if name in _OF_CUDA and devices == {"cpu"}:
        return False
    if name == "thread_count":  # AUTO and ALL may be the CPU
        return not devices.isdisjoint({"auto", "all", "cpu"})
    return name not in _OF_BATCHING or settings.batching in ("AUTO", "ON")
