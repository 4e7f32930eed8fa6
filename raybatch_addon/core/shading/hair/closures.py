"""Closures of hair among others: the functions of a material, with hair looked at, evaluated and sampled too.

Functions for materials without hair are not touched. Hair scatters to all sides of a fibre, so no side is barred.
"""

from __future__ import annotations

import warp as wp

from ...scene.description import ClosureKind
from ..bsdf.albedo import AlbedoTables
from ..bsdf.lobes import Lobe, pick_lobe
from ..bsdf.materials import (
    GLOSSY,
    HAIR_KINDS,
    TRANSMISSION,
    Bsdf,
    BsdfSample,
    ClosureFeatures,
    ClosureRecord,
    ShadingFrame,
)
from ..bsdf.mixture import Mixture
from .chiang import HairDirection, cylinder_albedo, cylinder_of, principled_hair_value, sample_principled_hair
from .huang import facet_hair_value, fibre_albedo, fibre_of, sample_facet_hair
from .lobes import hair_lobe_value, sample_hair_lobe

_TRANSMISSION = wp.constant(int(ClosureKind.HAIR_TRANSMISSION))
_PRINCIPLED = wp.constant(int(ClosureKind.PRINCIPLED_HAIR))
_FACETS = wp.constant(int(ClosureKind.FACET_HAIR))


def with_hair(bsdf: Bsdf, features: ClosureFeatures) -> Bsdf:
    """`bsdf` for materials that may have closures of hair; itself where `features` has none."""
    if not features.has(*HAIR_KINDS):
        return bsdf
    is_hair = features.test(HAIR_KINDS)
    has_lobes = features.has(ClosureKind.HAIR_REFLECTION, ClosureKind.HAIR_TRANSMISSION)
    has_principled = features.has(ClosureKind.PRINCIPLED_HAIR)
    has_facets = features.has(ClosureKind.FACET_HAIR)
    look_other, propose_other, mix_other, scatters_other = bsdf.look, bsdf.propose, bsdf.mix, bsdf.scatters

    @wp.func
    def look(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        lobes: wp.array(dtype=Lobe),
    ):
        look_other(closures, first, end, albedo, frame, wo, lobes)
        for c in range(first, end):
            if is_hair(closures[c].kind):
                weight = closures[c].weight
                lobe = lobes[c - first]
                lobe.scale = weight
                seen = weight
                if wp.static(has_principled):
                    if closures[c].kind == _PRINCIPLED:
                        seen = wp.cw_mul(weight, cylinder_albedo(cylinder_of(closures, c, frame, wo)))
                if wp.static(has_facets):
                    if closures[c].kind == _FACETS:
                        seen = weight * fibre_albedo(fibre_of(closures, c, albedo, frame, wo))
                lobe.selection = seen[0] + seen[1] + seen[2]
                lobes[c - first] = lobe

    @wp.func
    def propose(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        u_lobe: float,
        u: wp.vec2,
    ) -> BsdfSample:
        # the same choice as that of the others, which is made again where it falls on one of them
        picked = pick_lobe(lobes, end - first, u_lobe)
        chosen = int(first + picked.offset)
        if picked.offset >= 0 and is_hair(closures[chosen].kind):
            found = HairDirection()
            rest = picked.rest
            if wp.static(has_principled):
                if closures[chosen].kind == _PRINCIPLED:
                    found = sample_principled_hair(
                        closures, chosen, cylinder_of(closures, chosen, frame, wo), picked.rest, u
                    )
            if wp.static(has_facets):
                if closures[chosen].kind == _FACETS:
                    found = sample_facet_hair(fibre_of(closures, chosen, albedo, frame, wo), rest, u)
            if wp.static(has_lobes):
                if closures[chosen].kind < _PRINCIPLED:
                    found = sample_hair_lobe(closures, chosen, frame, wo, u, closures[chosen].kind == _TRANSMISSION)
            result = BsdfSample()
            result.direction = found.direction
            if wp.dot(found.direction, found.direction) > 0.0:  # else it was lost between facets
                result.lobe = wp.where(found.passes == 1, TRANSMISSION, GLOSSY)
            return result
        return propose_other(closures, first, end, lobes, albedo, frame, wo, u_lobe, u)

    @wp.func
    def mix(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        wi: wp.vec3,
    ) -> Mixture:
        mixture = mix_other(closures, first, end, lobes, albedo, frame, wo, wi)
        for c in range(first, end):
            if is_hair(closures[c].kind):
                lobe = lobes[c - first]
                if wp.static(has_principled):
                    if closures[c].kind == _PRINCIPLED:
                        both = principled_hair_value(closures, c, cylinder_of(closures, c, frame, wo), wi)
                        mixture.value += wp.cw_mul(lobe.scale, wp.vec3(both[0], both[1], both[2]))
                        mixture.density += lobe.selection * both[3]
                if wp.static(has_facets):
                    if closures[c].kind == _FACETS:
                        both = facet_hair_value(closures, c, fibre_of(closures, c, albedo, frame, wo), wi)
                        mixture.value += wp.cw_mul(lobe.scale, wp.vec3(both[0], both[1], both[2]))
                        mixture.density += lobe.selection * both[3]
                if wp.static(has_lobes):
                    if closures[c].kind < _PRINCIPLED:
                        bright = hair_lobe_value(closures, c, frame, wo, wi, closures[c].kind == _TRANSMISSION)
                        mixture.value += bright * lobe.scale
                        mixture.density += lobe.selection * bright
        return mixture

    @wp.func
    def scatters(closures: wp.array(dtype=ClosureRecord), first: int, end: int) -> bool:
        found = scatters_other(closures, first, end)
        for c in range(first, end):
            if is_hair(closures[c].kind):
                found = True
        return found

    return bsdf._replace(look=look, propose=propose, mix=mix, scatters=scatters)
