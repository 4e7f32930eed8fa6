"""Passes that Blender's properties ask for.

Of the core it imports names alone: the engine is registered with it.
"""

from __future__ import annotations

import bpy

from ..core.denoise.picture import NOISY_CATCHER, NOISY_IMAGE
from ..core.scene.passes import AOV_COLOR, AOV_VALUE, CATCHER_PASS, GUIDE_PASSES, LIGHT_GROUP

# Passes that can be rendered, by the property of a view layer that asks for them
PASS_PROPERTIES = {
    "use_pass_z": "Depth",
    "use_pass_mist": "Mist",
    "use_pass_position": "Position",
    "use_pass_normal": "Normal",
    "use_pass_vector": "Vector",
    "use_pass_uv": "UV",
    "use_pass_object_index": "Object Index",
    "use_pass_material_index": "Material Index",
}
# The same for light, in the order in which Blender draws them
LIGHT_PASS_PROPERTIES = {
    f"use_pass_{component.lower()}_{part.lower()}": f"{component} {part}"
    for component in ("Diffuse", "Glossy", "Transmission")
    for part in ("Direct", "Indirect", "Color")
} | {
    "use_pass_emit": "Emission",
    "use_pass_environment": "Environment",
    "use_pass_ambient_occlusion": "Ambient Occlusion",
}
# Passes of volumes' light, by Cycles' own property of a view layer
VOLUME_PASS_PROPERTIES = {"use_pass_volume_direct": "Volume Direct", "use_pass_volume_indirect": "Volume Indirect"}
# Cycles' own property of a view layer that asks for the pass of shadow catchers
CATCHER_PROPERTY = "use_pass_shadow_catcher"
# Passes that show cost, by the property of a view layer's `raybatch`
COST_PASS_PROPERTIES = {
    "use_pass_rays": "Rays",
    "use_pass_node_steps": "Node Steps",
    "use_pass_triangle_tests": "Triangle Tests",
    "use_pass_treelet_visits": "Treelet Visits",
    "use_pass_times_queued": "Times Queued",
}
# Every pass by a property of a view layer's `raybatch`
OWN_PASS_PROPERTIES = {"use_pass_sample_count": "Sample Count"} | COST_PASS_PROPERTIES
# What denoised pictures were made of, which is kept beside them
# Names of passes before Blender 5, where they differ
_EARLIER_NAMES = {
    f"{component} {part}": short_component + short_part
    for component, short_component in (
        ("Diffuse", "Diff"),
        ("Glossy", "Gloss"),
        ("Transmission", "Trans"),
        ("Volume", "Volume"),
    )
    for part, short_part in (("Direct", "Dir"), ("Indirect", "Ind"), ("Color", "Col"))
} | {
    "Emission": "Emit",
    "Environment": "Env",
    "Ambient Occlusion": "AO",
    "Object Index": "IndexOB",
    "Material Index": "IndexMA",
}
# Kinds of mattes, by the property that asks for them
MATTE_PROPERTIES = {
    "use_pass_cryptomatte_object": "CryptoObject",
    "use_pass_cryptomatte_material": "CryptoMaterial",
    "use_pass_cryptomatte_asset": "CryptoAsset",
}
# What share of the samples of the pixel that has most each pixel has, by Cycles' own property of a view layer
SAMPLE_SHARE_PROPERTY, SAMPLE_SHARE = "pass_debug_sample_count", "Debug Sample Count"
# Beginnings of the names that passes of materials have in the film, by the type of an AOV
AOV_BEGINNINGS = {"COLOR": AOV_COLOR, "VALUE": AOV_VALUE}


def wanted_passes(view_layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """Names of the passes that are rendered for `view_layer`."""
    own = getattr(view_layer, "raybatch", None)  # missing while the add-on is not registered
    blenders = PASS_PROPERTIES | LIGHT_PASS_PROPERTIES
    passes = [name for prop, name in blenders.items() if getattr(view_layer, prop)]
    of_cycles = getattr(view_layer, "cycles", None)  # missing while that add-on is not enabled
    passes += [name for prop, name in VOLUME_PASS_PROPERTIES.items() if getattr(of_cycles, prop, False)]
    if getattr(of_cycles, CATCHER_PROPERTY, False):
        passes.append(CATCHER_PASS)
    if getattr(of_cycles, "denoising_store_passes", False):
        passes += GUIDE_PASSES
    passes += [name for prop, name in OWN_PASS_PROPERTIES.items() if getattr(own, prop, False)]
    levels = (min(16, view_layer.pass_cryptomatte_depth) + 1) // 2  # two in each pass, as in Cycles
    for prop, kind in MATTE_PROPERTIES.items():
        passes += [f"{kind}{i:02}" for i in range(levels) if getattr(view_layer, prop)]
    passes += [LIGHT_GROUP + group.name for group in view_layer.lightgroups]
    return ("Combined", *passes, *(name for name, _ in wanted_aovs(view_layer)))


def wants_sample_share(view_layer: bpy.types.ViewLayer) -> bool:
    """Whether the pass `SAMPLE_SHARE` is wanted of `view_layer`."""
    return getattr(getattr(view_layer, "cycles", None), SAMPLE_SHARE_PROPERTY, False)


def made_passes(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """Names of the passes that are made of a film of `view_layer` when all of it is there."""
    own = getattr(scene, "raybatch", None)
    noisy = []
    if own is not None and own.denoise == "ON":
        noisy = [NOISY_IMAGE, NOISY_CATCHER] if CATCHER_PASS in wanted_passes(view_layer) else [NOISY_IMAGE]
    return (*noisy, SAMPLE_SHARE) if wants_sample_share(view_layer) else tuple(noisy)


def wanted_aovs(view_layer: bpy.types.ViewLayer) -> list[tuple[str, str]]:
    """Names in the film and in Blender of the passes that materials write for `view_layer`."""
    return [(AOV_BEGINNINGS[aov.type] + aov.name, aov.name) for aov in view_layer.aovs if aov.is_valid]


def blender_name(name: str) -> str:
    """The name that Blender knows the film's pass `name` by."""
    for beginning in AOV_BEGINNINGS.values():
        if name.startswith(beginning):
            return name.removeprefix(beginning)
    return name if bpy.app.version >= (5, 0) else _EARLIER_NAMES.get(name, name)
