"""Smooth surfaces that are lit from where their triangles are turned away: what of the light counts, and where shadow
rays begin.
"""

from __future__ import annotations

import functools

import warp as wp

from ....rays import Rays
from ....shading.bsdf.materials import ShadingFrame
from ....shading.terminator import make_terminator_lift
from ...scene.shading_data import SceneData


@wp.func
def cutoff_at(data: SceneData, rays: Rays, path: int) -> float:
    """`Instances.terminator` of what the path's ray met."""
    cutoff = float(0.0)
    if data.lights.choice[0].links.terminator.shape[0] > 0:
        cutoff = data.lights.choice[0].links.terminator[rays.hit_instance[path]]
    return cutoff


@functools.cache
def make_lift(instancing: bool, moving: bool) -> wp.Function:
    """Function (data, rays, path: int, frame: ShadingFrame, direction: vec3, time: float) -> vec3: from what the path's
    ray met to where a shadow ray towards `direction` begins [m], its error apart.
    """
    terminator_lift = make_terminator_lift(instancing, moving)

    @wp.func
    def lift(data: SceneData, rays: Rays, path: int, frame: ShadingFrame, direction: wp.vec3, time: float) -> wp.vec3:
        cutoff = cutoff_at(data, rays, path)
        if cutoff <= 0.0:
            return wp.vec3(0.0, 0.0, 0.0)
        return terminator_lift(
            data.geometry,
            rays.hit_instance[path],
            rays.hit_primitive[path],
            rays.hit_uv[path],
            frame,
            direction,
            cutoff,
            time,
        )

    return lift


@functools.cache
def make_lit_side(terminator: bool) -> wp.Function:
    """Function (data, rays, path: int, frame: ShadingFrame, direction: vec3) -> vec3: the normal that says to which
    side of a surface light from `direction` comes that is aimed at. Where shadow rays begin above the triangle it is
    the shading normal, else the triangle's.
    """

    @wp.func
    def lit_side(data: SceneData, rays: Rays, path: int, frame: ShadingFrame, direction: wp.vec3) -> wp.vec3:
        normal = frame.geometric_normal
        if wp.static(terminator):
            if wp.dot(direction, normal) * wp.dot(direction, frame.normal) < 0.0:
                if cutoff_at(data, rays, path) > 0.0:
                    normal = frame.normal
        return normal

    return lit_side


@functools.cache
def make_lit_frame(terminator: bool) -> wp.Function:
    """Function (data, rays, path: int, frame: ShadingFrame, direction: vec3, turn: int) -> ShadingFrame: the frame by
    which closures are evaluated for `direction`: in turn 0 that of a light.
    """
    lit_side = make_lit_side(terminator)

    @wp.func
    def lit_frame(
        data: SceneData, rays: Rays, path: int, frame: ShadingFrame, direction: wp.vec3, turn: int
    ) -> ShadingFrame:
        lit = ShadingFrame()
        lit.geometric_normal = frame.geometric_normal
        lit.normal = frame.normal
        lit.tangent = frame.tangent
        lit.bitangent = frame.bitangent
        lit.entering = frame.entering
        if turn == 0:
            lit.geometric_normal = lit_side(data, rays, path, frame, direction)
        return lit

    @wp.func
    def same_frame(
        data: SceneData, rays: Rays, path: int, frame: ShadingFrame, direction: wp.vec3, turn: int
    ) -> ShadingFrame:
        return frame

    return lit_frame if terminator else same_frame
