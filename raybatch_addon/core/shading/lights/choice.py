"""Choice of the emitter that light sampling aims at, as seen from the point that is lit.

Emitters compete by how much light they may bring: an estimate of the irradiance at the point from their power, distance
and direction, and from how they and the surface are turned. Suns, the world and the topmost nodes of a tree over all
other emitters are compared one by one; below such a node a path leads down the tree to one emitter (Conty Estevez and
Kulla 2018, "Importance sampling of many lights with adaptive tree splitting"). A scene with few lights has no node that
holds more than one, so its lights are compared exactly.

What is estimated is light without shadows, and the brightest emitter may be hidden from the point: then the others are
all there is, and where they are seldom chosen the picture is noisy. So at the top each group of emitters that are near
each other, and each distant one, is chosen more often than its share where that is small.

One random number makes all decisions: after each, the part that it left is stretched to [0, 1). What a float32 has too
few digits for is filled up by a hash.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import warp as wp

from ...native.build import native_source
from ...scene.description import LightKind
from .choice_table import BLOCK_WIDTH, FIELDS
from .emitters import COSINE_ERROR
from .table import LightTable

# What an emitter counts for at least where the surface, or the emitter, is turned away at the angle where nothing
# arrives by Lambert's law: BSDFs and lamps may differ from it
_COSINE_MIN = 0.1
# Where the light of a node of the tree comes from, about: the mean square of its emitters' distances from the middle of
# its sphere, over the square of the radius; and how much of a cosine is not told by that middle from within the sphere
_SPREAD, _INSIDE = 0.25, 0.3
# What counts beside a group's own light, as a part of that of all, shared by all groups but one. Choosing by
# sqrt(l (l + h)) loses little where all light is seen: 4 % where two bring 0.95 and 0.05 of it. Of eight files three
# had 0.55 to 0.73 of the variance, five 0.99 to 1.07; with 0.6 and 1.2, or by sqrt(l) alone, a little less in the three
# and up to 1.14 in the five (all before the part was shared: with few groups that changes little).
_HIDDEN = 0.3
# Where emitters are compared, none is without a chance: counts stay within these bounds
_LEAST, _MOST = 1e-30, 1e30
_DRAWS = 2**24  # what a random number can be
_KEPT = 4  # distant emitters that are estimated once a choice
_SIDE_STEPS = wp.constant(32767.0)
# In place of `packed_side` for a point in a volume, which light reaches from all sides alike
VOLUME_SIDE = 1 << 31


@wp.struct
class LitPoint:
    """Where light is looked for."""

    position: wp.vec3  # [m]
    normal: wp.vec3  # unit, of the shading
    both_sides: int  # 1: light from behind counts too
    receiver: int  # the light set of what is lit, where light is linked; -1: it is seen by all light
    group: int  # of lights that rays meet: -1: all count, else those of this group alone
    bounce: int  # of the path's vertex, where lights are aimed at from some alone


@wp.struct
class ChosenEmitter:
    """An emitter, and the probability with which it is chosen; -1 and 0: none brings light."""

    emitter: int
    pdf: float


class LightChoice(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    # (table, point: LitPoint, u_choice: float, u: vec2) -> ChosenEmitter
    choose: wp.Function
    # (table, point: LitPoint, emitter: int) -> float: the probability with which `choose` finds `emitter`
    pdf: wp.Function


@wp.func
def packed_side(normal: wp.vec3, both_sides: bool) -> wp.uint32:
    """A surface's unit normal and whether it is lit from both sides, in 32 bits: an octahedral map (Cigolle et al.
    2014, "A survey of efficient representations for independent unit vectors").
    """
    length = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
    x = float(0.0)
    y = float(0.0)
    if length > 0.0:  # not where it is no number
        x = normal[0] / length
        y = normal[1] / length
    if normal[2] < 0.0:
        folded = (1.0 - wp.abs(y)) * wp.where(x < 0.0, -1.0, 1.0)
        y = (1.0 - wp.abs(x)) * wp.where(y < 0.0, -1.0, 1.0)
        x = folded
    column = wp.uint32(wp.clamp(0.5 + 0.5 * x, 0.0, 1.0) * _SIDE_STEPS + 0.5)
    row = wp.uint32(wp.clamp(0.5 + 0.5 * y, 0.0, 1.0) * _SIDE_STEPS + 0.5)
    bits = (column & wp.uint32(32767)) | ((row & wp.uint32(32767)) << wp.uint32(15))
    if both_sides:
        bits = bits | wp.uint32(1 << 30)
    return bits


@wp.func
def lit_point(position: wp.vec3, side: wp.uint32) -> LitPoint:
    """The point at `position`, whose surface `packed_side` describes; its normal is 0 where that is VOLUME_SIDE."""
    point = LitPoint()
    point.position = position
    x = float(side & wp.uint32(32767)) / _SIDE_STEPS * 2.0 - 1.0
    y = float((side >> wp.uint32(15)) & wp.uint32(32767)) / _SIDE_STEPS * 2.0 - 1.0
    z = 1.0 - wp.abs(x) - wp.abs(y)
    fold = wp.max(-z, 0.0)
    x = x - wp.where(x < 0.0, -fold, fold)
    y = y - wp.where(y < 0.0, -fold, fold)
    point.normal = wp.normalize(wp.vec3(x, y, z)) * float(wp.uint32(1) - (side >> wp.uint32(31)))
    point.both_sides = int((side >> wp.uint32(30)) & wp.uint32(1))
    point.receiver = -1
    point.group = -1
    return point


@wp.func
def _choose_only(table: LightTable, point: LitPoint, u_choice: float, u: wp.vec2) -> ChosenEmitter:
    choice = ChosenEmitter()
    choice.emitter = -1
    if table.emitter_count > 0:
        choice.emitter = 0
        choice.pdf = 1.0
    return choice


@wp.func
def _only_pdf(table: LightTable, point: LitPoint, emitter: int) -> float:
    return 1.0


@dataclass(frozen=True)
class ChoiceFeatures:
    """Features that the choice is specialised on; the fields are those of `SceneFeatures`."""

    lights: tuple[LightKind, ...]
    light_choice: bool
    mesh_lights: bool
    world_light: bool
    light_links: bool = False
    volume_lights: bool = False


def make_light_choice(features: ChoiceFeatures) -> LightChoice:
    """The `LightChoice` for scenes with these kinds of emitters."""
    lights = features.lights
    if not features.light_choice:
        return LightChoice(_choose_only, _only_pdf)
    local = features.mesh_lights or features.volume_lights or any(kind != LightKind.SUN for kind in lights)
    directed = features.mesh_lights or any(kind not in (LightKind.SUN, LightKind.POINT) for kind in lights)
    return _make_choice(LightKind.SUN in lights, features.world_light, local, directed, features.light_links)


@functools.cache
def _make_choice(has_suns: bool, has_world: bool, local: bool, directed: bool, linked: bool) -> LightChoice:
    """`local`: there are emitters with a place; `directed`: some of them shine to one side more than to others;
    `linked`: some light some objects alone.
    """
    numbers = dict(
        COSINE_MIN=_COSINE_MIN,
        SPREAD=_SPREAD,
        INSIDE=_INSIDE,
        COSINE_ERROR=COSINE_ERROR,
        HIDDEN=_HIDDEN,
        LEAST=_LEAST,
        MOST=_MOST,
        UNIT=1 / _DRAWS,
    )
    kinds = dict(SUNS=has_suns, WORLD=has_world, LOCAL=local, DIRECTED=directed, LINKS=linked)
    sizes = dict(FIELDS=len(FIELDS), WIDTH=BLOCK_WIDTH, DRAWS=_DRAWS, KEPT=_KEPT)
    fields = {f"FIELD_{name.upper()}": place for place, name in enumerate(FIELDS)}
    defines = {**numbers, **kinds, **sizes, **fields}

    @wp.func_native(native_source("lights/candidates.h", "lights/choose.h", **defines))
    def choose_by(table: LightTable, point: LitPoint, bits: wp.uint32, seed: wp.uint32) -> wp.vec2i: ...

    @wp.func_native(native_source("lights/candidates.h", "lights/probability.h", **defines))
    def pdf(table: LightTable, point: LitPoint, emitter: int) -> float: ...

    @wp.func
    def choose(table: LightTable, point: LitPoint, u_choice: float, u: wp.vec2) -> ChosenEmitter:
        bits = wp.uint32(u_choice * wp.static(2.0**24)) << wp.uint32(8)
        # the point on the emitter seeds the digits that the choice among very many lacks
        seed = bits ^ (wp.uint32(u[0] * wp.static(2.0**24)) * wp.uint32(2654435769))
        seed = seed ^ (wp.uint32(u[1] * wp.static(2.0**24)) * wp.uint32(2246822519))
        found = choose_by(table, point, bits, seed)
        choice = ChosenEmitter()
        choice.emitter = found[0]
        choice.pdf = wp.cast(found[1], float)
        return choice

    return LightChoice(choose, pdf)
