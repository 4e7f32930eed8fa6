"""Cones around the rays of paths: how large an area of a surface a path sees, over which images are filtered.

A cone has a width and a spread, by which the width grows with distance (Akenine-Möller, Crassin, Boksansky, Belcour,
Panteleev and Wright, "Improved Shader and Texture Level of Detail Using Ray Cones", JCGT 10(1), 2021). From the camera
it is a pixel wide. A curved mirror adds twice its curvature times the width. Any other scattering adds a share of the
solid angle that its direction stands for, the reciprocal of its density, as in filtered importance sampling (Křivánek
and Colbert, "Real-time Shading with Filtered Importance Sampling", 2008): rough materials have wide cones, sharp ones
narrow ones. Widths add by their squares there (Belcour et al., "Antialiasing Complex Global Illumination Effects in
Path-space", 2017).

Where rays are refracted the cone goes on as it was, and a lens does not widen it: images are sharper there than they
had to be, never more blurred.
"""

from __future__ import annotations

import functools

import warp as wp

from ....device.codegen.local_arrays import Unset
from ....float32 import PI
from ....programs.op import NodeData
from ....programs.ops.textures.image_levels import CHANCE, FOOTPRINT
from ....programs.point import ShadingPoint
from ....programs.run import make_run
from ....scene.geometry import Geometry, corners_of, triangle_vertices
from ....scene.program import ProgramFeatures
from ....shading.bsdf.materials import DELTA, TRANSMISSION, ClosureRecord, address_of
from ...rays import Paths
from ...scene.shading_data import SceneData
from .program import with_steps
from .vertex import Vertex

# Part that a cone has of the solid angle that its direction stands for: the other paths of a pixel see the rest of it.
# With all of it pictures of pictures would be blurred twice, by the paths and by their cones.
_SHARE = 1.0 / 16.0
_SPREAD_MOST = 1.0  # widths grow no faster than distances do [m/m]


@wp.func
def path_cone(data: NodeData, paths: Paths, path: int, bounce: int) -> wp.vec2:
    """Width where the path last scattered [m], and spread [m/m]; from the camera those of a pixel."""
    if bounce > 0:
        return paths.cone[path]
    if data.inputs.perspective != 0:
        return wp.vec2(0.0, data.inputs.pixel_width)
    return wp.vec2(data.inputs.pixel_width, 0.0)


@wp.func
def cone_width(cone: wp.vec2, distance: float) -> float:
    """Width of a cone at a distance [m]; beyond where it converges, it grows again."""
    return wp.abs(cone[0] + cone[1] * distance)


@wp.func
def _bend(geometry: Geometry, triangle: int, i: int, j: int, edge: wp.vec3) -> float:
    """Curvature along an edge from corner `i` to `j`: how its normals lean apart [1/m]; `edge` in the world."""
    corners = corners_of(geometry, triangle)
    between = geometry.positions[corners[j]] - geometry.positions[corners[i]]
    lean = geometry.corner_normals[3 * triangle + j] - geometry.corner_normals[3 * triangle + i]
    scale = wp.length(between) * wp.length(edge)
    if scale > 0.0:
        return wp.dot(lean, between) / scale
    return 0.0


@wp.func
def _curvature(geometry: Geometry, instance: int, primitive: int) -> float:
    """Mean curvature of a smooth triangle, positive where it bulges out of its front [1/m]."""
    if geometry.corner_normals.shape[0] == 0:
        return 0.0
    triangle = geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive
    a, b, c = triangle_vertices(geometry, instance, primitive)
    total = _bend(geometry, triangle, 0, 1, b - a)
    total += _bend(geometry, triangle, 1, 2, c - b)
    total += _bend(geometry, triangle, 2, 0, a - c)
    return total / 3.0


@functools.cache
def make_scattered_cone(smooth_normals: bool) -> wp.Function:
    """Function (geometry, v, cone, width, instance, primitive, lobe: int, pdf) -> vec2: the cone behind a scattering.

    `lobe` and `pdf` are those of the scattered direction [1/sr].
    """

    @wp.func
    def scattered_cone(
        geometry: Geometry,
        v: Vertex,
        cone: wp.vec2,
        instance: int,
        primitive: int,
        distance: float,
        lobe: int,
        pdf: float,
    ) -> wp.vec2:
        width = cone_width(cone, distance)
        spread = cone[1]
        if wp.static(smooth_normals):
            if (lobe & TRANSMISSION) == 0:
                bend = 2.0 * width * _curvature(geometry, instance, primitive)
                if wp.dot(v.wo, v.surface.geometric_normal) < 0.0:
                    bend = -bend  # from within it is hollow
                spread += bend
        if (lobe & DELTA) == 0 and pdf > 0.0:
            # a disc of the part's solid angle, as if it were flat
            spread = wp.sqrt(spread * spread + wp.static(4.0 * _SHARE / PI) / pdf)
        return wp.vec2(width, wp.clamp(spread, -_SPREAD_MOST, _SPREAD_MOST))

    return scattered_cone


@functools.cache
def make_filtered_program(features: ProgramFeatures) -> wp.Function:
    """`run_surface` of `program.py` for a path, with the registers in front set: also takes the width of its cone at
    the point [m], and a random number.
    """
    run = make_run(features)

    @wp.func
    def run_filtered(
        data: SceneData, first: int, point: ShadingPoint, records: wp.array(dtype=Unset), width: float, chance: float
    ) -> int:
        stack = wp.zeros(wp.static(features.register_count), dtype=float)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(features.closure_count),), dtype=ClosureRecord)
        stepped = with_steps(data.nodes, point)
        # the cone cuts an ellipse out of the surface, longer by the cosine
        cell = wp.dot(stepped.step_x, stepped.step_x) * wp.abs(wp.dot(point.incoming, point.geometric_normal))
        if cell > 0.0:
            stack[wp.static(FOOTPRINT)] = wp.min(width * width / cell, wp.static(3e38))
        stack[wp.static(CHANCE)] = chance
        return run(data.nodes, stack, first, stepped, closures)

    return run_filtered
