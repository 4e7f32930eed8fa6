"""Kernels that tests share where light that is aimed at and light that is met are not weighed by one another (`mis` at
OFF): no general kernels do without, and each scene would have its own.
"""

from __future__ import annotations

import dataclasses
import functools

from raybatch_addon.core.scene.description import ClosureKind, LightKind
from raybatch_addon.core.scene.features import SceneFeatures
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.wavefront.tier import lack_of

_REGISTERS, _CLOSURES = 32, 4
_PROGRAMS = ("programs", "world_program", "lamp_program", "volume_program", "request_program", "fetch_program")


def _programs(*ops: str) -> ProgramFeatures:
    return ProgramFeatures(tuple(sorted(("emission", *ops))), _REGISTERS, _CLOSURES)


@functools.cache
def unweighed_features(sample_sequence: str) -> SceneFeatures:
    """Features of the scenes that tests render so, together; those of independent samples have no programs."""
    shared = SceneFeatures(
        closures=(ClosureKind.DIFFUSE, ClosureKind.METAL, ClosureKind.EMISSION),
        closure_count=1,
        lights=(LightKind.POINT, LightKind.SUN, LightKind.RECTANGLE),
        light_sphere=True,
        light_hits=True,
        light_choice=True,
        mesh_lights=True,
        world=True,
        surfaces=True,
        instancing=True,
        sample_sequence=sample_sequence,
        mis=False,
    )
    if sample_sequence == "INDEPENDENT":
        return shared
    return dataclasses.replace(
        shared,
        programs=_programs("combine_xyz", "light_path", "math"),
        world_program=_programs("multiply_colors", "normals", "position", "sky_scattering"),
        lamp_program=_programs("parametric"),
        mesh_programs=True,
        world_light=True,
        light_portals=True,
        light_bounces=True,
    )


def can_be_unweighed(features: SceneFeatures) -> bool:
    """Whether kernels of `unweighed_features` can render a scene with `features`."""
    wide = unweighed_features(features.sample_sequence)
    own = [getattr(features, name) for name in _PROGRAMS]
    there = [getattr(wide, name) for name in _PROGRAMS]
    if any(lack_of(*each) or each[0].register_count > _REGISTERS for each in zip(own, there, strict=True)):
        return False
    if any(each.closure_count > _CLOSURES for each in own):
        return False
    names = {field.name for field in dataclasses.fields(features)} - {*_PROGRAMS, "nee"}
    return all(_is_within(name, getattr(features, name), getattr(wide, name)) for name in names)


def _is_within(name: str, own: object, there: object) -> bool:
    """Whether kernels for the feature `there` do for `own`: they have code for it, or it asks for none."""
    if isinstance(own, tuple) and isinstance(there, tuple):
        return set(own) <= set(there)
    leaves_out = name.startswith("caustics")  # there, what is off has code
    return own == there or (there is True and not leaves_out)
