"""Choice of the emitter that light sampling aims at, as seen from the point that is lit.

Emitters compete by how much light they may bring: an estimate of the irradiance at the point from their power, distance
and direction, and from how they and the surface are turned. Suns, the world and the topmost nodes of a tree over all
other emitters are compared one by one; below such a node a path leads down the tree to one emitter (Conty Estevez and
Kulla 2018, "Importance sampling of many lights with adaptive tree splitting"). A scene with few lights has no node that
holds more than one, so its lights are compared exactly.

One random number makes all decisions: after each, the part that it left is stretched to [0, 1). What a float32 has too
few digits for is filled up by a hash.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import warp as wp

from ...scene.description import LightKind
from .choice_table import LightNode
from .light_table import LightTable

# What an emitter counts for at least where the surface, or the emitter, is turned away at the angle where nothing
# arrives by Lambert's law: BSDFs and lamps may differ from it
_COSINE_MIN = wp.constant(0.1)
# Rounding of cosines that come from sines: emitters are left out only where they surely are dark
_COSINE_ERROR = wp.constant(1.0e-3)
# Where emitters are compared, none is without a chance: counts stay within these bounds
_LEAST = wp.constant(1.0e-30)
_MOST = wp.constant(1.0e30)
_UNIT = wp.constant(2.0**-24)
# The hash fills up digits when fewer than this are left
_COARSE = wp.constant(2.0**-20)
_SIDE_STEPS = wp.constant(32767.0)


@wp.struct
class LitPoint:
    """Where light is looked for."""

    position: wp.vec3  # [m]
    normal: wp.vec3  # unit, of the shading
    both_sides: int  # 1: light from behind counts too


@wp.struct
class ChosenEmitter:
    """An emitter, and the probability with which it is chosen; -1 and 0: none brings light."""

    emitter: int
    pdf: float


@wp.struct
class Draw:
    """What is left of a random number."""

    u: float  # [0, 1)
    step: float  # distance between neighbouring values of `u`
    state: wp.uint32  # of the hash


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
    sum = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
    x = normal[0] / sum
    y = normal[1] / sum
    if normal[2] < 0.0:
        folded = (1.0 - wp.abs(y)) * wp.where(x < 0.0, -1.0, 1.0)
        y = (1.0 - wp.abs(x)) * wp.where(y < 0.0, -1.0, 1.0)
        x = folded
    column = wp.uint32(wp.clamp(0.5 + 0.5 * x, 0.0, 1.0) * _SIDE_STEPS + 0.5)
    row = wp.uint32(wp.clamp(0.5 + 0.5 * y, 0.0, 1.0) * _SIDE_STEPS + 0.5)
    bits = column | (row << wp.uint32(15))
    if both_sides:
        bits = bits | wp.uint32(1 << 30)
    return bits


@wp.func
def lit_point(position: wp.vec3, side: wp.uint32) -> LitPoint:
    """The point at `position`, whose surface `packed_side` describes."""
    point = LitPoint()
    point.position = position
    x = float(side & wp.uint32(32767)) / _SIDE_STEPS * 2.0 - 1.0
    y = float((side >> wp.uint32(15)) & wp.uint32(32767)) / _SIDE_STEPS * 2.0 - 1.0
    z = 1.0 - wp.abs(x) - wp.abs(y)
    fold = wp.max(-z, 0.0)
    x = x - wp.where(x < 0.0, -fold, fold)
    y = y - wp.where(y < 0.0, -fold, fold)
    point.normal = wp.normalize(wp.vec3(x, y, z))
    point.both_sides = int(side >> wp.uint32(30))
    return point


@wp.func
def choice_bits(u_choice: float, u: wp.vec2) -> wp.uint32:
    """32 random bits: the 24 of `u_choice`, and the last 8 of the 24 of `u[1]`.

    The bits that are used twice move a point on its emitter by at most 2^-16 of its width.
    """
    high = wp.uint32(u_choice * wp.static(2.0**24))
    low = wp.uint32(u[1] * wp.static(2.0**24))
    return (high << wp.uint32(8)) | (low & wp.uint32(255))


@wp.func
def _stretched(draw: Draw, first: float, width: float) -> Draw:
    """`draw`, which lies in [first, first + width), stretched to [0, 1)."""
    draw.u = (draw.u - first) / width
    draw.step = draw.step / width
    if draw.step > _COARSE:
        draw.state = draw.state * wp.uint32(747796405) + wp.uint32(2891336453)
        word = ((draw.state >> ((draw.state >> wp.uint32(28)) + wp.uint32(4))) ^ draw.state) * wp.uint32(277803737)
        draw.u = draw.u + wp.min(draw.step, 1.0) * (float(word >> wp.uint32(8)) * _UNIT)
        draw.step = _UNIT
    draw.u = wp.clamp(draw.u, 0.0, 1.0 - _UNIT)
    return draw


@wp.func
def _share(value: float, total: float) -> float:
    """The probability of what counts `value` > 0 of `total`, more than that: a number that a draw meets exactly."""
    return wp.clamp(wp.ceil(value / total * wp.static(2.0**24)) * _UNIT, _UNIT, 1.0 - _UNIT)


@wp.func
def _cosine_beyond(cos_a: float, cos_b: float) -> float:
    """cos(max(a - b, 0)) of angles within [0, pi]."""
    if cos_a >= cos_b:
        return 1.0
    return cos_a * cos_b + wp.sqrt(wp.max((1.0 - cos_a * cos_a) * (1.0 - cos_b * cos_b), 0.0))


@wp.func
def node_light(node: LightNode, point: LitPoint) -> float:
    """Estimate of the light that comes from below `node`; 0: surely none."""
    if node.power <= 0.0:
        return 0.0
    to = node.centre - point.position
    square = wp.dot(to, to)
    reach = node.radius * node.radius
    turned = float(1.0)
    if square > reach:
        distance = wp.sqrt(square)
        sine = wp.min(node.radius / distance, 1.0)
        # of the angle under which the node's sphere is seen
        cosine = wp.sqrt(1.0 - sine * sine)
        if node.cos_axis > -1.0:
            leaving = -wp.dot(node.axis, to) / distance
            if node.two_sided != 0:
                leaving = wp.abs(leaving)
            leaving = _cosine_beyond(wp.clamp(leaving, -1.0, 1.0), node.cos_axis)
            leaving = _cosine_beyond(leaving, cosine)
            if leaving < node.cos_edge - _COSINE_ERROR:
                return 0.0
            turned = wp.max(leaving, _COSINE_MIN)
        arriving = wp.dot(point.normal, to) / distance
        if point.both_sides != 0:
            arriving = wp.abs(arriving)
        turned = turned * wp.max(_cosine_beyond(wp.clamp(arriving, -1.0, 1.0), cosine), _COSINE_MIN)
    return wp.clamp(node.power * turned / wp.max(square, reach), _LEAST, _MOST)


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
    """What the choice is specialised on; the fields are those of `SceneFeatures`."""

    lights: tuple[LightKind, ...]
    light_choice: bool
    mesh_lights: bool
    world_light: bool


def make_light_choice(features: ChoiceFeatures) -> LightChoice:
    """The `LightChoice` for scenes with these kinds of emitters."""
    lights = features.lights
    if not features.light_choice:
        return LightChoice(_choose_only, _only_pdf)
    local = features.mesh_lights or any(kind != LightKind.SUN for kind in lights)
    return _make_choice(LightKind.SUN in lights, features.world_light, local)


@functools.cache
def _make_choice(has_suns: bool, has_world: bool, local: bool) -> LightChoice:
    """`local`: there are emitters with a place."""

    @wp.func
    def sun_light(table: LightTable, emitter: int, strength: float, point: LitPoint) -> float:
        cosine = -wp.dot(table.lights[emitter].axis, point.normal)
        if point.both_sides != 0:
            cosine = wp.abs(cosine)
        return wp.clamp(strength * wp.max(cosine, _COSINE_MIN), _LEAST, _MOST)

    @wp.func
    def world_light(table: LightTable, point: LitPoint) -> float:
        """Irradiance from the world, by its spherical harmonics (Ramamoorthi and Hanrahan 2001)."""
        e = table.choice.world_irradiance
        n = point.normal
        even = e[0] + e[4] * n[0] * n[1] + e[5] * n[1] * n[2] + e[6] * (3.0 * n[2] * n[2] - 1.0)
        even = even + e[7] * n[0] * n[2] + e[8] * (n[0] * n[0] - n[1] * n[1])
        odd = e[1] * n[1] + e[2] * n[2] + e[3] * n[0]
        light = even + odd
        if point.both_sides != 0:
            light = even + wp.abs(odd)
        return wp.clamp(wp.max(light, _COSINE_MIN * e[0]), _LEAST, _MOST)

    @wp.func
    def candidate_light(table: LightTable, candidate: int, point: LitPoint) -> float:
        """Estimate of the light from one of those that are compared one by one: roots, then suns and the world."""
        if wp.static(local):
            if candidate < table.choice.root_count:
                return node_light(table.choice.nodes[table.choice.roots[candidate]], point)
        if wp.static(has_suns or has_world):
            distant = candidate - table.choice.root_count
            emitter = table.choice.distant[distant]
            if wp.static(has_suns):
                if emitter < table.light_count:
                    return sun_light(table, emitter, table.choice.distant_strength[distant], point)
            if wp.static(has_world):
                return world_light(table, point)
        return 0.0

    @wp.func
    def choose(table: LightTable, point: LitPoint, u_choice: float, u: wp.vec2) -> ChosenEmitter:
        choice = ChosenEmitter()
        choice.emitter = -1
        bits = choice_bits(u_choice, u)
        draw = Draw()
        draw.u = wp.min(float(bits) * wp.static(2.0**-32), 1.0 - _UNIT)
        draw.step = wp.static(2.0**-32)
        draw.state = bits
        # each candidate takes the place of the one before with its share of the light so far
        total = float(0.0)
        chosen = int(-1)
        for candidate in range(table.choice.root_count + table.choice.distant_count):
            light = candidate_light(table, candidate, point)
            if light > 0.0:
                if chosen < 0:
                    chosen = candidate
                    choice.pdf = 1.0
                    total = light
                else:
                    total += light
                    share = _share(light, total)
                    if draw.u < share:
                        chosen = candidate
                        choice.pdf = share
                        draw = _stretched(draw, 0.0, share)
                    else:
                        choice.pdf = choice.pdf * (1.0 - share)
                        draw = _stretched(draw, share, 1.0 - share)
        if chosen < 0:
            return choice
        if chosen >= table.choice.root_count:
            choice.emitter = table.choice.distant[chosen - table.choice.root_count]
            return choice
        if wp.static(local):
            node = table.choice.nodes[table.choice.roots[chosen]]
            while node.first >= 0:
                first = table.choice.nodes[node.first]
                second = table.choice.nodes[node.second]
                light = node_light(first, point)
                other = node_light(second, point)
                if light + other <= 0.0:
                    choice.pdf = 0.0
                    return choice
                if other <= 0.0:
                    node = first
                elif light <= 0.0:
                    node = second
                else:
                    share = _share(light, light + other)
                    if draw.u < share:
                        node = first
                        choice.pdf = choice.pdf * share
                        draw = _stretched(draw, 0.0, share)
                    else:
                        node = second
                        choice.pdf = choice.pdf * (1.0 - share)
                        draw = _stretched(draw, share, 1.0 - share)
            choice.emitter = node.emitter
        return choice

    @wp.func
    def pdf(table: LightTable, point: LitPoint, emitter: int) -> float:
        wanted = int(-1)
        below = float(1.0)
        if wp.static(local):
            at = table.choice.leaf[emitter]
            if at >= 0:
                while table.choice.nodes[at].root < 0:
                    parent = table.choice.nodes[at].parent
                    first = table.choice.nodes[parent].first
                    light = node_light(table.choice.nodes[first], point)
                    other = node_light(table.choice.nodes[table.choice.nodes[parent].second], point)
                    own = wp.where(at == first, light, other)
                    if own <= 0.0:
                        return 0.0
                    if light > 0.0 and other > 0.0:
                        share = _share(light, light + other)
                        below = below * wp.where(at == first, share, 1.0 - share)
                    at = parent
                wanted = table.choice.nodes[at].root
        total = float(0.0)
        found = float(0.0)
        for candidate in range(table.choice.root_count + table.choice.distant_count):
            light = candidate_light(table, candidate, point)
            is_wanted = candidate == wanted
            if wp.static(has_suns or has_world):
                if candidate >= table.choice.root_count:
                    is_wanted = table.choice.distant[candidate - table.choice.root_count] == emitter
            if light > 0.0:
                if total == 0.0:
                    found = wp.where(is_wanted, 1.0, 0.0)
                    total = light
                else:
                    total += light
                    share = _share(light, total)
                    found = wp.where(is_wanted, share, found * (1.0 - share))
        return below * found

    return LightChoice(choose, pdf)
