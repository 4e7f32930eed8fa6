"""Passes of a path's first surfaces: up to the first that is not transparent."""

from __future__ import annotations

import functools

import warp as wp

from ...film.mattes import MatteTile, add_matte
from ...film.tile import FilmTile
from ...rays import Rays
from ...shading.bsdf.bsdf import ClosureFeatures, make_bsdf
from ..catchers.copies import is_copy, is_once_more
from ..rays import Paths
from ..scene.shading_data import SceneData, depth_of
from ..stages.generate import pixel_sample
from ..stages.surface.vertex import Vertex
from ..stages.work import TileWork
from .colors import ClosuresInView, make_closure_colors
from .state import PassInputs, PathPasses, add_channels
from .vectors import make_motion_vectors


@wp.func
def settles(paths: Paths) -> bool:
    """Whether `record_surface` decides which surface the passes show, where surfaces may be transparent."""
    return paths.passes.shape[0] > 0


@wp.func
def mean_channel(color: wp.vec3) -> float:
    """The mean of the channels."""
    return (color[0] + color[1] + color[2]) / 3.0


@wp.func
def clear_view(data: SceneData, inputs: PassInputs, position: wp.vec3) -> float:
    """Share of a point's light that mist lets through, in [0, 1]."""
    ray = position - data.view_origin
    distance = wp.length(ray)
    if inputs.orthographic != 0:
        distance = wp.abs(wp.dot(ray, data.view_axis))
    mist = wp.clamp((distance - inputs.mist_start) * inputs.mist_scale, 0.0, 1.0)
    if inputs.mist_falloff == 2.0:
        mist = mist * mist
    elif inputs.mist_falloff == 0.5:
        mist = wp.sqrt(mist)
    return 1.0 - mist


@wp.func
def uv_at(inputs: PassInputs, instance: int, primitive: int, barycentric: wp.vec2) -> wp.vec3:
    """Coordinates of the object's active UV map there, and 1; 0 where it has none."""
    result = wp.vec3(0.0, 0.0, 0.0)
    first = inputs.uv_first[instance]
    if first >= 0:
        corner = first + 3 * primitive
        a = inputs.uvs[corner]
        uv = a + barycentric[0] * (inputs.uvs[corner + 1] - a) + barycentric[1] * (inputs.uvs[corner + 2] - a)
        result = wp.vec3(uv[0], uv[1], 1.0)
    return result


@wp.func
def add_mattes(mattes: MatteTile, inputs: PassInputs, pixel: int, instance: int, material: int, weight: float):
    """Add `weight` to the identities of what is seen."""
    if inputs.object_matte >= 0:
        add_matte(mattes, inputs.object_matte, pixel, inputs.object_identity[instance], weight)
    if inputs.material_matte >= 0:
        add_matte(mattes, inputs.material_matte, pixel, inputs.material_identity[material], weight)
    if inputs.asset_matte >= 0:
        add_matte(mattes, inputs.asset_matte, pixel, inputs.asset_identity[instance], weight)


@wp.func
def record_aov(paths: Paths, path: int, passed: int, number: int, value: wp.vec3):
    """A material's value for one of its passes, seen through `passed` transparent surfaces."""
    if paths.passes.shape[0] > 0:
        passes = paths.passes[0]
        settled = bool(False)
        if passed > 0 and passes.settled.shape[0] > 0:
            settled = passes.settled[path] != 0
        if number < passes.aov.shape[0] and not settled:
            place = passes.aov[number]
            for c in range(place[1]):
                added = float(1.0)  # a colour's alpha
                if c < 3:
                    added = value[c]
                passes.values[place[0] + c, path] = passes.values[place[0] + c, path] + added


@wp.func
def note_motion(passes: PathPasses, path: int, motion: wp.vec4):
    """Let a sample of the pass Vector be `motion`."""
    for c in range(4):
        passes.values[passes.vector + c, path] = motion[c]
    passes.values[passes.vector_weight, path] = 1.0


@functools.cache
def make_record_background(catchers: bool = False, panoramas: bool = False) -> wp.Function:
    """Function (work, paths, film, path: int, direction: vec3) for a path that leaves the scene in `direction` before
    it scattered: indices are those of a surface that was transparent no more, and Vector is how the background moves.
    With `catchers` paths that are traced once more record nothing. `panoramas`: the pass Vector may be that of a
    panorama.
    """
    motion_of = make_motion_vectors(panoramas).of_background

    @wp.func
    def record_background(work: TileWork, paths: Paths, film: FilmTile, path: int, direction: wp.vec3):
        passes = paths.passes[0]
        if wp.static(catchers):
            if is_once_more(paths, path):
                return
        if passes.settled.shape[0] > 0 and paths.passed[path] != 0:
            if passes.settled[path] != 0:
                return
            pixel = pixel_sample(work, paths.item[path])
            if pixel.sample == wp.uint32(0):
                if film.object_index.shape[0] > 0:
                    film.object_index[pixel.index] = 0.0
                if film.material_index.shape[0] > 0:
                    film.material_index[pixel.index] = 0.0
                if film.depth.shape[0] > 0:
                    film.depth[pixel.index] = 0.0
                if film.position.shape[0] > 0:
                    film.position[pixel.index] = wp.vec3(0.0, 0.0, 0.0)
        if passes.vector >= 0:
            note_motion(passes, path, motion_of(passes.inputs.vector, direction))

    return record_background


@functools.cache
def make_record_surface(
    features: ClosureFeatures, transparency: bool, colors: bool, catchers: bool = False, panoramas: bool = False
) -> wp.Function:
    """Function (data, paths, rays, film, path: int, v: Vertex, view: ClosuresInView): what passes show of a surface
    that a path meets before it scatters. Depth, Position and Normal are among them where surfaces may be transparent
    (`transparency`), the passes of colours with `colors`. With `catchers` copies of paths record
    nothing. `panoramas`: the pass Vector may be that of a panorama.
    """
    let_through = make_bsdf(features).transparency
    motion_of = make_motion_vectors(panoramas).of_surface
    closure_colors = make_closure_colors(features) if colors else None

    @wp.func
    def record_surface(
        data: SceneData, paths: Paths, rays: Rays, film: FilmTile, path: int, v: Vertex, view: ClosuresInView
    ):
        passes = paths.passes[0]
        if wp.static(catchers):
            if is_copy(paths, path):
                return
        instance = rays.hit_instance[path]
        primitive = rays.hit_primitive[path]
        barycentric = rays.hit_uv[path]
        throughput = paths.throughput[path]
        alpha = wp.vec3(1.0, 1.0, 1.0)
        settled = int(0)
        if wp.static(transparency):
            through = let_through(view.closures, view.first, view.end)
            for c in range(3):
                alpha[c] = wp.clamp(1.0 - through[c], 0.0, 1.0)
            if passes.settled.shape[0] > 0 and v.passed > 0:
                settled = passes.settled[path]
        if settled == 0:
            if v.pixel.sample == wp.uint32(0) and mean_channel(alpha) > 0.0:  # nobody sees what lets all light pass
                if film.object_index.shape[0] > 0:
                    film.object_index[v.pixel.index] = passes.inputs.object_index[instance]
                if film.material_index.shape[0] > 0:
                    film.material_index[v.pixel.index] = passes.inputs.material_index[v.surface.material]
                if wp.static(transparency):
                    if film.depth.shape[0] > 0:
                        film.depth[v.pixel.index] = depth_of(data, v.surface.position)
                    if film.position.shape[0] > 0:
                        film.position[v.pixel.index] = v.surface.position
            if mean_channel(alpha) >= passes.inputs.alpha_threshold:
                settled = 1
                if wp.static(transparency):
                    if paths.normal.shape[0] > 0:
                        paths.normal[path] = view.frame.normal
                if passes.uv >= 0:
                    add_channels(passes, passes.uv, path, uv_at(passes.inputs, instance, primitive, barycentric))
                if passes.vector >= 0:
                    moved = motion_of(passes.inputs.vector, instance, primitive, barycentric, v.surface.position)
                    note_motion(passes, path, moved)
        if wp.static(transparency):
            if passes.settled.shape[0] > 0:
                passes.settled[path] = settled
        if film.mattes.identity.shape[0] > 0:
            weight = mean_channel(throughput) * mean_channel(alpha)
            if weight > 0.0:
                add_mattes(film.mattes, passes.inputs, v.pixel.index, instance, v.surface.material, weight)
        if passes.mist >= 0:
            seen = clear_view(data, passes.inputs, v.surface.position) * mean_channel(wp.cw_mul(throughput, alpha))
            passes.values[passes.mist, path] = passes.values[passes.mist, path] + seen
        if wp.static(colors):
            if passes.color[0] >= 0 or passes.color[1] >= 0 or passes.color[2] >= 0:
                found = closure_colors(view, data.materials.albedo)
                add_channels(passes, passes.color[0], path, wp.cw_mul(throughput, found.diffuse))
                add_channels(passes, passes.color[1], path, wp.cw_mul(throughput, found.glossy))
                add_channels(passes, passes.color[2], path, wp.cw_mul(throughput, found.transmission))

    return record_surface
