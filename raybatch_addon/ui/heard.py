"""Which settings have a say beside the others: panels grey those that have none, and say why."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from ..core.settings.settings import SETTINGS

_NOT_BATCHED = ("batching", {"OFF", "REFERENCE"})
_NOT_DENOISED = ("denoise", {"OFF"})
_STREAMING = ("schedule", {"STREAMING"})
_NOT_ADAPTIVE = ("adaptive_sampling", {"OFF"})


class _Given:
    """Numbers of bytes but 0, also as the text that properties keep."""

    def __contains__(self, value: object) -> bool:
        return str(value) != "0"


_CACHED, _IN_TIERS = ("treelet_cache", _Given()), ("treelet_tier_bytes", _Given())
# Values of other settings that leave a setting nothing to say
_SILENCED_BY: dict[str, tuple[tuple[str, Container], ...]] = {
    "noise_threshold": (_NOT_ADAPTIVE,),
    "adaptive_samples_min": (_NOT_ADAPTIVE,),
    "mis": (("nee", {"OFF"}),),
    "filter_width": (("pixel_filter", {"BOX"}),),
    "texture_filter_width": (("texture_filter", {"OFF"}),),
    "denoise_inputs": (_NOT_DENOISED,),
    "denoise_prefilter": (_NOT_DENOISED, ("denoise_inputs", {"NONE"})),
    "denoise_quality": (_NOT_DENOISED,),
    # where no rays wait in queues
    "bucket_selection": (_NOT_BATCHED,),
    "bucket_processors": (
        _NOT_BATCHED,
        ("bucket_selection", {"AUTO", "MOST_FULL", "NEXT", "RANDOM", "ALL", "BALANCED"}),
        _STREAMING,
    ),
    "bucket_wait_max": (_NOT_BATCHED, _STREAMING),
    "queues_per_ray": (_NOT_BATCHED, _CACHED, _IN_TIERS, ("top_level_traversal", {"SHORT_SEGMENT"}), _STREAMING),
    "treelet_cache": (_NOT_BATCHED, _STREAMING),
    "treelet_prefetch": (_NOT_BATCHED, _STREAMING),
    "top_level_traversal": (_NOT_BATCHED, _CACHED, _STREAMING),
    "geometry_budget": (_NOT_BATCHED,),
    "geometry_store": (_NOT_BATCHED,),
    **{info.name: (_NOT_BATCHED,) for info in SETTINGS.values() if info.group in ("QUEUES", "TREELETS")},
    "treelet_tier_bytes": (_NOT_BATCHED, _CACHED, _STREAMING),
    # queues on the device have their own order, size and checks
    "queue_size": (_NOT_BATCHED, _STREAMING),
    "queue_count": (_NOT_BATCHED, _STREAMING),
    "ray_storage": (_NOT_BATCHED, _STREAMING),
    **dict.fromkeys(("ray_sort", "hit_sort", "ray_low_water", "ray_high_water"), (_STREAMING,)),
    **dict.fromkeys(("single_lane", "block_size", "kernel_tier"), (_STREAMING,)),
}
_OF_CUDA = {"top_level_traversal", "register_cap", "block_size"}


def why_unheard(settings: Any, name: str) -> str:
    """Why a setting has no say now: which other one already says what it would, or leaves nothing to say. Empty where
    it has a say.

    `settings`: `RenderSettings`, or properties named alike.
    """
    if name == "debug_checks" and settings.schedule == "STREAMING":
        return ""  # its queues are checked whether rays wait at treelets or not
    for ruling, values in _SILENCED_BY.get(name, ()):
        if getattr(settings, ruling) in values:
            is_given = isinstance(values, _Given)
            return (
                f"Unused with {SETTINGS[ruling].label if is_given else setting_text(ruling, getattr(settings, ruling))}"
            )
    if name == "ray_storage" and settings.queues_per_ray > 1 and not why_unheard(settings, "queues_per_ray"):
        return f"Unused with {setting_text('queues_per_ray', settings.queues_per_ray)}"
    if name == "error_estimate":
        ruling = implies_error_estimate(settings)
        return f"Implied by {SETTINGS[ruling].label}" if ruling else ""
    devices = {each.strip() for each in settings.device.lower().split(",")}
    if name in _OF_CUDA and devices == {"cpu"}:
        return "Unused on the CPU"
    if name == "thread_count" and devices.isdisjoint({"auto", "all", "cpu"}):  # AUTO and ALL may be the CPU
        return "Unused without the CPU"
    return ""


def implies_error_estimate(settings: Any) -> str:
    """The name of a setting by which the error is estimated whatever Error Estimate says; empty where there is none."""
    if settings.adaptive_sampling == "ON":
        return "adaptive_sampling"
    return "error_target" if settings.error_target > 0 else ""


def setting_text(name: str, value: Any) -> str:
    """A setting and its value as the panel names them."""
    return f"{SETTINGS[name].label} {'off' if value == 'OFF' else SETTINGS[name].name_of(value)}"
