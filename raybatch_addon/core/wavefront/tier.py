"""Tiers of kernels: general ones, which shade any scene, and ones that are specialised on a scene.

The general kernels are compiled once, ahead; a scene whose specialised kernels are not there yet is rendered by them at
once. Both tiers compute the same bits: a feature that a scene lacks is left out of its specialised kernels, and has
nothing to do in the general ones.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Iterable
from dataclasses import dataclass

import warp as wp

from ..device.devices import is_compiled, is_kernel_loaded, shipped_target
from ..errors import SettingsError
from ..programs.op import VOLUME_PREFIX, op_named, op_numbers
from ..programs.requests import REQUEST_OPS
from ..scene.description import ClosureKind, LightKind
from ..scene.features import SceneFeatures
from ..scene.passes import LIGHT_GROUP, OCCLUSION_PASS, PASSES
from ..scene.program import ProgramFeatures
from ..settings.settings import SETTINGS
from .estimates.kernels import estimate_kernel
from .estimates.work import Estimate
from .kernels import StageKernels
from .stages.work import ShadingStage

_COMPILED_BEFORE = "they were compiled before"  # why kernels are specialised ones
VARIABLE = "RAYBATCH_KERNEL_TIER"
TIERS = ("AUTO", "GENERAL", "SPECIALISED")
# Programs that need more registers or closures are left to specialised kernels
_REGISTERS_MOST, GENERAL_CLOSURES_MOST = 64, 16

# Closures whose code few scenes would use
_LEFT_OUT = {ClosureKind.FACET_HAIR}
# Closures, ops and passes that the general kernels of a GPU lack beside these, whose compiler takes minutes
_KINDS_LEFT_OUT = {ClosureKind.RAY_PORTAL}
_OPS_LEFT_OUT = {"ray_portal", "vertex_offset", *REQUEST_OPS}
_PASSES_LEFT_OUT = {OCCLUSION_PASS}


def _programs(ops: Iterable[str]) -> ProgramFeatures:
    return ProgramFeatures(tuple(ops), _REGISTERS_MOST, GENERAL_CLOSURES_MOST, apart=True)


def general_features(device: wp.Device) -> SceneFeatures:
    """The features of all scenes together, as far as kernels of stages on `device` depend on them."""
    return _general_features(device.is_cuda)


@functools.cache
def _general_features(on_gpu: bool) -> SceneFeatures:
    ops = [name for name in op_numbers() if op_named(name).general and not (on_gpu and name in _OPS_LEFT_OUT)]
    programs = _programs(name for name in ops if not name.startswith(VOLUME_PREFIX))
    # what surfaces scatter and let through is nothing to volumes and lamps
    of_volumes = [n for n in ops if n == "emission" or n.startswith(VOLUME_PREFIX) or not op_named(n).makes_closures]
    kinds = [kind for kind in ClosureKind if kind < ClosureKind.VOLUME_ABSORPTION and kind not in _LEFT_OUT]
    passes = [*PASSES, LIGHT_GROUP]
    if on_gpu:
        kinds = [kind for kind in kinds if kind not in _KINDS_LEFT_OUT]
        passes = [name for name in PASSES if name not in _PASSES_LEFT_OUT]
    return SceneFeatures(
        closures=tuple(sorted(kinds)),
        closure_count=GENERAL_CLOSURES_MOST,
        programs=programs if on_gpu else dataclasses.replace(programs, answer_count=1),
        request_program=ProgramFeatures() if on_gpu else programs,
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
        camera_motion=True,
        moving=True,
        surfaces=True,
        instancing=True,
        smooth_normals=True,
        terminator=True,
        curves=True,
        film_transparent=True,
        passes=tuple(passes),
        clamping=True,
        bounces_by_kind=True,
        filter_glossy=True,
        caustics_reflective=False,
        caustics_refractive=False,
        light_links=not on_gpu,
        shadow_links=not on_gpu,
        light_portals=not on_gpu,
        light_bounces=not on_gpu,
        panorama_vectors=not on_gpu,
        volume_lights=True,
        catchers=not on_gpu,
        volumes=True,
        volume_program=dataclasses.replace(_programs(of_volumes), flows=True),
    )


def why_not_general(features: SceneFeatures, device: wp.Device) -> str:
    """Why the general kernels of `device` cannot shade a scene with `features`; empty where they can."""
    general = general_features(device)
    if features.mis != general.mis:
        return _lack_of_setting("mis", "OFF")
    if features.sample_sequence != general.sample_sequence:
        return _lack_of_setting("sample_sequence", features.sample_sequence)
    if features.texture_levels:
        return _lack_of_setting("texture_filter", "FOOTPRINT")
    for name, feature in _LINKS.items():
        if getattr(features, name) and not getattr(general, name):
            return f"general kernels have no code for {feature}"
    if lacking := sorted(set(features.closures) - set(general.closures)):
        names = ", ".join(kind.name.replace("_", " ").title() for kind in lacking)
        return f"general kernels have no code for closures of kind {names}"
    closure_count = features.closure_count
    of_lamps = general.volume_program if features.volumes else general.lamp_program
    for programs, there in (
        (features.programs, general.programs),
        (features.world_program, general.world_program),
        (features.lamp_program, of_lamps),
        (features.volume_program, general.volume_program),
    ):
        if why := lack_of(programs, there):
            return why
        closure_count = max(closure_count, programs.closure_count)
    if closure_count > GENERAL_CLOSURES_MOST:
        return f"general kernels have room for {GENERAL_CLOSURES_MOST} closures, and a material has more"
    return ""


def _lack_of_setting(name: str, value: str) -> str:
    info = SETTINGS[name]  # Last Render shows this: it is called what panels call it
    return f"general kernels have no code for {info.label} at {info.name_of(value)}"


def lack_of(programs: ProgramFeatures, there: ProgramFeatures) -> str:
    """Why general kernels that are specialised on `there` cannot run `programs`; empty where they can."""
    if lacking := sorted(set(programs.ops) - set(there.ops)):
        return f"general kernels have no code for {', '.join(lacking).replace('_', ' ')} there"
    if programs.register_count > _REGISTERS_MOST:
        return f"general kernels have {_REGISTERS_MOST} registers, and a shader graph needs more"
    return ""


_LINKS = {
    "light_links": "light linking",
    "shadow_links": "light linking",
    "light_portals": "portals of the world",
    "volume_lights": "volumes as lights",
    "light_bounces": "bounces of lights",
    "panorama_vectors": "the pass Vector of panoramas",
    "light_groups": "the passes of light groups",
    "catchers": "shadow catchers",
    "film_glass": "films that are transparent through glass",
}


def array_features(features: SceneFeatures, shading: SceneFeatures) -> SceneFeatures:
    """What decides which arrays the paths of a scene with `features` have, where kernels are specialised on
    `shading`.
    """
    if shading == features:
        return features
    closures = tuple(kind for kind in shading.closures if kind != ClosureKind.SUBSURFACE or features.subsurface)
    names = ("film_transparent", "passes", "filter_glossy", "light_links", "volume_lights", "request_program")
    own = {name: getattr(features, name) for name in names}
    ops = tuple(name for name in shading.programs.ops if name not in REQUEST_OPS or name in features.programs.ops)
    programs = dataclasses.replace(shading.programs, ops=ops)
    return dataclasses.replace(shading, closures=closures, programs=programs, **own)


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


def asked_tier(setting: str) -> str:
    """What is asked for: the setting `kernel_tier`, or where that is AUTO what the environment says. Raises
    `SettingsError`.
    """
    asked = os.environ.get(VARIABLE)
    if setting != "AUTO" or not asked:
        return setting
    if asked not in TIERS:
        raise SettingsError(f"{VARIABLE} is {asked!r}; set it to one of {', '.join(TIERS)}, or not at all")
    return asked


def choose_tier(features: SceneFeatures, setting: str, device: wp.Device) -> TierChoice:
    """The tier for a scene with `features`.

    `setting`: that of `kernel_tier`; where it is AUTO, the environment variable `RAYBATCH_KERNEL_TIER` takes its place.
    Raises `SettingsError` where that has another value.
    """
    setting = asked_tier(setting)

    def specialised(why: str) -> TierChoice:
        return TierChoice(features, False, setting, why)

    def general(why: str) -> TierChoice:
        return TierChoice(general_features(device), True, setting, why)

    if setting == "SPECIALISED":
        return specialised("as set")
    if why := why_not_general(features, device):
        return specialised(why)
    if setting == "GENERAL":
        return general("as set")
    own = StageKernels.choose(features, device).that_shade()
    if all(is_kernel_loaded(kernel, device) for kernel in own):
        return specialised(_COMPILED_BEFORE)
    stages = StageKernels.choose(features, device, general_features(device)).that_shade()
    # where general kernels are at hand, nobody waits until the others are looked for by their code
    at_hand = all(is_compiled(kernel, device, at_once=True) for kernel in stages)
    if all(is_compiled(kernel, device, at_hand) for kernel in own):
        return specialised(_COMPILED_BEFORE)
    if at_hand or all(is_compiled(kernel, device) for kernel in stages):
        target = shipped_target(stages[0], device)
        shipped = f" (shipped for {target})" if target else ""
        return general(f"they are ready{shipped}, and the specialised ones are not")
    return specialised("no others were compiled ahead")


def general_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """The kernels of the general tier that run programs: that of all stages at surfaces and beyond, that of all stages
    of volumes, and that of all estimates.
    """
    features = general_features(device)
    stages = StageKernels.choose(features, device)
    return stages.shading[ShadingStage.SURFACE], stages.volumes.scatter, estimate_kernel(features, Estimate.TRIANGLES)
