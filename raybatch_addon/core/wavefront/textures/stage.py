"""Stage: rays are back whose surfaces look up images in tiles. It asks for the tiles that are missing, and lets a ray
wait for them; nothing else is changed. Next: the stages at surfaces, or those of shadow rays.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...programs.ops.textures.image_levels import CHANCE, FOOTPRINT
from ...programs.point import ShadingPoint
from ...programs.run import make_run
from ...programs.tiling import ACTION, FETCH_REGISTERS, MISSING
from ...rays import Rays
from ...scene.description import Visibility
from ...scene.features import SceneFeatures, narrow
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import ClosureRecord
from ...shading.images.tiled.look_up import PIN, SEE, WANT
from ...shading.segments import make_surface_point
from ...shading.sequences.keys import TEXTURE
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import material_at
from ..rays import SHADOW_PASS, Paths, Status, bounce_to_light, time_of, visibility_of
from ..scene.shading_data import SceneData
from ..stages.limits import PathLimits, has_light
from ..stages.stage import first_of_thread, next_of_thread
from ..stages.surface.cone import cone_width, path_cone
from ..stages.surface.history import DEPTHS
from ..stages.surface.program import shading_point, with_steps
from ..stages.surface.vertex import VertexFeatures, make_vertex
from ..stages.work import TileWork
from .carry import carry_tiles_kernel
from .marks import condense_marks_kernel
from .state import LEADER, LOOKED, NEXT_LEADER, WAITED, WAITING_NOW, TextureWaits, WaitPhase, has_shadows

_RAY_OUT = int(Status.RAY_OUT)
_WAITING, _BACK, _READY, _NONE = int(WaitPhase.WAITING), int(WaitPhase.BACK), int(WaitPhase.READY), int(WaitPhase.NONE)


@dataclass(frozen=True, kw_only=True)
class FetchFeatures(VertexFeatures):
    """Features that the stage is specialised on; the fields are those of `SceneFeatures`."""

    programs: ProgramFeatures
    fetch_program: ProgramFeatures
    path_history: bool
    texture_levels: bool


@functools.cache
def make_fetch(features: FetchFeatures) -> wp.Function:
    """Function (waits, first: int, point, footprint: vec2, slot: int) -> bool: whether tiles are missing for the
    program at word `first`. `footprint`: what stands in the registers for it, where images are filtered; 0 where
    nothing is.
    """
    programs = features.fetch_program
    run = make_run(programs)
    own = programs.register_count - FETCH_REGISTERS

    @wp.func
    def fetch(waits: TextureWaits, first: int, point: ShadingPoint, footprint: wp.vec2, slot: int) -> bool:
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        closures = wp.zeros(1, dtype=ClosureRecord)
        if wp.static(features.texture_levels):
            stack[wp.static(FOOTPRINT)] = footprint[0]
            stack[wp.static(CHANCE)] = footprint[1]
        action = int(wp.static(SEE))
        missing = float(0.0)
        turn = int(0)
        while turn < 2:  # where something is missing, once more: all of its tiles are wanted together
            stack[wp.static(own + ACTION)] = float(action)
            stack[wp.static(own + MISSING)] = 0.0
            run(waits.nodes, stack, first, point, closures)
            missing = stack[wp.static(own + MISSING)]
            turn += 1
            action = wp.where(waits.leader[wp.static(LEADER)] == slot, wp.static(PIN), wp.static(WANT))
            if missing == 0.0:
                turn = 2
        return missing > 0.0

    return fetch


@wp.func
def note_looked(waits: TextureWaits, slot: int, phase: int, misses: bool):
    """Count the ray of `slot`, which stood at `phase`, and whether it `misses` tiles."""
    if phase != wp.static(_WAITING):
        wp.atomic_add(waits.counts, wp.static(LOOKED), 1)
    if misses:
        wp.atomic_add(waits.counts, wp.static(WAITING_NOW), 1)
        wp.atomic_min(waits.leader, wp.static(NEXT_LEADER), slot)
        if phase != wp.static(_WAITING):
            wp.atomic_add(waits.counts, wp.static(WAITED), 1)


@functools.cache
def fetch_surfaces_kernel(features: FetchFeatures) -> wp.Kernel:
    """Kernel (data, waits, work, limits, paths, rays, slots, count): paths that met a surface, and may wait."""
    vertex = make_vertex(narrow(features, VertexFeatures))
    sample_1d = make_sampler(features.sample_sequence).sample_1d
    fetch = make_fetch(features)
    has_steps = features.texture_levels or "bump" in features.programs.ops

    @wp.func
    def misses(
        data: SceneData, waits: TextureWaits, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int
    ) -> bool:
        material = material_at(data.geometry, rays.hit_instance[path], rays.hit_primitive[path])
        program = waits.nodes.program_first[material]
        if program < 0:
            return False
        v = vertex(data, work, limits, paths, rays, path)
        if not v.there:
            return False
        length = rays.hit_t[path]
        if wp.static(features.transparency):
            length += paths.passed_t[path]
        point = shading_point(
            v.surface, v.wo, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], length
        )
        point.ray_kind = visibility_of(v.status)
        point.bounce = v.bounce
        point.passed = v.passed
        if wp.static(features.path_history):
            point.history = paths.history[path]
        if wp.static(has_steps):
            point = with_steps(data.nodes, point)
        footprint = wp.vec2(0.0, 0.0)
        if wp.static(features.texture_levels):
            width = cone_width(path_cone(data.nodes, paths, path, v.bounce), length)
            cell = wp.dot(point.step_x, point.step_x) * wp.abs(wp.dot(point.incoming, point.geometric_normal))
            if cell > 0.0:
                footprint[0] = wp.min(width * width / cell, wp.static(3e38))
            footprint[1] = sample_1d(v.key, v.pixel.sample, v.dimension + wp.uint32(TEXTURE))
        missing = fetch(waits, program, point, footprint, path)
        note_looked(waits, path, waits.phase[path], missing)
        return missing

    @wp.kernel(**KERNEL_OPTIONS)
    def fetch_surfaces(
        data: SceneData,
        waits: TextureWaits,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = first_of_thread(wp.tid())
        while i < count[0]:
            path = slots[i]
            if misses(data, waits, work, limits, paths, rays, path):
                waits.phase[path] = wp.static(_WAITING)
                # no list has it until it is looked at again
                paths.status[path] = paths.status[path] | wp.static(_RAY_OUT)
            else:
                waits.phase[path] = wp.static(_NONE)
            i = next_of_thread(i)

    return fetch_surfaces


@functools.cache
def fetch_shadows_kernel(features: FetchFeatures) -> wp.Kernel:
    """Kernel (data, waits, paths, rays, slots, count): shadow rays that are back, which may wait at surfaces that let
    them through.
    """
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    fetch = make_fetch(features)
    bumps = "bump" in features.programs.ops

    @wp.func
    def misses(data: SceneData, waits: TextureWaits, paths: Paths, rays: Rays, slot: int) -> bool:
        instance = rays.hit_instance[slot]
        if instance < 0:
            return False
        primitive = rays.hit_primitive[slot]
        material = material_at(data.geometry, instance, primitive)
        program = waits.nodes.program_first[data.materials.records.shape[0] + material]
        if program < 0:
            return False
        path = slot - paths.status.shape[0]
        # what is opaque ends the ray without a look
        if data.materials.records[material].is_clear == 0 or not has_light(paths.shadow_light[path]):
            return False
        uv = rays.hit_uv[slot]
        surface = surface_point(data.geometry, instance, primitive, uv, time_of(rays, path))
        length = paths.shadow_t[path] + rays.hit_t[slot]
        point = shading_point(surface, -rays.direction[slot], instance, primitive, uv, length)
        point.ray_kind = wp.static(int(Visibility.SHADOW))
        point.bounce = bounce_to_light(paths.status[path])
        if wp.static(features.path_history):
            point.history = paths.shadow_history[path] & wp.static(DEPTHS)
        point.passed = paths.passed[path] / wp.static(SHADOW_PASS)
        if wp.static(bumps):
            point = with_steps(data.nodes, point)
        missing = fetch(waits, program, point, wp.vec2(0.0, 0.0), slot)
        note_looked(waits, slot, waits.phase[slot], missing)
        return missing

    @wp.kernel(**KERNEL_OPTIONS)
    def fetch_shadows(
        data: SceneData,
        waits: TextureWaits,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = first_of_thread(wp.tid())
        while i < count[0]:
            slot = slots[i]
            waits.phase[slot] = wp.where(misses(data, waits, paths, rays, slot), wp.static(_WAITING), wp.static(_READY))
            i = next_of_thread(i)

    return fetch_shadows


@wp.kernel(**KERNEL_OPTIONS)
def look_again_kernel(phase: wp.array(dtype=int), status: wp.array(dtype=int)):
    """Paths that wait are listed among those whose rays are back."""
    path = wp.tid()
    if phase[path] == wp.static(_WAITING):
        status[path] = status[path] & ~wp.static(_RAY_OUT)


@wp.kernel(**KERNEL_OPTIONS)
def shadows_back_kernel(phase: wp.array(dtype=int), slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """Shadow rays are back."""
    i = wp.tid()
    if i < count[0]:
        phase[slots[i]] = wp.static(_BACK)


@wp.kernel(**KERNEL_OPTIONS)
def choose_shadows_kernel(phase: wp.array(dtype=int), first: int, ready: int, chosen: wp.array(dtype=int)):
    """Which of the shadow rays from slot `first` on are listed: with `ready` those that may go on, which are then no
    more known here; else those that are to be looked at.
    """
    i = wp.tid()
    slot = first + i
    is_chosen = bool(phase[slot] == wp.static(_READY))
    if ready == 0:
        is_chosen = phase[slot] == wp.static(_BACK) or phase[slot] == wp.static(_WAITING)
    elif is_chosen:
        phase[slot] = wp.static(_NONE)
    chosen[i] = wp.where(is_chosen, 1, 0)


@wp.kernel(**KERNEL_OPTIONS)
def list_shadows_kernel(
    chosen: wp.array(dtype=int),
    before: wp.array(dtype=int),
    first: int,
    slots: wp.array(dtype=int),
    count: wp.array(dtype=int),
):
    """List what is chosen in the order of slots; `before` is the exclusive scan of `chosen`."""
    i = wp.tid()
    if chosen[i] != 0:
        slots[before[i]] = first + i
    if i == chosen.shape[0] - 1:
        count[0] = before[i] + chosen[i]


def fetch_kernels(features: SceneFeatures, shading: SceneFeatures, is_cuda: bool) -> tuple[wp.Kernel | None, ...]:
    """All that a `TileFetcher` launches for a scene with `features`, where kernels are specialised on `shading`; none
    where all images are whole.
    """
    if not features.fetch_program:
        return ()
    own = narrow(shading, FetchFeatures)
    others = look_again_kernel, shadows_back_kernel, choose_shadows_kernel, list_shadows_kernel, condense_marks_kernel
    others = (*others, carry_tiles_kernel) if is_cuda else others
    return (fetch_surfaces_kernel(own), fetch_shadows_kernel(own) if has_shadows(features) else None, *others)
