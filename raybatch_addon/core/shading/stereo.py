"""Spherical stereo: an eye beside the camera whose side turns with the ray, so that panoramas have depth everywhere.

As Cycles does it (its manual, "Stereoscopy: Spherical Stereo"; Peleg, Ben-Ezra and Pritch 2001, "Omnistereo").
"""

from __future__ import annotations

import math

import warp as wp

from ..scene.description import SphericalStereo


def stereo_numbers(stereo: SphericalStereo) -> tuple[float, float, float, float]:
    """The offset [m], one over the convergence distance [1/m], and the angles of the poles [rad], beyond all where the
    offset does not fade.
    """
    return stereo.offset, 1 / stereo.convergence_distance, *(stereo.pole_angles or (4.0, 5.0))


@wp.func
def eye_offset(numbers: wp.vec4, direction: wp.vec3, up: wp.vec3) -> wp.vec3:
    """Where the eye is for a ray along `direction` (unit), from the camera [m]; at the poles of `up` it is there."""
    side = wp.cross(direction, up)
    length = wp.length(side)
    if length == 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    offset = numbers[0]
    altitude = wp.abs(wp.asin(wp.clamp(wp.dot(direction, up), -1.0, 1.0)))
    if altitude > numbers[3]:
        offset = 0.0
    elif altitude > numbers[2]:
        offset = offset * wp.cos((altitude - numbers[2]) / (numbers[3] - numbers[2]) * wp.static(math.pi / 2))
    return (offset / length) * side


@wp.func
def towards_convergence(numbers: wp.vec4, direction: wp.vec3, offset: wp.vec3) -> wp.vec3:
    """`direction` as the eye at `offset` sees the same point at the convergence distance."""
    if numbers[1] == 0.0:
        return direction
    return wp.normalize(direction - numbers[1] * offset)
