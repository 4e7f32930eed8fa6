"""Image textures: image coordinates from texture coordinates.

The projections are those of Cycles. Flat takes x and y as they are. Sphere and tube wrap the image around the z axis
through the middle of the unit cube. Box looks along the three axes of the object and mixes by the direction of its
normal.
"""

import functools
from enum import IntEnum

import warp as wp

from ....float32 import PI
from ....shading.images.textures import sample_image, sample_level
from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint


class Projection(IntEnum):
    """Projection of texture coordinates to an image (op `image`)."""

    FLAT = 0
    SPHERE = 1
    TUBE = 2


_SPHERE = wp.constant(int(Projection.SPHERE))
_TUBE = wp.constant(int(Projection.TUBE))


@wp.func
def around(x: float, y: float) -> float:
    """Azimuth of (x, y) around the z axis, 0..1, with 1/2 at +y; 0 on the axis."""
    if x == 0.0 and y == 0.0:
        return 0.0
    return 0.5 * (1.0 - wp.atan2(x, y) * wp.static(1.0 / PI))


@wp.func
def sphere_projection(p: wp.vec3) -> wp.vec2:
    """Image coordinates of `p`, relative to the sphere's centre, by longitude and latitude."""
    length = wp.length(p)
    if not (length > 0.0 and wp.isfinite(length)):
        return wp.vec2(0.0, 0.0)
    angle = wp.acos(wp.clamp(p[2] / length, -1.0, 1.0))
    return wp.vec2(around(p[0], p[1]), 1.0 - angle * wp.static(1.0 / PI))


@wp.func
def tube_projection(p: wp.vec3) -> wp.vec2:
    """Image coordinates of `p`, relative to the middle of a tube that is 2 high, by angle and height."""
    if p[0] == 0.0 and p[1] == 0.0:
        return wp.vec2(0.0, 0.0)
    return wp.vec2(around(p[0], p[1]), 0.5 * (p[2] + 1.0))


@wp.func
def _band(share: float, blend: float) -> float:
    """A share between 0 and 1, steepened so that it changes in the middle part `blend` alone."""
    return wp.clamp((share - 0.5 * (1.0 - blend)) / blend, 0.0, 1.0)


@wp.func
def box_weights(normal: wp.vec3, blend: float) -> wp.vec3:
    """Weights of the views along x, y and z, with sum 1; `normal` in object space.

    The absolute components of the normal are barycentric coordinates of a triangle whose corners are the three views.
    `blend` is how far views mix: around each corner is an area of one view, along each side one of two, and in the
    middle one of all three.
    """
    sizes = wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2]))
    total = sizes[0] + sizes[1] + sizes[2]
    if not (total > 0.0 and wp.isfinite(total)):
        return wp.vec3(1.0, 0.0, 0.0)
    n = sizes / total
    limit = 0.5 * (1.0 + blend)
    if n[0] > limit * (n[0] + n[1]) and n[0] > limit * (n[0] + n[2]):
        return wp.vec3(1.0, 0.0, 0.0)
    if n[1] > limit * (n[0] + n[1]) and n[1] > limit * (n[1] + n[2]):
        return wp.vec3(0.0, 1.0, 0.0)
    if n[2] > limit * (n[0] + n[2]) and n[2] > limit * (n[1] + n[2]):
        return wp.vec3(0.0, 0.0, 1.0)
    if not blend > 0.0:
        return wp.vec3(1.0, 0.0, 0.0)  # exactly between two views
    if n[2] < (1.0 - limit) * (n[1] + n[0]):
        w = _band(n[0] / (n[0] + n[1]), blend)
        return wp.vec3(w, 1.0 - w, 0.0)
    if n[0] < (1.0 - limit) * (n[1] + n[2]):
        w = _band(n[1] / (n[1] + n[2]), blend)
        return wp.vec3(0.0, w, 1.0 - w)
    if n[1] < (1.0 - limit) * (n[0] + n[2]):
        w = _band(n[0] / (n[0] + n[2]), blend)
        return wp.vec3(w, 0.0, 1.0 - w)
    low = limit - 1.0
    return wp.vec3((2.0 - limit) * n[0] + low, (2.0 - limit) * n[1] + low, (2.0 - limit) * n[2] + low) / (
        2.0 * limit - 1.0
    )


@wp.func
def box_uv(axis: int, p: wp.vec3, normal: wp.vec3) -> wp.vec2:
    """Image coordinates of `p` in the view along `axis`, turned so that it is not mirrored on either side."""
    across = p[1]
    up = p[2]
    flipped = normal[0] < 0.0
    if axis == 1:
        across = p[0]
        flipped = normal[1] > 0.0
    elif axis == 2:
        up = p[0]
        flipped = normal[2] > 0.0
    if flipped:
        across = 1.0 - across
    return wp.vec2(across, up)


@wp.func
def projected_uv(p: wp.vec3, projection: int) -> wp.vec2:
    """Image coordinates of texture coordinates `p`."""
    image_uv = wp.vec2(p[0], p[1])
    centred = wp.vec3(2.0 * p[0] - 1.0, 2.0 * p[1] - 1.0, 2.0 * p[2] - 1.0)
    if projection == _SPHERE:
        image_uv = sphere_projection(centred)
    elif projection == _TUBE:
        image_uv = tube_projection(centred)
    return image_uv


@wp.func
def put_texel(data: NodeData, stack: wp.array(dtype=float), at: int, value: wp.vec4):
    """Write colour and alpha of a look-up, the outputs from the word at `at` on."""
    put_vector(data, stack, at, wp.vec3(value[0], value[1], value[2]))
    put_number(data, stack, at + 1, value[3])


@op("image", "miiiiv>VN", foldable=False)
@wp.func
def image(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture, colour and alpha.

    Operands: image, `Interpolation`, `Extension`, `Projection`, whether alpha is divided out, coordinates.
    """
    image_uv = projected_uv(vector(data, stack, pc + 6), data.code[pc + 4])
    value = sample_image(
        data.images, data.code[pc + 1], image_uv, data.code[pc + 2], data.code[pc + 3], data.code[pc + 5]
    )
    put_texel(data, stack, pc + 7, value)


@functools.cache
def make_box_texel(at_level: bool) -> wp.Function:
    """Function (data, stack, pc: int, first: int, level: int) -> vec4: the texel of an op with box projection, whose
    operands are those of `image_box`, with coordinates from the word `first` on; `level` counts with `at_level`.
    """

    @wp.func
    def box_texel(data: NodeData, stack: wp.array(dtype=float), pc: int, first: int, level: int) -> wp.vec4:
        p = vector(data, stack, first)
        normal = vector(data, stack, first + 1)
        weights = box_weights(normal, number(data, stack, pc + 5))
        total = wp.vec4(0.0, 0.0, 0.0, 0.0)
        axis = int(0)
        while axis < 3:  # a loop that is not unrolled, so that the look-up is compiled once
            if weights[axis] > 0.0:
                uv = box_uv(axis, p, normal)
                if wp.static(at_level):
                    total += weights[axis] * sample_level(
                        data.images,
                        data.code[pc + 1],
                        level,
                        uv,
                        data.code[pc + 2],
                        data.code[pc + 3],
                        data.code[pc + 4],
                    )
                else:
                    total += weights[axis] * sample_image(
                        data.images, data.code[pc + 1], uv, data.code[pc + 2], data.code[pc + 3], data.code[pc + 4]
                    )
            axis += 1
        return total

    return box_texel


_box_texel = make_box_texel(at_level=False)


@op("image_box", "miiinvv>VN", foldable=False)
@wp.func
def image_box(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture with box projection, colour and alpha.

    Operands: image, `Interpolation`, `Extension`, whether alpha is divided out, blend, coordinates, normal in object
    space.
    """
    put_texel(data, stack, pc + 8, _box_texel(data, stack, pc, pc + 6, 0))
