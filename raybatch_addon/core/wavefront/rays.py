"""All state of paths on the device, and the memory of their rays.

A path has two ray slots: slot `p` holds the ray that extends path `p` (closest hit), slot `path_count + p` its
shadow ray (occlusion). Both may be under way at once; the path goes on when both are back.

There may be many millions of paths, so nothing is kept twice: `RayNeeds` says which arrays a render has, and which of
them share memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import warp as wp

from ..bvh.tree import TRAIL_LEVELS, TopProgress
from ..rays import Rays
from ..scene.description import Visibility
from ..scene.features import SceneFeatures
from ..shading.lights.choice import LitPoint, lit_point
from .passes.state import PathPasses, pass_bytes_per_path
from .requests.state import Requests, request_bytes_per_path
from .textures.state import texture_bytes_per_path
from .volumes.table import state_bytes_per_path


class Status(IntFlag):
    """The lowest bits of `Paths.status`; 0 is a free slot."""

    ALIVE = 1
    RAY_NEW = 2  # the extending ray waits to be submitted
    RAY_OUT = 4  # the extending ray is in the tracer
    SHADOW_NEW = 8  # the shadow ray waits to be submitted
    SHADOW_OUT = 16  # the shadow ray is in the tracer
    ENDED = 32  # the path ends when its shadow ray is back
    HIT = 64  # the extending ray came back with a hit
    STRAIGHT = 128  # the path passed straight on where the shadow ray comes from
    INSIDE = 256  # the extending ray is a step of a random walk below a surface


# How the extending ray came back, which the next stage no longer asks for
CAME_BACK = int(Status.HIT | Status.STRAIGHT)
# Above the status: the `Visibility` bit of the extending ray (5 bits), and the bounce (up to 2^17 - 1). An extending
# ray is never one for shadows, whose bit stands for VOLUME_SCATTER there
VISIBILITY_SHIFT = 9
BY_VOLUME = int(Visibility.SHADOW) << VISIBILITY_SHIFT
BOUNCE_SHIFT = 14
# In `Paths.passed`, passes by the shadow ray are counted above those of the extending ray; both go on from what the
# path passed before
SHADOW_PASS = 1 << 16
# Places in lists: two lists, and blocks' counts of paths (`path_lists.py`)
LIST_BYTES_PER_PATH = 2 * 4 + 1


@wp.struct
class Walks:
    """Random walks below surfaces, one entry a path; no entries where no closure asks for them. Set where a path goes
    in.
    """

    step: wp.array(
        dtype=int
    )  # number of the step that the path's ray takes, from 1; 0: it has come out, where the ray met the surface
    instance: wp.array(dtype=int)  # in which it walks
    extinction: wp.array(dtype=wp.vec3)  # [1/m]
    albedo: wp.array(dtype=wp.vec3)  # of a single scattering
    g: wp.array(dtype=float)  # mean cosine of the phase function
    entry: wp.array(dtype=wp.vec3)  # where it went in [m]
    normal: wp.array(dtype=wp.vec3)  # unit, outwards there
    thickness: wp.array(dtype=float)  # how deep the far side lies behind `entry` [m]; -1: not near
    length: wp.array(dtype=float)  # of the step, where nothing is met before [m]
    gone: wp.array(dtype=float)  # the part of it before the ray's origin: other objects lie inside [m]
    phase: wp.array(dtype=float)  # the phase function in the step's direction [1/sr]


@wp.struct
class Paths:
    """Shading state, one entry a path slot. Arrays that a scene does not need have no entries."""

    status: wp.array(
        dtype=int
    )  # `Status` bits, the extending ray's visibility, and scattering events so far, without straight passes
    item: wp.array(dtype=wp.uint32)  # number of the path within its tile: pixel and sample (`pixel_sample`)
    throughput: wp.array(dtype=wp.vec3)
    radiance: wp.array(dtype=wp.vec3)  # summed in bounce order
    pdf: wp.array(dtype=float)  # solid-angle density of the extending ray; 0: specular or from the camera
    side: wp.array(dtype=wp.uint32)  # `packed_side` the surface that it left; where there are several emitters
    receiver: wp.array(dtype=int)  # the light set of what it left; where light is linked
    shadow_light: wp.array(dtype=wp.vec3)  # what the shadow ray adds to `radiance` if nothing is in its way
    # light of programs, which is multiplied in when the shadow ray is back
    light_program: wp.array(dtype=int)  # WORLD_PROGRAM, SURFACE_PROGRAM, LAMP_PROGRAM; 0: `shadow_light` is all
    light_instance: wp.array(dtype=int)  # of lamps their number
    light_primitive: wp.array(dtype=int)
    light_cell: wp.array(dtype=int)  # emitter that is a cell of a volume; -1: another; where volumes are emitters
    light_barycentric: wp.array(
        dtype=wp.vec2
    )  # of lamps how far they were when aimed at [m], and how much of that `t_max` lacks
    # transparency
    passed: wp.array(dtype=int)  # transparent surfaces passed by the extending ray, and (x 65536) by the shadow ray
    passed_t: wp.array(dtype=float)  # distance from the last scattering to the extending ray's origin [m]
    shadow_t: wp.array(dtype=float)  # the same of the shadow ray, where there are programs, which may ask
    alpha: wp.array(dtype=float)  # coverage; transparent films
    # 1: since the camera the path has scattered in clear glass alone, set by the first scattering; where a transparent
    # film shows through glass
    clear: wp.array(dtype=wp.uint8)
    # `history_after` of the extending ray, and of the shadow ray; where a program asks
    history: wp.array(dtype=int)
    shadow_history: wp.array(dtype=int)
    # cone around the extending ray: its width where the path last scattered [m], and how that grows [m/m]; where images
    # are filtered, from the first scattering on
    cone: wp.array(dtype=wp.vec2)
    # least density of the directions that the path has scattered to [1/sr], set by the first; where glossy is
    # filtered, or edges are rounded
    least_density: wp.array(dtype=float)
    # what rays answered to the program of the surface, all first answers before all second ones; see `ray_inputs.py`
    answers: wp.array(dtype=wp.vec3)
    requests: wp.array(dtype=Requests)  # one entry for all paths; none where nothing asks for rays
    walk: Walks
    normal: wp.array(dtype=wp.vec3)  # at the first hit, for the pass
    passes: wp.array(dtype=PathPasses)  # one entry for all paths; none where passes need none


@wp.func
def bounce_of(status: int) -> int:
    """Scattering events of a path so far."""
    return status >> wp.static(BOUNCE_SHIFT)


@wp.func
def is_clear(paths: Paths, path: int, bounce: int) -> bool:
    """Whether a transparent film shows what the path meets after `bounce` scatterings."""
    if bounce > 0:
        if paths.clear.shape[0] > 0:
            return paths.clear[path] != wp.uint8(0)
        return False
    return True


@wp.func
def bounce_to_light(status: int) -> int:
    """Scattering events between the camera and the light that the path's shadow ray was aimed at."""
    bounce = bounce_of(status)
    if (status & wp.static(int(Status.STRAIGHT | Status.INSIDE))) != 0:  # the count is still that of before the surface
        bounce += 1
    return bounce


@wp.func
def passed_before_light(paths: Paths, path: int) -> int:
    """Transparent surfaces that the path had passed where its shadow ray began."""
    passed = int(0)
    if paths.passed.shape[0] > 0:
        passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        if (paths.status[path] & wp.static(int(Status.STRAIGHT))) != 0:
            passed -= 1
    return passed


@wp.func
def left_side(paths: Paths, path: int) -> wp.uint32:
    """The path's `side`, where there is one."""
    if paths.side.shape[0] > 0:
        return paths.side[path]
    return wp.uint32(0)


@wp.func
def note_receiver(paths: Paths, path: int, receiver: int):
    """Note the light set of what the path scatters at, where light is linked."""
    if paths.receiver.shape[0] > 0:
        paths.receiver[path] = receiver


@wp.func
def note_density(paths: Paths, path: int, bounce: int, density: float):
    """Note that the path scattered with this density [1/sr] at its vertex `bounce`, where the least so far is kept."""
    if paths.least_density.shape[0] > 0:
        least = float(density)
        if bounce > 0:
            least = wp.min(density, paths.least_density[path])
        paths.least_density[path] = least


@wp.func
def left_point(paths: Paths, path: int, origin: wp.vec3) -> LitPoint:
    """Where the path's extending ray left a surface or a volume: at `origin`."""
    point = lit_point(origin, left_side(paths, path))
    if paths.receiver.shape[0] > 0 and bounce_of(paths.status[path]) > 0:
        point.receiver = paths.receiver[path]
    return point


@wp.func
def visibility_of(status: int) -> int:
    """The `Visibility` bit of a path's extending ray."""
    kind = (status >> wp.static(VISIBILITY_SHIFT)) & 31
    return wp.where(kind == wp.static(int(Visibility.SHADOW)), wp.static(int(Visibility.VOLUME_SCATTER)), kind)


@dataclass(frozen=True, kw_only=True)
class RayNeeds:
    """Arrays that the rays of a render need, beside origin, direction, `t_max` and `hit_instance`."""

    shadow_rays: bool = False  # every path has a slot for a shadow ray
    shadow_hits: bool = True  # shadow rays ask for closest hits
    limits: bool = True  # `t_max` is read after the hit, so that `hit_t` needs memory of its own
    visibility: bool = True  # the tracer reads which objects a ray sees
    time: bool = False  # paths are at times of their own

    @staticmethod
    def of(features: SceneFeatures, reference: bool = False) -> RayNeeds:
        """For a scene with `features`. Warp's own tree (`reference`) reads everything, and leaves no `t_max` where
        nothing is hit.
        """
        through = features.transparency
        return RayNeeds(
            shadow_rays=features.shadow_rays,
            shadow_hits=through,
            limits=through or reference or features.catchers,
            visibility=features.instancing or reference,
            time=features.motion,
        )

    @property
    def entries(self) -> dict[str, int]:
        """Entries for each path, by name of an array of `Rays`; `hit_t` without any shares the memory of `t_max`."""
        slots = 1 + self.shadow_rays
        closest = 1 + (self.shadow_rays and self.shadow_hits)
        return {
            "origin": slots,
            "direction": slots,
            "t_max": slots,
            "visibility": slots * self.visibility,
            "time": int(self.time),
            "hit_t": slots * self.limits,
            "hit_instance": slots,
            "hit_primitive": closest,
            "hit_uv": closest,
        }

    @property
    def bytes_per_path(self) -> int:
        """Device memory of the ray slots of one path [bytes]."""
        return sum(
            count * wp.types.type_size_in_bytes(Rays.vars[name].type.dtype) for name, count in self.entries.items()
        )


def allocate_rays(path_count: int, device: wp.Device, needs: RayNeeds = RayNeeds()) -> Rays:
    """`Rays` for `path_count` paths; by default one slot each and every array in full."""
    rays = Rays()
    for name, count in needs.entries.items():
        setattr(rays, name, wp.zeros(path_count * count, dtype=Rays.vars[name].type.dtype, device=device))
    rays.hit_instance.fill_(-1)
    if not needs.limits:
        rays.hit_t = rays.t_max
    return rays


def needed_arrays(features: SceneFeatures) -> dict[str, bool]:
    """By name of an array of `Paths`: whether a scene with `features` has it. Those of other shapes are apart."""
    shadow_rays, transparency, history = features.shadow_rays, features.transparency, features.path_history
    return {
        "status": True,
        "item": True,
        "throughput": True,
        "radiance": True,
        "pdf": True,
        "side": shadow_rays and features.light_choice,
        "receiver": features.light_links,
        "shadow_light": shadow_rays,
        "light_program": features.light_programs,
        "light_instance": features.light_programs,
        "light_primitive": features.light_programs,
        "light_barycentric": features.light_programs,
        "light_cell": features.volume_lights and shadow_rays,
        "passed": transparency,
        "passed_t": transparency,
        "shadow_t": transparency and shadow_rays and bool(features.programs),
        "alpha": features.film_transparent,
        "clear": features.film_glass,
        "history": history,
        "shadow_history": history and shadow_rays,
        "cone": features.texture_levels,
        "least_density": features.least_density,
        "normal": features.normal_pass,
    }


@wp.func
def time_of(rays: Rays, path: int) -> float:
    """When a path is, 0 to 1; 0 where nothing moves."""
    if rays.time.shape[0] > 0:
        return rays.time[path]
    return 0.0


def allocate_paths(path_count: int, features: SceneFeatures, device: wp.Device) -> Paths:
    """`Paths` for `path_count` slots, all free."""
    paths = Paths()
    for name, is_needed in needed_arrays(features).items():
        dtype = Paths.vars[name].type.dtype
        setattr(paths, name, wp.zeros(path_count if is_needed else 0, dtype=dtype, device=device))
    paths.answers = wp.zeros(path_count * features.request_program.answer_count, dtype=wp.vec3, device=device)
    for name, array in Walks.vars.items():
        entry_count = path_count if features.subsurface else 0
        setattr(paths.walk, name, wp.zeros(entry_count, dtype=array.type.dtype, device=device))
    return paths


def trail_words(levels: int) -> int:
    """Words of a ray's trail through `levels` levels of resident nodes."""
    return max(1, -(-levels // TRAIL_LEVELS))


def allocate_progress(count: int, words: int, instancing: bool, device: wp.Device) -> TopProgress:
    """`TopProgress` of `count` rays with trails of `words` words."""
    progress = TopProgress()
    progress.trail = wp.zeros((words, count), dtype=wp.uint32, device=device)
    progress.entry = wp.zeros(count if instancing else 0, dtype=int, device=device)
    progress.visits = wp.zeros(1, dtype=wp.int64, device=device)
    return progress


def bytes_per_path(features: SceneFeatures, reference: bool = False, paths: SceneFeatures | None = None) -> int:
    """Device memory of one path alive: state, its ray slots, and its entries in lists [bytes]. `reference`: Warp's own
    tree is traced. `paths`: what decides on the arrays of `Paths` (default: `features`).
    """
    paths = paths or features
    arrays = [Paths.vars[name] for name, is_needed in needed_arrays(paths).items() if is_needed]
    if paths.subsurface:
        arrays += Walks.vars.values()
    path = sum(wp.types.type_size_in_bytes(array.type.dtype) for array in arrays)
    path += pass_bytes_per_path(features)
    path += request_bytes_per_path(features) + 12 * features.request_program.answer_count
    path += texture_bytes_per_path(features)
    if features.volumes:
        path += state_bytes_per_path()
    return path + RayNeeds.of(features, reference).bytes_per_path + LIST_BYTES_PER_PATH
