"""The list of kernels to be compiled, as it is sent to another process."""

from __future__ import annotations

import dataclasses
import io
import pickle
from collections.abc import Sequence
from dataclasses import dataclass

import warp as wp

from ..bvh.build.refit import join_boxes_kernel, write_boxes_kernel
from ..bvh.build.scene_tree import build_kernels, layout_for
from ..bvh.pages.chunks import CHUNK_TREE_KERNELS
from ..film.tile import add_integers_kernel
from ..scene.description import ClosureKind
from ..scene.features import SCATTERING, SceneFeatures
from ..settings.settings import RenderSettings
from ..shading.lights.tree.kernels import LIGHT_TREE_KERNELS
from ..sky.scattering_kernels import SKY_KERNELS
from ..wavefront.kernels import (
    StageKernels,
    common_features,
    constant_volumes,
    plain_features,
    tracing_kernels,
    without_programs,
)
from ..wavefront.plan.plan import Method, TracingPlan
from ..wavefront.plan.tracing import Tracing
from ..wavefront.tier import general_features, general_kernels

# Seconds of a processor that a kernel takes to compile for a CPU, and each op in each interpreter (measured: 131 ops in
# one interpreter take 33)
_KERNELS_SECONDS = 5.0
_OP_SECONDS = 0.25


@dataclass(frozen=True)
class CompileRequest:
    """The kernels of a render."""

    features: SceneFeatures
    settings: RenderSettings
    plan: TracingPlan
    shading: SceneFeatures | None = None  # what those that shade are specialised on; None: `features`

    def kernels(self, device: wp.Device) -> list[wp.Kernel]:
        """All of them, but for those that build trees."""
        tracing = Tracing.of(self.plan, layout_for(device), self.features)
        if self.settings.schedule == "STREAMING":
            from ..wavefront.streaming.kernel import stream_kernels  # other renders import none of it

            return stream_kernels(self.features, tracing, self.settings, device)
        stages = StageKernels.choose(self.features, device, self.shading)
        return stages.all() + tracing_kernels(self.features, self.settings, tracing, device)

    @property
    def expected_seconds(self) -> float:
        """About how long a processor compiles the kernels that shade, where they are specialised [s]."""
        each = self.features
        materials, world, lamps = (len(p.ops) for p in (each.programs, each.world_program, each.lamp_program))
        ops = materials * (1 + each.transparency + each.mesh_programs) + world * (1 + each.world_light)
        return _KERNELS_SECONDS + _OP_SECONDS * (ops + lamps * 3 + len(each.volume_program.ops) * 4)


def tree_kernels(device: wp.Device) -> list[wp.Kernel]:
    """Kernels that build trees, over triangles and over lights."""
    return [*build_kernels(device), *LIGHT_TREE_KERNELS]


@dataclass(frozen=True)
class GeneralRequest:
    """The kernels that any scene can begin with: the general tier, trees, and tracing without queues; for a CPU also
    what usual scenes are traced with in queues, beyond memory, and while steps are counted.
    """

    def kernels(self, device: wp.Device) -> list[wp.Kernel]:
        """All kernels that any scene can begin with, in the order of how many renders ask for them on a CPU, and on a
        GPU those first that take longest to compile.
        """
        general = general_features(device)
        first, volumes, estimates = general_kernels(device)
        plain = _plain_scenes(plain_features(general))
        scenes = [dataclasses.replace(each, adaptive=True) for each in (*plain, *_wide_scenes(general))]  # both ways
        found = [first, volumes] if device.is_cuda else []
        found += [estimates, *tree_kernels(device), add_integers_kernel]
        if device.is_cpu:
            # those of boxes refit trees for the frame behind the first one
            found += [join_boxes_kernel, write_boxes_kernel, *SKY_KERNELS]
            scenes.sort(key=lambda each: (each.volumes, each.curves or each.moving))
        for each in scenes:
            found += CompileRequest(each, RenderSettings(), TracingPlan(Method.UNBATCHED), general).kernels(device)
        if device.is_cpu:
            for features, settings, method in _rare_tracing(plain):
                tracing = Tracing.of(TracingPlan(method), layout_for(device), features)
                found += tracing_kernels(features, settings, tracing, device)
            found += CHUNK_TREE_KERNELS
        return found


def _rare_tracing(plain: list[SceneFeatures]) -> list[tuple[SceneFeatures, RenderSettings, Method]]:
    """Ways to trace rays of usual scenes that few renders ask for, and that compile soon (with trees beyond memory, 39
    modules take 11 to 13 s of a processor, measured). `plain` is what `_plain_scenes` gives.
    """
    flat, instanced = plain[0], plain[2]
    usual, counted = RenderSettings(), RenderSettings(counters="ON")
    return [
        (flat, usual, Method.PAGED),
        (flat, counted, Method.UNBATCHED),
        (instanced, counted, Method.UNBATCHED),
        (flat, usual, Method.BATCHED),
    ]


# shadow rays ask for closest hits only where surfaces are transparent
_OPAQUE = tuple(kind for kind in SCATTERING if kind != ClosureKind.SUBSURFACE)


def _plain_scenes(plain: SceneFeatures) -> list[SceneFeatures]:
    """Features of scenes that between them need all kernels that usual ones can begin with; `plain` are those of all
    such scenes. What differs beside the kernels that shade is few, or compiled in no time.
    """
    plain = dataclasses.replace(plain, volumes=False)
    scenes = [
        dataclasses.replace(plain, instancing=instancing, passes=("Combined",), film_transparent=transparent)
        for instancing in (False, True)
        for transparent in (False, True)
    ]
    # other passes than Normal share their kernels
    scenes += [
        dataclasses.replace(scene, passes=("Combined", name)) for scene in scenes[:2] for name in ("Normal", "Mist")
    ]
    scenes += [dataclasses.replace(scene, closures=_OPAQUE) for scene in scenes[:4]]
    filled = dataclasses.replace(constant_volumes(scenes[0]), volumes=True)
    return [*scenes, common_features(scenes[0]), without_programs(scenes[0]), filled]


def _wide_scenes(general: SceneFeatures) -> list[SceneFeatures]:
    """The same of scenes that have what few have: `general` are those of all scenes."""
    common = dataclasses.replace(general, passes=("Combined",), film_transparent=False, volumes=False)
    scenes = [
        dataclasses.replace(common, curves=curves, moving=moving, instancing=instancing)
        for curves, moving, instancing in (
            (False, False, False),
            (True, False, False),
            (True, False, True),
            (False, True, True),  # what moves is an instance
            (True, True, True),
        )
    ]
    scenes += [dataclasses.replace(scene, closures=_OPAQUE) for scene in scenes[1:]]
    return [*scenes, without_programs(scenes[0]), dataclasses.replace(common, volumes=True)]


def kernels_ahead(
    features: Sequence[SceneFeatures] | None, settings: RenderSettings, device: wp.Device
) -> list[wp.Kernel]:
    """Kernels of scenes with `features`, rendered with `settings`; without them what any scene can begin with."""
    if not features:
        return GeneralRequest().kernels(device)
    requests = [CompileRequest(each, settings, TracingPlan(Method.UNBATCHED)) for each in features]
    kernels = [kernel for each in requests for kernel in each.kernels(device)]
    return [*kernels, *tree_kernels(device)]


Request = CompileRequest | GeneralRequest


CORE = __name__.removesuffix("ahead.request")  # the core's name here, with a dot; Blender's extensions have others


def encode_request(request: Request) -> bytes:
    """`request` for another process."""
    return pickle.dumps(request)


class _Unpickler(pickle.Unpickler):
    """Finds classes of the core, which had another name where they were pickled."""

    def __init__(self, data: bytes, core: str):
        super().__init__(io.BytesIO(data))
        self._core = core

    def find_class(self, module: str, name: str):
        if module.startswith(self._core):
            module = CORE + module.removeprefix(self._core)
        return super().find_class(module, name)


def decode_request(data: bytes, core: str) -> Request:
    """What `encode_request` encoded where `CORE` was `core`; only for data of a process of one's own."""
    return _Unpickler(data, core).load()
