"""The kernel of the streaming schedule: each warp goes from queue to queue until there is nothing more to do."""

from __future__ import annotations

import functools

import warp as wp

from ...bvh.tree import NEW
from ...device.kernel import kernel_options, specialised_out_of_line, with_block_size
from ...film import layout_of
from ...film.tile import FilmTile, add_spill_kernel, resolve_kernel
from ...rays import Rays
from ...scene.features import SceneFeatures
from ...settings.settings import RenderSettings
from ...shading.camera import CameraData
from ..adaptive.active_pixels import ADAPTIVE_KERNELS
from ..plan.tracing import Tracing
from ..rays import Paths
from ..scene.shading_data import SceneData
from ..stages.limits import PathLimits
from ..stages.stage import prefetch_hits
from ..stages.work import TileWork
from ..volumes.table import VolumeData
from .queues import Counter, Queue, StreamQueues, Word, fill_kernel, lane_count, put_tokens, take_tokens
from .stages import stream_stages, whereto
from .trace import StreamTracing, TracedTree, make_trace_batch, stream_tracing

BLOCK_SIZE = 128  # threads of a block on CUDA: warps have nothing to do with each other
# Of a CUDA thread at most, as for the stages that take most of them: else a small scene's kernel takes 168 to 196, so
# that a multiprocessor has half as many warps
_REGISTERS = 128

_FILM, _BACKGROUND, _CONNECT = int(Queue.FILM), int(Queue.BACKGROUND), int(Queue.CONNECT)
_SHADOW, _TRACE, _GENERATE = int(Queue.SHADOW), int(Queue.TRACE), int(Queue.GENERATE)
_HELD, _BEGINS, _ITEM = int(Word.HELD), int(Word.BEGINS), int(Word.ITEM)
_LEAVE = int(Counter.LEAVE)


@wp.struct
class Stream:
    """What the kernel needs besides the arguments of the wavefront's stages."""

    queues: StreamQueues
    traced: TracedTree
    volumes: VolumeData  # without entries where there are none
    active: wp.array(dtype=int)  # pixels that get samples, as `active_number` takes them; no entries: all
    one: wp.array(dtype=int)  # the length of a list of one path, shape [1]


@functools.cache
def stream_kernel(
    features: SceneFeatures, tracing: StreamTracing | None, out_of_line: bool, registers: int = 0
) -> wp.Kernel:
    """Kernel (data, work, limits, camera, paths, rays, film, stream), of whole warps, for a scene with `features`.

    `tracing`: None where there is nothing to hit; `out_of_line`: compile it for a CPU in less time;
    `registers`: of a CUDA thread at most (0: as the compiler likes).
    """
    stages = stream_stages(features)
    begin, connect, accumulate = stages.begin, stages.connect, stages.accumulate
    background, surface = stages.background, stages.surface
    trace_batch = make_trace_batch(tracing)
    cut = tracing is not None and tracing.cut

    @wp.func
    def begins(stream: Stream, slot: int):
        """A ray is new."""
        if wp.static(cut):
            stream.traced.location[slot] = wp.static(NEW)

    def stream_paths(
        data: SceneData,
        work: TileWork,
        limits: PathLimits,
        camera: CameraData,
        paths: Paths,
        rays: Rays,
        film: FilmTile,
        stream: Stream,
    ):
        thread = wp.tid()
        lanes = lane_count()
        lane = thread % lanes
        words = stream.queues.warps[thread / lanes]
        tokens = stream.queues.tokens[thread / lanes]
        targets = stream.queues.targets[thread / lanes]
        one = stream.one
        queue = int(take_tokens(stream.queues, thread))
        while queue >= 0:
            if queue >= _SHADOW and queue != _GENERATE:
                trace_batch(stream.traced, paths, rays, stream.queues, one, queue, thread)
            else:
                for i in range(lane, words[_HELD], lanes):
                    slots = tokens[i : i + 1]
                    path = slots[0]
                    if queue == _GENERATE:
                        targets[i] = _GENERATE
                        if i < words[_BEGINS]:
                            item = words[_ITEM] + i
                            begin(
                                data,
                                stream.volumes,
                                work,
                                limits,
                                camera,
                                paths=paths,
                                rays=rays,
                                slots=slots,
                                one=one,
                                active=stream.active,
                                item=item,
                            )
                            begins(stream, path)
                            targets[i] = _TRACE
                    elif queue == _FILM:
                        accumulate(work, paths, film, slots, one)
                        targets[i] = _GENERATE
                        if paths.status[path] != 0:  # it waits for wide digits, which the host makes
                            targets[i] = _FILM
                            stream.queues.counters[_LEAVE] = 1
                    else:
                        if queue == _CONNECT:
                            path = path - paths.status.shape[0]
                            connect(data, stream.volumes, work, limits, paths, rays, film=film, slots=slots, one=one)
                        elif wp.static(surface is None) or queue == _BACKGROUND:
                            background(data, stream.volumes, work, limits, paths, rays, film=film, slots=slots, one=one)
                        else:
                            if wp.static(surface is not None):
                                prefetch_hits(data.geometry, rays, tokens, i, words[_HELD])
                                surface(
                                    data, stream.volumes, work, limits, paths, rays, film=film, slots=slots, one=one
                                )
                        to = whereto(paths, path)
                        if to.queue == _SHADOW or to.queue == _TRACE:
                            begins(stream, to.token)
                        tokens[i] = to.token
                        targets[i] = to.queue
            put_tokens(stream.queues, thread)
            queue = take_tokens(stream.queues, thread)

    limit = {"cuda_max_registers": registers} if registers else {}
    kernel = wp.kernel(stream_paths, **kernel_options(out_of_line), **limit)
    return with_block_size(kernel, BLOCK_SIZE)


def kernel_for(features: SceneFeatures, tracing: Tracing, settings: RenderSettings, device: wp.Device) -> wp.Kernel:
    """The kernel of a render with `settings`; its `register_cap` says more of registers than `_REGISTERS`."""
    registers = (settings.register_cap or _REGISTERS) if device.is_cuda else 0
    return stream_kernel(features, stream_tracing(tracing, features), specialised_out_of_line(), registers)


def stream_kernels(
    features: SceneFeatures, tracing: Tracing, settings: RenderSettings, device: wp.Device
) -> list[wp.Kernel]:
    """Everything that a `StreamingIntegrator` launches."""
    own = kernel_for(features, tracing, settings, device)
    found = [own, fill_kernel, resolve_kernel(layout_of(features.passes, features.film_transparent)), add_spill_kernel]
    return [*found, *(ADAPTIVE_KERNELS if features.adaptive else ())]
