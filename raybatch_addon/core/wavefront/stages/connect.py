"""Stage: rays come back from the tracer. Next: shading, when both rays of a path are back."""

import functools
from dataclasses import dataclass

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...film.tile import FilmTile
from ...rays import Rays
from ...scene.features import PATH_HISTORY_OPS
from ...scene.program import ProgramFeatures
from ...shading.lights.lamp_program import make_lamp_emission
from ...shading.lights.shapes import LAMP_PROGRAM, SURFACE_PROGRAM, WORLD_PROGRAM
from ..passes.light import make_add_light
from ..rays import Paths, Status, bounce_to_light, passed_before_light
from ..scene.shading_data import SceneData
from .emitted import make_surface_emission, make_world_emission
from .limits import PathLimits, clamped
from .surface.history import DEPTHS
from .work import TileWork

RAY_OUT = int(Status.RAY_OUT)
_SHADOW_OUT = int(Status.SHADOW_OUT)
_HIT = int(Status.HIT)


@wp.kernel(**KERNEL_OPTIONS)
def settle_kernel(paths: Paths, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """Extending rays are back."""
    i = wp.tid()
    if i >= count[0]:
        return
    path = slots[i]
    status = paths.status[path] & ~wp.static(RAY_OUT | _HIT)
    if rays.hit_instance[path] >= 0:
        status = status | wp.static(_HIT)
    paths.status[path] = status


@functools.cache
def make_connect(clamping: bool, splits_light: bool, light_groups: bool = False) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it: light that nothing hides is added to its path.

    Where there is a limit (`clamping`) it is one of what arrives: surfaces and volumes on the way dim light before.
    """
    add_light = make_add_light(splits_light, light_groups)

    @wp.func
    def connect(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, slot: int
    ):
        path = slot - paths.status.shape[0]
        if rays.hit_instance[slot] < 0:
            bounce = bounce_to_light(paths.status[path])
            light = paths.shadow_light[path]
            if wp.static(clamping):
                light = clamped(limits, light, bounce)
            add_light(paths, path, light, bounce, True)
        paths.status[path] = paths.status[path] & ~wp.static(_SHADOW_OUT)

    return connect


@dataclass(frozen=True, kw_only=True)
class ConnectFeatures:
    """Features that light that arrives is specialised on; the fields are those of `SceneFeatures`."""

    programs: ProgramFeatures
    world_program: ProgramFeatures
    lamp_program: ProgramFeatures
    mesh_programs: bool
    world_light: bool
    instancing: bool
    smooth_normals: bool
    clamping: bool
    splits_light: bool = False
    light_groups: bool = False


@functools.cache
def make_arrived(features: ConnectFeatures) -> wp.Function:
    """Function (data, limits, paths, rays, path: int, slot: int) -> vec3: what an unhidden shadow ray brings to its
    path, within the limit for it: surfaces and volumes have dimmed it on its way.
    """
    has_world, has_surfaces = features.world_light, features.mesh_programs
    has_lamps = bool(features.lamp_program)
    has_history = not PATH_HISTORY_OPS.isdisjoint(features.programs.ops)
    world_emission = make_world_emission(features.world_program) if has_world else None
    lamp_emission = make_lamp_emission(features.lamp_program) if has_lamps else None
    surface_emission = None
    if has_surfaces:
        surface_emission = make_surface_emission(features.programs, features.instancing, features.smooth_normals)

    @wp.func
    def arrived(data: SceneData, limits: PathLimits, paths: Paths, rays: Rays, path: int, slot: int) -> wp.vec3:
        light = paths.shadow_light[path]
        bounce = bounce_to_light(paths.status[path])
        kind = int(0)
        if wp.static(has_world or has_surfaces or has_lamps):
            kind = paths.light_program[path]
        direction = rays.direction[slot]
        if wp.static(has_world):
            if kind == wp.static(WORLD_PROGRAM):
                light = wp.cw_mul(
                    light,
                    world_emission(data, rays.origin[slot], direction, 0, bounce, passed_before_light(paths, path)),
                )
        if wp.static(has_surfaces):
            if kind == wp.static(SURFACE_PROGRAM):
                history = int(0)
                if wp.static(has_history):
                    history = paths.shadow_history[path] & wp.static(DEPTHS)
                distance = rays.t_max[slot]
                if paths.shadow_t.shape[0] > 0:
                    distance += paths.shadow_t[path]
                emitted = surface_emission(
                    data,
                    paths.light_instance[path],
                    paths.light_primitive[path],
                    paths.light_barycentric[path],
                    -direction,
                    distance,
                    bounce,
                    passed_before_light(paths, path),
                    history,
                )
                light = wp.cw_mul(light, emitted)
        if wp.static(has_lamps):
            if kind == wp.static(LAMP_PROGRAM):
                # a ray that nothing may stop has no length of its own; others have passed some of theirs
                aimed = paths.light_barycentric[path]
                position = rays.origin[slot] + (rays.t_max[slot] + aimed[1]) * direction
                shone = lamp_emission(
                    data.lamp_nodes,
                    data.lights,
                    paths.light_instance[path],
                    position,
                    direction,
                    aimed[0],
                    bounce,
                    passed_before_light(paths, path),
                )
                light = wp.cw_mul(light, shone)
        if wp.static(features.clamping):
            light = clamped(limits, light, bounce)
        return light

    return arrived


@functools.cache
def make_connect_program(features: ConnectFeatures) -> wp.Function:
    """The stage's function like `connect`, where programs say what light there is."""
    arrived = make_arrived(features)
    add_light = make_add_light(features.splits_light, features.light_groups)

    @wp.func
    def connect_program(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, slot: int
    ):
        path = slot - paths.status.shape[0]
        if rays.hit_instance[slot] < 0:
            light = arrived(data, limits, paths, rays, path, slot)
            add_light(paths, path, light, bounce_to_light(paths.status[path]), True)
        paths.status[path] = paths.status[path] & ~wp.static(_SHADOW_OUT)

    return connect_program
