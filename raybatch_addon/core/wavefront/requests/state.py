"""The state of a path while rays are traced for the program of its surface."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from ...programs.ops.inputs.ray_inputs import ANSWERS
from ...scene.features import SceneFeatures


class Phase(IntEnum):
    """Where a path stands."""

    NONE = 0  # nothing is asked for, or all of it is answered
    WAITING = 1  # a ray of a request is under way
    PASS = 2  # one of the pass Ambient Occlusion


@wp.struct
class Requests:
    """One entry a path."""

    first: int  # register of programs from which on answers are given
    phase: wp.array(dtype=int)  # `Phase`
    known: wp.array(dtype=int)  # requests that are answered; the next is the one that rays are traced for
    # that request
    asked: wp.array(dtype=int)  # `RequestBits` and samples, as in `ray_inputs.py`
    normal: wp.array(dtype=wp.vec3)  # unit
    distance: wp.array(dtype=float)  # [m]
    total: wp.array(dtype=wp.vec3)  # of its samples so far
    # the sample under way
    turn: wp.array(dtype=int)
    passed: wp.array(dtype=int)  # surfaces that its ray has passed
    left: wp.array(dtype=float)  # how far its ray goes from its origin [m]
    # the path's own ray and its hit, whose place in `Rays` is taken meanwhile
    origin: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    t_max: wp.array(dtype=float)
    hit_t: wp.array(dtype=float)
    hit_instance: wp.array(dtype=int)
    hit_primitive: wp.array(dtype=int)
    hit_uv: wp.array(dtype=wp.vec2)


def _arrays() -> dict[str, type]:
    """Types of the elements of each array of `Requests`."""
    return {name: each.type.dtype for name, each in Requests.vars.items() if name != "first"}


def allocate_requests(path_count: int, features: SceneFeatures, device: wp.Device) -> Requests | None:
    """The state of `path_count` paths; the programs are those of `features`. None where no rays are asked for."""
    if not (features.requests or features.occlusion_pass):
        return None
    requests, programs = Requests(), features.programs
    requests.first = programs.register_count - ANSWERS - 3 * programs.answer_count
    for name, dtype in _arrays().items():
        setattr(requests, name, wp.zeros(path_count, dtype=dtype, device=device))
    return requests


def request_bytes_per_path(features: SceneFeatures) -> int:
    """Device memory of the state of one path, its answers apart [bytes]; 0 where no rays are asked for."""
    if not (features.requests or features.occlusion_pass):
        return 0
    return sum(wp.types.type_size_in_bytes(dtype) for dtype in _arrays().values())
