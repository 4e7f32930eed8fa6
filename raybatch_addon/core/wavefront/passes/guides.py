"""Guides of a denoiser: albedo, normal and depth of what a pixel shows, seen through mirrors and glass.

As in Cycles (`kernel/film/denoising_passes.h`): closures that are rough count as diffuse. Where they are more than a
quarter of a surface, by how often they are sampled, albedo and normal are those of this surface, and the path notes no
more. Elsewhere the path goes on, and what it meets next counts by the albedo of the smooth closures. Light that is seen
before the end counts as albedo. A volume that scatters the path ends what it notes: it has its albedo there, and a
normal that looks at the camera. Depth is the sum over the way to surfaces, those around volumes among them, of its
parts, each by what it counts; unlike in Cycles the world behind everything adds no depth.
"""

from __future__ import annotations

import functools

import warp as wp

from ...scene.description import ClosureKind
from ...shading.bsdf.albedo import AlbedoTables
from ...shading.bsdf.facets import make_facets
from ...shading.bsdf.lobes import make_lobes
from ...shading.bsdf.materials import MICROFACET_KINDS, ClosureFeatures
from ...shading.bsdf.normals import make_normals
from ..rays import Paths
from ..stages.limits import has_light
from .colors import ClosuresInView
from .state import add_channels, is_guided

_K = ClosureKind
# Facets with a larger alpha count as diffuse, as in Cycles
ALPHA_SMOOTH = 0.075
TOWARDS_CAMERA = -1.0  # z of a normal that looks at the camera, as `PathPasses.to_camera` has it
_TRANSPARENT = wp.constant(int(_K.TRANSPARENT))
_RAY_PORTAL = wp.constant(int(_K.RAY_PORTAL))
_GLASS = wp.constant(int(_K.GLASS))


@wp.func
def note_seen_light(paths: Paths, path: int, before: wp.vec3):
    """Count as albedo what the path's light has grown by since it was `before`."""
    if not is_guided(paths.passes):
        return
    passes = paths.passes[0]
    carried = passes.carried[path]
    if has_light(carried):
        add_channels(passes, passes.albedo, path, wp.cw_mul(carried, paths.radiance[path] - before))


@wp.func
def note_volume(paths: Paths, path: int, weight: wp.vec3):
    """Note that a volume scattered the path; `weight`: what its throughput is multiplied by, in the mean over the
    places where it may scatter the albedo there times the share of light that scatters.
    """
    if not is_guided(paths.passes):
        return
    passes = paths.passes[0]
    carried = passes.carried[path]
    if has_light(carried):
        mean = (carried[0] + carried[1] + carried[2]) / 3.0
        add_channels(passes, passes.normal, path, wp.vec3(0.0, 0.0, mean * wp.static(TOWARDS_CAMERA)))
        add_channels(passes, passes.albedo, path, wp.cw_mul(carried, weight))
        passes.carried[path] = wp.vec3(0.0)


@functools.cache
def make_note_surface(features: ClosureFeatures) -> wp.Function:
    """Function (paths, path: int, view: ClosuresInView, tables: AlbedoTables, distance: float) that notes a surface,
    seen at the end of a ray of length `distance` [m].
    """
    has = features.has
    mean_alpha, reflectance = make_facets(features).alpha, make_lobes(features).reflectance
    # the light that goes below a surface has scattered there; that which a rough surface refracts has its colour
    is_facets, has_facets = features.test(MICROFACET_KINDS - {_K.SUBSURFACE}), has(*MICROFACET_KINDS - {_K.SUBSURFACE})
    is_clear = features.test((_K.GLASS, _K.REFRACTION))
    has_transparent, has_portal, has_glass = has(_K.TRANSPARENT), has(_K.RAY_PORTAL), has(_K.GLASS)
    own_normal = make_normals(features.own_normals)[1]

    @wp.func
    def note_surface(paths: Paths, path: int, view: ClosuresInView, tables: AlbedoTables, distance: float):
        if not is_guided(paths.passes):
            return
        passes = paths.passes[0]
        carried = passes.carried[path]
        if not has_light(carried):
            return
        mean = (carried[0] + carried[1] + carried[2]) / 3.0
        if passes.depth >= 0:
            passes.values[passes.depth, path] = passes.values[passes.depth, path] + mean * distance
        normal = wp.vec3(0.0)
        rough = wp.vec3(0.0)  # albedo of closures by what they count as
        smooth = wp.vec3(0.0)
        rough_share = float(0.0)
        share = float(0.0)
        for c in range(view.first, view.end):
            lobe = view.lobes[c - view.first]
            if lobe.selection > 0.0:
                is_rough = bool(True)
                color = lobe.scale
                if wp.static(has_transparent):
                    if view.closures[c].kind == _TRANSPARENT:
                        is_rough = False
                if wp.static(has_portal):
                    if view.closures[c].kind == _RAY_PORTAL:
                        is_rough = False
                if wp.static(has_facets):
                    if is_facets(view.closures[c].kind):
                        is_rough = mean_alpha(view.closures, c) > wp.static(ALPHA_SMOOTH)
                        if not is_clear(view.closures[c].kind):
                            color = wp.cw_mul(
                                color, reflectance(view.closures, c, tables, lobe.cosine, view.frame.entering)
                            )
                # as large as the closure's albedo, of the colour that it has here
                total = color[0] + color[1] + color[2]
                if total > 0.0 and total < wp.inf:
                    color = (lobe.selection / total) * color
                if wp.static(has_glass):
                    if view.closures[c].kind == _GLASS:  # it may tint what it lets through
                        f = reflectance(view.closures, c, tables, lobe.cosine, view.frame.entering)
                        color = wp.cw_mul(color, f + wp.cw_mul(wp.vec3(1.0) - f, view.closures[c].refraction))
                share += lobe.selection
                # facets are about a normal that is bent where it would mirror the view into the surface
                about = own_normal(view.closures, c, view.frame)
                if wp.static(has_facets):
                    if is_facets(view.closures[c].kind):
                        about = lobe.normal
                normal += lobe.selection * about
                if is_rough:
                    rough_share += lobe.selection
                    rough += color
                else:
                    smooth += color
        if share > 0.0 and 4.0 * rough_share <= share:
            passes.carried[path] = wp.cw_mul(carried, smooth)
            return
        if share > 0.0:
            add_channels(passes, passes.normal, path, passes.to_camera * ((mean / share) * normal))
            add_channels(passes, passes.albedo, path, wp.cw_mul(carried, rough))
        passes.carried[path] = wp.vec3(0.0)

    return note_surface
