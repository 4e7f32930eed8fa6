"""The kernels of one render, chosen by its features."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import warp as wp

from ..film import layout_of
from ..film.tile import add_spill_kernel, resolve_kernel
from ..measure.counters import count_kernel
from ..scene.features import SceneFeatures, narrow
from ..settings.settings import RenderSettings
from ..shading.lights.light_hits import LightHitFeatures
from .order.hit_order import hit_key_kernel
from .order.ray_order import order_kernels
from .path_lists import path_list_kernels
from .plan.plan import Method
from .plan.tracing import Tracing
from .stages.accumulate import accumulate_kernel
from .stages.connect import ConnectFeatures, connect_kernel, connect_program_kernel, settle_kernel
from .stages.connect_transparent import transparent_shadow_kernel
from .stages.generate import GenerateFeatures, counted_kernel, generate_kernel
from .stages.shade_background import BackgroundFeatures, background_kernel, light_hit_kernel
from .stages.shade_surface import surface_kernel
from .stages.surface_features import SurfaceFeatures
from .stages.walk import WalkFeatures, walk_kernel
from .tracers.choose import tracer_kernels


@dataclass(frozen=True, kw_only=True)
class StageKernels:
    """Kernels by stage; None: the scene has nothing for that stage to do."""

    generate: wp.Kernel
    settle: wp.Kernel
    connect: wp.Kernel | None
    connect_runs_programs: bool  # `connect` is `connect_program_kernel`
    connect_transparent: wp.Kernel | None
    light_hits: wp.Kernel | None
    walk: wp.Kernel | None
    background: wp.Kernel
    surface: wp.Kernel | None
    accumulate: wp.Kernel
    resolve: wp.Kernel

    @staticmethod
    def choose(features: SceneFeatures, shading: SceneFeatures | None = None) -> StageKernels:
        """The kernels for a scene with `features`, those that shade specialised on `shading` (default: the same)."""
        has_light_hits, has_shadow_rays = features.light_hits, features.shadow_rays
        has_transparent_shadows = has_shadow_rays and features.transparency
        layout = layout_of(features.passes, features.film_transparent)
        shading = shading or features
        begun = dataclasses.replace(shading, camera=features.camera, depth_of_field=features.depth_of_field)
        connect, surface = narrow(shading, ConnectFeatures), narrow(shading, SurfaceFeatures)
        connect_plain = connect_program_kernel(connect) if shading.light_programs else connect_kernel
        return StageKernels(
            generate=generate_kernel(narrow(begun, GenerateFeatures)),
            settle=settle_kernel,
            connect=connect_plain if has_shadow_rays else None,
            connect_runs_programs=shading.light_programs,
            connect_transparent=transparent_shadow_kernel(surface, connect) if has_transparent_shadows else None,
            light_hits=light_hit_kernel(
                narrow(shading, LightHitFeatures), shading.transparency, shading.clamping, shading.subsurface
            )
            if has_light_hits
            else None,
            walk=walk_kernel(narrow(features, WalkFeatures)) if features.subsurface else None,
            background=background_kernel(narrow(shading, BackgroundFeatures)),
            surface=surface_kernel(surface) if features.surfaces else None,
            accumulate=accumulate_kernel(layout),
            resolve=resolve_kernel(layout),
        )

    def all(self) -> list[wp.Kernel]:
        """Everything that shading launches."""
        stages = [getattr(self, name) for name in self.__dataclass_fields__]
        return [kernel for kernel in stages if isinstance(kernel, wp.Kernel)] + [
            *path_list_kernels(walks=self.walk is not None),
            add_spill_kernel,
        ]

    def shading(self) -> list[wp.Kernel]:
        """The kernels that differ from tier to tier."""
        stages = (self.surface, self.connect, self.connect_transparent, self.light_hits, self.background)
        return [kernel for kernel in stages if kernel is not None]


def tracing_kernels(
    features: SceneFeatures, settings: RenderSettings, tracing: Tracing, device: wp.Device
) -> list[wp.Kernel]:
    """Everything that tracing, sorting and counting launch."""
    counting = tracing.counters(settings, features.passes)
    kernels = [count_kernel(counting), counted_kernel] if counting else []
    if features.surfaces:
        kernels += order_kernels(tracing.sort_mode(settings), device)
        if tracing.method is Method.PAGED and device.is_cuda:
            kernels.append(hit_key_kernel)
        kernels += tracer_kernels(tracing, settings, features.shadow_rays, bool(counting and counting.steps), device)
    return kernels
