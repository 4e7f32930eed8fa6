"""Tiers of kernels: general ones, which shade any scene, and ones that are specialised on a scene.

The general kernels are compiled once, ahead; a scene whose specialised kernels are not there yet is rendered by them at
once. Both tiers compute the same bits: a feature that a scene lacks is left out of its specialised kernels, and has
nothing to do in the general ones.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from dataclasses import dataclass

import warp as wp

from ..device.devices import is_compiled, shipped_target
from ..errors import SettingsError
from ..programs.footprints import LEVEL_OPS
from ..programs.op import op_named, op_numbers
from ..scene.description import ClosureKind, LightKind
from ..scene.features import SceneFeatures
from ..scene.passes import GUIDE_PASSES, PASSES
from ..scene.program import ProgramFeatures
from ..shading.bsdf.materials import HAIR_KINDS
from .estimates.kernels import estimate_kernel
from .estimates.work import Estimate
from .kernels import StageKernels
from .stages.work import ShadingStage

VARIABLE = "RAYBATCH_KERNEL_TIER"
TIERS = ("AUTO", "GENERAL", "SPECIALISED")
# Programs that need more registers or closures are left to specialised kernels
REGISTERS_MOST, CLOSURES_MOST = 64, 16
# Closures that few scenes have are left to specialised kernels, so that the general ones need not hold their code; so
# are ops that say so (`Op.general`)
RARE_KINDS = frozenset({ClosureKind.TOON}) | HAIR_KINDS


@functools.cache
def general_features() -> SceneFeatures:
    """The features of all scenes together, as far as kernels of stages depend on them."""
    ops = tuple(name for name in op_numbers() if name not in LEVEL_OPS and op_named(name).general)
    programs = ProgramFeatures(ops, REGISTERS_MOST, CLOSURES_MOST, apart=True)
    of_surfaces = {kind for kind in ClosureKind if kind < ClosureKind.VOLUME_ABSORPTION}
    return SceneFeatures(
        closures=tuple(sorted(of_surfaces - RARE_KINDS)),
        closure_count=CLOSURES_MOST,
        programs=programs,
        world_program=programs,
        lamp_program=programs,
        lights=tuple(sorted(LightKind)),
        light_sphere=True,
        light_hits=True,
        light_choice=True,
        mesh_lights=True,
        mesh_programs=True,
        world_light=True,
        world=True,
        depth_of_field=True,
        surfaces=True,
        instancing=True,
        smooth_normals=True,
        film_transparent=True,
        passes=tuple(name for name in PASSES if name not in GUIDE_PASSES),
        clamping=True,
    )


def why_not_general(features: SceneFeatures) -> str:
    """Why the general kernels cannot shade a scene with `features`; empty where they can."""
    general = general_features()
    if features.mis != general.mis:
        return "general kernels have no code for mis OFF"
    if features.sample_sequence != general.sample_sequence:
        return f"general kernels have no code for sample_sequence {features.sample_sequence}"
    if features.moving:
        return "general kernels have no code for objects that move"
    if features.curves:
        return "general kernels have no code for curves and points"
    if features.bounces_by_kind:
        return "general kernels do not count bounces by kind"
    if features.requests:
        return "general kernels trace no rays for programs"
    if features.filter_glossy:
        return "general kernels filter nothing glossy"
    if not (features.caustics_reflective and features.caustics_refractive):
        return "general kernels leave out no caustics"
    if rare := RARE_KINDS.intersection(features.closures):
        return f"general kernels have no code for closures of kind {', '.join(kind.name for kind in sorted(rare))}"
    if features.texture_levels:
        return "general kernels have no code for texture_filter FOOTPRINT"
    if features.guides:
        return "general kernels have no code for the passes that guide a denoiser"
    if features.light_links or features.shadow_links:
        return "general kernels have no code for light linking"
    if features.light_groups:
        return "general kernels have no code for the passes of light groups"
    closure_count = features.closure_count
    for programs in (features.programs, features.world_program, features.lamp_program):
        closure_count = max(closure_count, programs.closure_count)
        if programs.register_count > REGISTERS_MOST:
            return f"general kernels have {REGISTERS_MOST} registers, and a shader graph needs more"
    if closure_count > CLOSURES_MOST:
        return f"general kernels have room for {CLOSURES_MOST} closures, and a material has more"
    return ""


def array_features(features: SceneFeatures, shading: SceneFeatures) -> SceneFeatures:
    """What decides which arrays the paths of a scene with `features` have, where kernels are specialised on
    `shading`.
    """
    if shading == features:
        return features
    closures = tuple(kind for kind in shading.closures if kind != ClosureKind.SUBSURFACE or features.subsurface)
    return dataclasses.replace(
        shading, closures=closures, film_transparent=features.film_transparent, passes=features.passes
    )


@dataclass(frozen=True)
class TierChoice:
    """Which kernels shade a render."""

    shading: SceneFeatures  # what they are specialised on
    general: bool
    asked: str  # AUTO, GENERAL or SPECIALISED
    why: str

    @property
    def complaint(self) -> str:
        """Why it is not the tier that was asked for; empty where it is."""
        return self.why if self.asked == "GENERAL" and not self.general else ""


def choose_tier(features: SceneFeatures, setting: str, device: wp.Device) -> TierChoice:
    """The tier for a scene with `features`.

    `setting`: that of `kernel_tier`; where it is AUTO, the environment variable `RAYBATCH_KERNEL_TIER` takes its place.
    Raises `SettingsError` where that has another value.
    """
    if setting == "AUTO" and (asked := os.environ.get(VARIABLE)):
        if asked not in TIERS:
            raise SettingsError(f"{VARIABLE} is {asked!r}; set it to one of {', '.join(TIERS)}, or not at all")
        setting = asked

    def specialised(why: str) -> TierChoice:
        return TierChoice(features, False, setting, why)

    def general(why: str) -> TierChoice:
        return TierChoice(general_features(), True, setting, why)

    if setting == "SPECIALISED":
        return specialised("as set")
    if why := why_not_general(features):
        return specialised(why)
    if setting == "GENERAL":
        return general("as set")
    stages = list(StageKernels.choose(features, device, general_features()).shading.values())
    # where general kernels are at hand, nobody waits until the others are looked for by their code
    at_hand = all(is_compiled(kernel, device, at_once=True) for kernel in stages)
    if all(is_compiled(kernel, device, at_hand) for kernel in StageKernels.choose(features, device).shading.values()):
        return specialised("they were compiled before")
    if at_hand or all(is_compiled(kernel, device) for kernel in stages):
        target = shipped_target(stages[0], device)
        shipped = f" (shipped for {target})" if target else ""
        return general(f"they are ready{shipped}, and the specialised ones are not")
    return specialised("no others were compiled ahead")


def general_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """The kernels of the general tier that run programs: that of all stages, and that of all estimates."""
    features = general_features()
    stages = StageKernels.choose(features, device).shading[ShadingStage.SURFACE]
    return stages, estimate_kernel(features, Estimate.TRIANGLES)
