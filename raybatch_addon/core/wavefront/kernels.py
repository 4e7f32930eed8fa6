"""The kernels of one render, chosen by its features."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ..film import layout_of
from ..film.tile import add_spill_kernel, resolve_kernel
from ..report.counters import count_kernel
from ..scene.description import ClosureKind
from ..scene.features import SceneFeatures, narrow
from ..settings import RenderSettings
from ..shading.light_hits import LightHitFeatures
from .hit_order import hit_key_kernel
from .plan import Method
from .queues import queue_kernels
from .ray_order import order_kernels
from .stages.accumulate import accumulate_kernel
from .stages.connect import ConnectFeatures, connect_kernel, connect_program_kernel, settle_kernel
from .stages.connect_transparent import transparent_shadow_kernel
from .stages.generate import GenerateFeatures, counted_kernel, generate_kernel
from .stages.shade_background import BackgroundFeatures, background_kernel, light_hit_kernel
from .stages.shade_surface import SurfaceFeatures, surface_kernel
from .stages.walk import WalkFeatures, walk_kernel
from .tracers import tracer_kernels
from .tracing import Tracing


@dataclass(frozen=True)
class StageKernels:
    """Kernels by stage; None: the scene has nothing for that stage to do."""

    generate: wp.Kernel
    settle: wp.Kernel
    connect: wp.Kernel | None
    connect_transparent: wp.Kernel | None
    light_hits: wp.Kernel | None
    walk: wp.Kernel | None
    background: wp.Kernel
    surface: wp.Kernel | None
    accumulate: wp.Kernel
    resolve: wp.Kernel

    @staticmethod
    def choose(features: SceneFeatures) -> StageKernels:
        """The kernels for a scene with `features`."""
        has = features
        surface = SurfaceFeatures(
            **narrow(features, tuple(SurfaceFeatures.__dataclass_fields__)), shadow_rays=has.shadow_rays,
            light_programs=has.light_programs, lamp_programs=bool(has.lamp_program), path_history=has.path_history,
            film_holes=has.film_transparent and ClosureKind.HOLDOUT in has.closures,
        )  # fmt: skip
        connect = ConnectFeatures(**narrow(features, tuple(ConnectFeatures.__dataclass_fields__)))
        return StageKernels(
            generate=generate_kernel(
                GenerateFeatures(
                    has.camera, has.depth_of_field, has.sample_sequence, has.transparency, has.film_transparent,
                    "Normal" in has.passes, has.path_history,
                )  # fmt: skip
            ),
            settle=settle_kernel,
            connect=(connect_program_kernel(connect) if has.light_programs else connect_kernel) if has.shadow_rays else None,
            connect_transparent=transparent_shadow_kernel(surface, connect) if has.shadow_rays and has.transparency else None,
            light_hits=light_hit_kernel(
                LightHitFeatures(has.lights, has.light_sphere, has.light_hits, has.mis, has.lamp_program), has.transparency, has.clamping,
                has.subsurface,
            ) if has.light_hits else None,
            walk=walk_kernel(WalkFeatures(has.instancing, has.smooth_normals, has.sample_sequence)) if has.subsurface else None,
            background=background_kernel(
                BackgroundFeatures(
                    has.world, has.film_transparent, "Depth" in has.passes, has.clamping, has.world_program,
                    has.world_light, has.mis, has.subsurface,
                )  # fmt: skip
            ),
            surface=surface_kernel(surface) if has.surfaces else None,
            accumulate=accumulate_kernel(layout_of(has.passes, has.film_transparent)),
            resolve=resolve_kernel(layout_of(has.passes, has.film_transparent)),
        )  # fmt: skip

    def all(self) -> list[wp.Kernel]:
        """Everything that shading launches."""
        stages = [getattr(self, name) for name in self.__dataclass_fields__]
        return [kernel for kernel in stages if kernel is not None] + [*queue_kernels(walks=self.walk is not None), add_spill_kernel]


def tracing_kernels(features: SceneFeatures, settings: RenderSettings, tracing: Tracing, device: wp.Device) -> list[wp.Kernel]:
    """Everything that tracing, sorting and counting launch."""
    counting = tracing.counters(settings, features.passes)
    kernels = [count_kernel(counting), counted_kernel] if counting else []
    if features.surfaces:
        kernels += order_kernels(tracing.sort_mode(settings), device)
        if tracing.method is Method.PAGED and device.is_cuda:
            kernels.append(hit_key_kernel)
        kernels += tracer_kernels(tracing, settings, features.shadow_rays, bool(counting and counting.steps), device)
    return kernels
