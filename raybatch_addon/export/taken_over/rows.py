"""Correspondence of settings: a row for each of ours that another engine has too."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...blender.denoise_library import why_not

CYCLES, EEVEE = "CYCLES", "EEVEE"


def exact(value: Any) -> Any:
    """`value` of a property of Blender, as it was typed."""
    return _typed(value) if isinstance(value, float) else value


@functools.lru_cache(maxsize=1024)
def _typed(value: float) -> float:
    # Blender keeps float32: the shortest decimal of the same float32 is the number that was typed, and lies within the
    # range
    return float(str(np.float32(value)))


@dataclass(frozen=True)
class Taken:
    """One of our settings, and how an engine's properties say it."""

    setting: str  # name in `RenderSettings`
    owner: str  # property of Blender's scene that holds the engine's settings
    name: str  # of the property there
    convert: Callable[[Any, Any], Any] = lambda value, _owner: value  # of the value and the engine's settings

    def value(self, scene: bpy.types.Scene) -> Any:
        """What the engine has; None where it has no such property."""
        owner = getattr(scene, self.owner, None)
        value = getattr(owner, self.name, None)
        return None if value is None else self.convert(exact(value), owner)

    def is_chosen(self, scene: bpy.types.Scene) -> bool:
        """Whether someone gave the property a value other than that of a new scene."""
        owner = getattr(scene, self.owner, None)
        if owner is None:
            return False
        kind: Any = type(owner)
        new = _new_value(kind, self.name)
        return new is not None and getattr(owner, self.name) != new


@functools.cache
def _new_value(kind: Any, name: str) -> Any:
    """The value of the property `name` in a new scene, for a type of Blender's structs; None: there is none."""
    prop = kind.bl_rna.properties.get(name)
    return None if prop is None else prop.default


def _switch(value: bool, _owner: Any) -> str:
    return "ON" if value else "OFF"


def _threshold(value: float, cycles: Any) -> float:
    """Cycles' noise threshold; 0 is one by the samples there (`Integrator::get_adaptive_sampling`)."""
    return value or max(0.001, 1 / max(1, cycles.samples))


def _denoise(value: bool, cycles: Any) -> str | None:
    """Whether some view layer is denoised; None where that cannot be had here."""
    scene = cycles.id_data
    if not (value and any(layer.use and layer.cycles.use_denoising for layer in scene.view_layers)):
        return "OFF"
    ours = getattr(scene, "raybatch", None)
    return None if ours is None or why_not(ours.denoise_library) else "ON"


# Passes that guide the denoiser, by Cycles' name for the picture and them
_GUIDED_BY = {"RGB": "NONE", "RGB_ALBEDO": "ALBEDO", "RGB_ALBEDO_NORMAL": "ALBEDO_NORMAL"}

_OF_CYCLES = (
    Taken("sample_count", "cycles", "samples"),
    Taken("adaptive_sampling", "cycles", "use_adaptive_sampling", _switch),
    Taken("noise_threshold", "cycles", "adaptive_threshold", _threshold),
    Taken("adaptive_samples_min", "cycles", "adaptive_min_samples"),
    Taken("time_limit", "cycles", "time_limit"),
    Taken("seed", "cycles", "seed"),
    Taken("bounce_max", "cycles", "max_bounces"),
    Taken("diffuse_bounce_max", "cycles", "diffuse_bounces"),
    Taken("glossy_bounce_max", "cycles", "glossy_bounces"),
    Taken("transmission_bounce_max", "cycles", "transmission_bounces"),
    Taken("volume_bounce_max", "cycles", "volume_bounces"),
    Taken("filter_glossy", "cycles", "blur_glossy"),
    Taken("caustics_reflective", "cycles", "caustics_reflective", _switch),
    Taken("caustics_refractive", "cycles", "caustics_refractive", _switch),
    Taken("transparent_bounce_max", "cycles", "transparent_max_bounces"),
    Taken("clamp_direct", "cycles", "sample_clamp_direct"),
    Taken("clamp_indirect", "cycles", "sample_clamp_indirect"),
    Taken("pixel_filter", "cycles", "pixel_filter_type"),
    Taken("filter_width", "cycles", "filter_width"),
    Taken("denoise", "cycles", "use_denoising", _denoise),
    Taken("denoise_inputs", "cycles", "denoising_input_passes", lambda value, _owner: _GUIDED_BY.get(value)),
    Taken("denoise_prefilter", "cycles", "denoising_prefilter"),
    Taken("denoise_quality", "cycles", "denoising_quality"),
)
# EEVEE's film has the filter of Cycles, with a width of its own
_OF_EEVEE = (
    Taken("sample_count", "eevee", "taa_render_samples"),
    Taken("clamp_direct", "eevee", "clamp_surface_direct"),
    Taken("clamp_indirect", "eevee", "clamp_surface_indirect"),
    Taken("pixel_filter", "render", "filter_size", lambda _width, _owner: "BLACKMAN_HARRIS"),
    Taken("filter_width", "render", "filter_size"),
)
ROWS = {CYCLES: _OF_CYCLES, EEVEE: _OF_EEVEE}
