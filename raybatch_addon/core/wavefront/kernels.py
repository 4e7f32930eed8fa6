"""The kernels of one render, chosen by its features."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from ..device.kernel import specialised_out_of_line
from ..film import layout_of
from ..film.tile import add_spill_kernel, resolve_kernel
from ..measure.counters import count_kernel
from ..programs.requests import REQUEST_OPS
from ..scene.description import ClosureKind
from ..scene.features import SceneFeatures, narrow
from ..scene.passes import GUIDE_PASSES, light_group_passes
from ..scene.program import ProgramFeatures
from ..settings.settings import RenderSettings
from ..shading.bsdf.materials import HAIR_KINDS
from ..shading.lights.hits import LightHitFeatures
from .adaptive.active_pixels import ADAPTIVE_KERNELS
from .catchers.lives import CATCHER_KERNELS
from .order.hit_order import KEY_KERNELS, HitKey, sorts_materials
from .order.ray_order import order_kernels
from .path_lists import path_list_kernels
from .plan.plan import Method
from .plan.tracing import Tracing
from .requests.occlusion import OcclusionFeatures, make_occlusion
from .requests.stage import RequestFeatures, make_request
from .stages.accumulate import accumulate_kernel
from .stages.connect import ConnectFeatures, make_connect, make_connect_program, settle_kernel
from .stages.connect_transparent import make_connect_transparent
from .stages.generate import GenerateFeatures, counted_kernel, generate_active_kernel, generate_kernel
from .stages.shade_background import BackgroundFeatures, make_background, make_light_hits_stage
from .stages.stage import STAGES_OF_ALL, all_stages_kernel, stage_kernel
from .stages.surface.aim import AimFeatures, make_aim
from .stages.surface.features import SurfaceFeatures
from .stages.surface.shade import make_shade_surface
from .stages.walk import WalkFeatures, walk_kernel
from .stages.work import ShadingStage
from .textures.stage import fetch_kernels
from .tracers.choose import tracer_kernels
from .volumes.volumes import VolumeKernels


@dataclass(frozen=True, kw_only=True)
class StageKernels:
    """Kernels by stage."""

    generate: wp.Kernel
    generate_active: wp.Kernel | None  # None: all pixels get all samples
    settle: wp.Kernel
    walk: wp.Kernel | None  # None: nothing scatters below surfaces
    volumes: VolumeKernels | None  # None: there are no volumes
    shading: dict[ShadingStage, wp.Kernel]  # without the stages for which the scene has nothing to do
    accumulate: wp.Kernel
    resolve: wp.Kernel
    catchers: tuple[wp.Kernel, ...] = ()  # none: no surface catches shadows
    textures: tuple[wp.Kernel | None, ...] = ()  # none: all images are whole

    @staticmethod
    def choose(features: SceneFeatures, device: wp.Device, shading: SceneFeatures | None = None) -> StageKernels:
        """The kernels for a scene with `features`, those that shade specialised on `shading` (default: the same)."""
        return _chosen(features, shading or features, device.is_cuda, specialised_out_of_line())

    def that_shade(self) -> list[wp.Kernel]:
        """Kernels of surfaces, lights, the world and volumes."""
        return [*self.shading.values(), *(self.volumes.all() if self.volumes else ())]

    def all(self) -> list[wp.Kernel]:
        """Everything that is launched, tracing apart."""
        stages = [self.generate, self.settle, *self.shading.values(), self.walk, self.accumulate, self.resolve]
        kernels = [*stages, *path_list_kernels(walks=self.walk is not None), add_spill_kernel]
        if self.volumes:
            kernels += self.volumes.all()
        kernels += [*self.catchers, *self.textures]
        if self.generate_active:
            kernels += [self.generate_active, *ADAPTIVE_KERNELS]
        return list(dict.fromkeys(kernel for kernel in kernels if kernel is not None))


@functools.cache
def _chosen(features: SceneFeatures, shading: SceneFeatures, is_cuda: bool, out_of_line: bool) -> StageKernels:
    """What `StageKernels.choose` returns: each render asks for it again and again."""
    layout = layout_of(features.passes, features.film_transparent)
    # flat meshes walk by what was compiled ahead for smooth ones; so do curves and what moves
    walked = dataclasses.replace(features, smooth_normals=shading.smooth_normals)
    if shading.programs.apart and (features.curves or features.moving):
        walked = dataclasses.replace(walked, curves=True, moving=True)
    has = {
        ShadingStage.SURFACE: features.surfaces,
        ShadingStage.BACKGROUND: True,
        ShadingStage.LIGHT_HITS: features.light_hits and not features.volumes,  # which have such a stage
        ShadingStage.CONNECT: features.shadow_rays,
        ShadingStage.CONNECT_TRANSPARENT: features.shadow_rays and features.transparency,
        ShadingStage.AIM: features.shadow_rays and is_cuda,
        ShadingStage.REQUEST: features.requests,
        ShadingStage.OCCLUSION: features.occlusion_pass,
    }
    stages = [stage for stage in ShadingStage if has[stage]]
    return StageKernels(
        generate=generate_kernel(_generate_features(features, shading)),
        generate_active=generate_active_kernel(_generate_features(features, shading)) if features.adaptive else None,
        settle=settle_kernel,
        walk=walk_kernel(narrow(walked, WalkFeatures)) if features.subsurface else None,
        volumes=VolumeKernels.choose(
            features, _shading_of_volumes(features, shading), out_of_line and not shading.programs.apart
        ),
        shading=_shading_kernels(features, shading, stages, is_cuda, out_of_line),
        accumulate=accumulate_kernel(layout),
        resolve=resolve_kernel(layout),
        catchers=CATCHER_KERNELS if features.catchers else (),
        textures=fetch_kernels(features, shading, is_cuda),
    )


def _generate_features(features: SceneFeatures, shading: SceneFeatures) -> GenerateFeatures:
    """What paths of a scene with `features` start by, where kernels are specialised on `shading`: of the camera what
    the scene has; in the general tier any camera.
    """
    seen = {name: getattr(features, name) for name in ("camera", "depth_of_field", "spherical_stereo")}
    if shading.programs.apart:
        seen = {"camera": None, "depth_of_field": True, "spherical_stereo": True}
    return narrow(dataclasses.replace(shading, **seen), GenerateFeatures)


def _shading_kernels(
    features: SceneFeatures, shading: SceneFeatures, stages: list[ShadingStage], aims_apart: bool, out_of_line: bool
) -> dict[ShadingStage, wp.Kernel]:
    """Kernels of `stages`. Where `shading` is that of all scenes, stages that run a program are one kernel; it takes so
    many registers that a GPU has few threads of it, so the others are kernels of their own, and in them what few scenes
    have is left out (`is_wide`). For a scene that has it, a CPU takes the large kernel for all stages, but for surfaces
    where that is a denoiser's guides alone (`is_common`).

    `aims_apart`: whether light is aimed at by a kernel of its own, or by that at surfaces; `out_of_line`: how
    specialised kernels are compiled.
    """
    aim = narrow(shading, AimFeatures)
    in_one = None if aims_apart or not shading.shadow_rays else aim
    whole = stage_functions(shading, in_one)
    if not shading.programs.apart:
        return {stage: stage_kernel(whole[stage](), stage, out_of_line) for stage in stages}
    any_program = bool(features.programs or features.world_program or features.lamp_program)
    runs_program = {
        ShadingStage.SURFACE: bool(features.programs) if aims_apart else any_program,
        ShadingStage.CONNECT_TRANSPARENT: any_program,
        ShadingStage.CONNECT: features.light_programs,
        ShadingStage.LIGHT_HITS: bool(features.lamp_program),
        ShadingStage.BACKGROUND: bool(features.world_program),
        ShadingStage.AIM: False,
        ShadingStage.REQUEST: True,
        ShadingStage.OCCLUSION: True,
    }
    # a world that is sampled takes part in the choice among emitters, whether a stage runs its program or not
    wide = is_wide(features)
    needed = shading if wide else plain_features(shading)
    if in_one is not None:
        in_one = narrow(needed, AimFeatures)
    simple = stage_functions(without_programs(needed), in_one, shading.world_light)
    simple[ShadingStage.AIM] = stage_functions(needed, None)[ShadingStage.AIM]
    if aims_apart:  # where light is not aimed at, programs of world and lamps are not run, but how they count is known
        weighing = dataclasses.replace(
            without_programs(needed), world_light=shading.world_light, lamp_program=shading.lamp_program
        )
        simple[ShadingStage.SURFACE] = stage_functions(weighing, None)[ShadingStage.SURFACE]
    has_simple = aims_apart or not wide
    found = {
        stage: stage_kernel(simple[stage](), stage, out_of_line=stage == ShadingStage.SURFACE)
        for stage in stages
        if has_simple and not runs_program[stage]
    }
    if ShadingStage.SURFACE in stages and ShadingStage.SURFACE not in found and is_common(features):
        # most of the time of a render is here, so what such a scene lacks is left out of this stage
        common = common_features(shading)
        aim = None if aims_apart else narrow(common, AimFeatures)
        function = stage_functions(common, aim)[ShadingStage.SURFACE]()
        found[ShadingStage.SURFACE] = stage_kernel(function, ShadingStage.SURFACE, out_of_line=True)
    if ShadingStage.OCCLUSION in stages and not shading.occlusion_pass:
        occlusion = stage_functions(features, None)[ShadingStage.OCCLUSION]()
        found[ShadingStage.OCCLUSION] = stage_kernel(occlusion, ShadingStage.OCCLUSION)
    if len(found) < len(stages):
        has = {ShadingStage.REQUEST: shading.requests, ShadingStage.OCCLUSION: shading.occlusion_pass}
        functions = [whole[stage]() if has.get(stage, True) else None for stage in STAGES_OF_ALL]
        kernel = all_stages_kernel(*functions, of=(*shading.programs.ops, *(["aim"] if in_one is not None else [])))
        found |= {stage: kernel for stage in stages if stage not in found}
    return found


# Closures that few scenes have
_RARE_KINDS = frozenset({ClosureKind.TOON, ClosureKind.RAY_PORTAL}) | HAIR_KINDS
# Other features that few have
_RARE_FEATURES = {
    "curves": False,
    "moving": False,
    "bounces_by_kind": False,
    "filter_glossy": False,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "light_links": False,
    "shadow_links": False,
    "light_portals": False,
    "volume_lights": False,
    "light_bounces": False,
    "panorama_vectors": False,
    "catchers": False,
}


def is_wide(features: SceneFeatures) -> bool:
    """Whether surfaces or lights of a scene with `features` have anything that few scenes have."""
    return _is_rare(features) or features.guides


def _is_rare(features: SceneFeatures) -> bool:
    """`is_wide`, passes that guide a denoiser apart."""
    rare = any(getattr(features, name) != usual for name, usual in _RARE_FEATURES.items())
    return rare or features.light_groups or not _RARE_KINDS.isdisjoint(features.closures)


def plain_features(features: SceneFeatures) -> SceneFeatures:
    """`features` without what few scenes have."""
    unguided = _usual_features(features)
    return dataclasses.replace(unguided, passes=tuple(name for name in unguided.passes if name not in GUIDE_PASSES))


def _usual_features(features: SceneFeatures) -> SceneFeatures:
    """`plain_features`, and passes that guide a denoiser."""
    groups = light_group_passes(features.passes)
    return dataclasses.replace(
        features,
        closures=tuple(kind for kind in features.closures if kind not in _RARE_KINDS),
        passes=tuple(name for name in features.passes if name not in groups),
        **_RARE_FEATURES,
    )


# Ops that few programs have
_RARE_OPS = REQUEST_OPS | {kind.name.lower() for kind in _RARE_KINDS}


def is_common(features: SceneFeatures) -> bool:
    """Whether a scene with `features` has but what many have: less code shades its surfaces (`common_features`)."""
    return _RARE_OPS.isdisjoint(features.programs.ops) and not _is_rare(features)


def common_features(features: SceneFeatures) -> SceneFeatures:
    """What `features` have of such scenes. Arrays of paths are the same: other kernels read them."""
    usual = _usual_features(features)
    ops = tuple(name for name in usual.programs.ops if name not in _RARE_OPS)
    return dataclasses.replace(
        usual, programs=dataclasses.replace(usual.programs, ops=ops, answer_count=0), request_program=ProgramFeatures()
    )


def _shading_of_volumes(features: SceneFeatures, shading: SceneFeatures) -> SceneFeatures:
    """What the kernels of volumes in a scene with `features` are specialised on, where others are on `shading`."""
    has_programs = bool(features.volume_program or features.lamp_program)
    if not shading.programs.apart or has_programs or _is_rare(features):
        return shading
    return constant_volumes(_usual_features(shading))


def constant_volumes(features: SceneFeatures) -> SceneFeatures:
    """`features` of a scene whose volumes are each the same everywhere, and whose lamps are no programs."""
    return dataclasses.replace(features, volume_program=ProgramFeatures(), lamp_program=ProgramFeatures())


def without_programs(features: SceneFeatures) -> SceneFeatures:
    """`features` of a scene whose materials, world and lamps are as they are, but for those that are programs."""
    none = ProgramFeatures()
    return dataclasses.replace(
        features, programs=none, world_program=none, lamp_program=none, mesh_programs=False, world_light=False
    )


def stage_functions(
    shading: SceneFeatures, aims: AimFeatures | None, world_light: bool | None = None
) -> dict[ShadingStage, Callable[[], wp.Function]]:
    """What makes the functions of stages that are specialised on `shading`.

    `aims`: what the stage `aim` is specialised on, where it is a part of that at surfaces; else None. `world_light`:
    whether the world is among the emitters that lights which rays meet are weighed against (default: as `shading` has
    it).
    """
    among = shading if world_light is None else dataclasses.replace(shading, world_light=world_light)
    surface, connected = narrow(shading, SurfaceFeatures), narrow(shading, ConnectFeatures)
    return {
        ShadingStage.SURFACE: lambda: make_shade_surface(surface, aims),
        ShadingStage.BACKGROUND: lambda: make_background(narrow(shading, BackgroundFeatures)),
        ShadingStage.LIGHT_HITS: lambda: make_light_hits_stage(
            narrow(among, LightHitFeatures),
            transparency=shading.transparency,
            clamping=shading.clamping,
            subsurface=shading.subsurface,
            splits_light=shading.splits_light,
            guides=shading.guides,
        ),
        ShadingStage.CONNECT: lambda: (
            make_connect_program(connected)
            if shading.light_programs
            else make_connect(shading.clamping, shading.splits_light, shading.light_groups)
        ),
        ShadingStage.CONNECT_TRANSPARENT: lambda: make_connect_transparent(surface, connected),
        ShadingStage.AIM: lambda: make_aim(narrow(shading, AimFeatures)),
        ShadingStage.REQUEST: lambda: make_request(narrow(shading, RequestFeatures)),
        ShadingStage.OCCLUSION: lambda: make_occlusion(narrow(shading, OcclusionFeatures)),
    }


def tracing_kernels(
    features: SceneFeatures, settings: RenderSettings, tracing: Tracing, device: wp.Device
) -> list[wp.Kernel]:
    """Everything that tracing, sorting and counting launch."""
    counting = tracing.counters(settings, features.passes)
    kernels = [count_kernel(counting), counted_kernel] if counting else []
    if features.surfaces:
        kernels += order_kernels(tracing.sort_mode(settings), device)
        if tracing.method is Method.PAGED and device.is_cuda:
            kernels.append(KEY_KERNELS[HitKey.TRIANGLE])
        elif sorts_materials(settings.hit_sort, device):
            kernels.append(KEY_KERNELS[HitKey.MATERIAL])
        kernels += tracer_kernels(tracing, settings, features.shadow_rays, bool(counting and counting.steps), device)
    return kernels
