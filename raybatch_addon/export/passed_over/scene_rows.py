"""Settings of a scene and its view layer that are passed over, Blender's own and those of Cycles."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.scene.notice import Weight
from ..settings import settings_from
from .row import Row, unlike_new


def _cycles(scene: bpy.types.Scene) -> Any:
    return getattr(scene, "cycles", None)  # there as long as that add-on is enabled


def _cycles_of(layer: bpy.types.ViewLayer) -> Any:
    return getattr(layer, "cycles", None)


def _denoises(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether Cycles would denoise, by a choice that someone made, and RayBatch does not.

    It is on in new scenes of every engine: that alone is no choice.
    """
    own = _cycles(scene)
    if settings_from(scene).denoise == "ON":
        return False
    chosen = own is not None and own.use_denoising and own.is_property_set("use_denoising")
    return chosen and _cycles_of(layer).use_denoising


def _denoises_all(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether the layer is denoised here, and would not be in Cycles, which denoises others."""
    own = _cycles(scene)
    is_off = own is not None and own.use_denoising and not _cycles_of(layer).use_denoising
    return is_off and settings_from(scene).denoise == "ON"


def _cycles_passes(_scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> str:
    return unlike_new(
        _cycles_of(layer),
        "pass_render_time",
        "use_pass_volume_scatter",
        "use_pass_volume_transmit",
        "use_pass_volume_majorant",
    )


def _denoising_data(_scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether Cycles would write what its denoiser knows of surfaces since Blender 5.2."""
    own = _cycles_of(layer)
    return hasattr(own, "denoising_pass_use_albedo_roughness_weighting") and own.denoising_store_passes


def _apart_behind_glass(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    own = _cycles(scene)
    if not (own and scene.render.film_transparent and own.film_transparent_glass):
        return False
    seen = [obj for obj in layer.objects if obj.type != "LIGHT"]
    return any(obj.is_shadow_catcher or obj.is_holdout or obj.holdout_get(view_layer=layer) for obj in seen)


def _biased(scene: bpy.types.Scene, _layer: bpy.types.ViewLayer) -> str:
    own = _cycles(scene)
    if not getattr(own, "volume_biased", False):  # Cycles before 5.0 has no other way, and no such property
        return ""
    return unlike_new(own, "volume_biased", "volume_step_rate", "volume_max_steps")


def _subset(scene: bpy.types.Scene, _layer: bpy.types.ViewLayer) -> str:
    own = _cycles(scene)
    if not getattr(own, "use_sample_subset", False):
        return ""
    return unlike_new(own, "use_sample_subset", "sample_offset", "sample_subset_length")


def _simplified(scene: bpy.types.Scene, _layer: bpy.types.ViewLayer) -> str:
    if not scene.render.use_simplify:
        return ""
    own = _cycles(scene)
    return unlike_new(own, "texture_limit_render", "texture_resolution_render", "use_camera_cull", "use_distance_cull")


def _world(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    return (getattr(layer, "world_override", None) or scene.world) if layer.use_sky else None


def _caustics_of_world(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    return getattr(getattr(_world(scene, layer), "cycles", None), "is_caustics_light", False)


SCENE_ROWS = (
    Row(
        "shadow caustics of Cycles are not supported: the world's light comes through glass by whole paths alone",
        _caustics_of_world,
        Weight.SETTING,
        "turn off Shadow Caustics in the world's settings of Cycles",
    ),
    Row(
        "these passes of Cycles are not supported yet and stay empty: {found}",
        _cycles_passes,
        Weight.MISSING,
        "turn them off in the view layer's passes",
    ),
    Row(
        "the passes Denoising Specular Albedo and Denoising Roughness of Cycles are not supported yet and are left out",
        _denoising_data,
        Weight.SETTING,
        "denoise by Denoising Albedo and Denoising Normal, or turn off Denoising Data in the view layer's passes",
    ),
    Row(
        "Denoise is on in Cycles and off in RayBatch: the picture keeps its noise",
        _denoises,
        Weight.SETTING,
        "turn on Denoise in RayBatch's panel Denoise, or turn it off in Cycles' sampling settings",
    ),
    Row(
        "Denoising is off for the view layer in Cycles, and not heard: Denoise of RayBatch is for all of them",
        _denoises_all,
        Weight.SETTING,
        "turn off Denoise in RayBatch's panel Denoise, or turn on Denoising of the view layer",
    ),
    Row(
        "Transparent Glass: behind glass shadow catchers and holdout objects are neither, and shown as they are",
        _apart_behind_glass,
        Weight.REPLACED,
        "turn off Transparent Glass in the film's settings",
    ),
    Row(
        "Cycles' fast global illumination is not supported: late bounces are traced",
        lambda scene, _layer: getattr(_cycles(scene), "use_fast_gi", False),
        Weight.REPLACED,
        "turn off Fast GI Approximation in Cycles' light path settings",
    ),
    Row(
        "Cycles would render volumes in steps; here they are rendered without bias, and these are not heard: {found}",
        _biased,
        Weight.SETTING,
        "turn off Biased in Cycles' volume settings",
    ),
    Row("these settings of Simplify are not supported: {found}", _simplified, Weight.REPLACED, "turn off Simplify"),
    Row(
        "the layer's own number of samples is not heard: {found}",
        lambda scene, layer: (
            layer.samples and getattr(_cycles(scene), "use_layer_samples", "IGNORE") != "IGNORE" and layer.samples
        ),
        Weight.SETTING,
        "set Samples in RayBatch's sampling settings",
    ),
    Row(
        "Cycles would render a part of the samples; here all of them are rendered, and these are not heard: {found}",
        _subset,
        Weight.SETTING,
        "turn off Sample Subset in Cycles' sampling settings, and set Samples in RayBatch's",
    ),
    Row(
        "these settings of Cycles are not heard: {found}",
        lambda scene, _layer: unlike_new(
            _cycles(scene),
            "use_guiding",
            "shading_system",
            "use_animated_seed",
            "min_light_bounces",
            "min_transparent_bounces",
        ),
        Weight.SETTING,
    ),
)
