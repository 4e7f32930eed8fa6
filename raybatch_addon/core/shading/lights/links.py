"""Light linking on the device: what an emitter lights, what blocks its light, and the group that it is in."""

from __future__ import annotations

import functools

import warp as wp

from ...scene.description import ALL_SHADOW_SETS, SHADOW_SET_SHIFT
from .choice import LitPoint
from .table import LightTable
from .visibility import is_lit_in_part


@wp.func
def receiver_of(table: LightTable, instance: int) -> int:
    """Number of the light set that `instance` is lit as, -1 for what fills the world; -1: no light is linked."""
    receiver = int(-1)
    if table.choice[0].links.receiver.shape[0] > 0:
        receiver = int(0)
        if instance >= 0:
            receiver = table.choice[0].links.receiver[instance]
    return receiver


@wp.func
def owner_of(table: LightTable, emitter: int) -> int:
    """Number among the owners of light (`LightLinks`) of an emitter."""
    if emitter < table.light_count:
        return emitter
    if emitter == table.world_emitter:
        return table.light_count + table.choice[0].links.instance_count
    return table.light_count + table.triangle_instance[emitter - table.light_count]


@wp.func
def owner_of_world(table: LightTable) -> int:
    """Number of the world among the owners of light."""
    return table.light_count + table.choice[0].links.instance_count


@wp.func
def is_linked(table: LightTable, owner: int, receiver: int) -> bool:
    """Whether what is of the light set `receiver` gets light of `owner`; -1: all light comes there."""
    if receiver < 0:
        return True
    return ((table.choice[0].links.lights[owner] >> wp.uint64(receiver)) & wp.uint64(1)) != wp.uint64(0)


@wp.func
def blocking_visibility(table: LightTable, owner: int) -> int:
    """Bits that the visibility of a shadow ray to `owner` has: those of the shadow sets that block it."""
    sets = int(wp.static(ALL_SHADOW_SETS))
    if table.choice[0].links.shadows.shape[0] > 0:
        sets = table.choice[0].links.shadows[owner]
    return sets << wp.static(SHADOW_SET_SHIFT)


@wp.func
def is_aimed_from(table: LightTable, emitter: int, bounce: int) -> bool:
    """Whether paths aim at `emitter` from their vertex `bounce`."""
    if table.choice[0].links.bounces.shape[0] == 0:
        return True
    place = emitter
    if emitter >= table.light_count:
        if emitter != table.world_emitter:
            return True
        place = table.light_count
    return bounce <= table.choice[0].links.bounces[place]


@wp.func
def group_of(table: LightTable, owner: int) -> int:
    """The number of the group of `owner` among the passes of groups; -1: it is in none."""
    group = int(-1)
    if table.choice[0].links.group.shape[0] > 0:
        group = table.choice[0].links.group[owner]
    return group


@wp.func
def _blocks_in_part(table: LightTable, owner: int) -> bool:
    if table.choice[0].links.shadows.shape[0] == 0:
        return False
    return table.choice[0].links.shadows[owner] != wp.static(ALL_SHADOW_SETS)


@functools.cache
def make_found_by_sampling(shadow_links: bool) -> wp.Function:
    """Function (table, owner: int, visibility: int) -> bool: whether light sampling alone finds the light of `owner`,
    as far as it can: some kinds of scattered rays alone see it, or some objects alone block it, of which scattered rays
    know nothing.
    """

    @wp.func
    def found_by_sampling(table: LightTable, owner: int, visibility: int) -> bool:
        alone = is_lit_in_part(visibility)
        if wp.static(shadow_links):
            alone = alone or _blocks_in_part(table, owner)
        return alone

    return found_by_sampling


@functools.cache
def make_counts(light_links: bool, light_groups: bool) -> wp.Function:
    """Function (table, owner: int, point: LitPoint) -> bool: whether light of `owner` that a ray from `point` meets
    counts.
    """

    @wp.func
    def counts(table: LightTable, owner: int, point: LitPoint) -> bool:
        there = bool(True)
        if wp.static(light_links):
            there = is_linked(table, owner, point.receiver)
        if wp.static(light_groups):
            there = there and (point.group < 0 or group_of(table, owner) == point.group)
        return there

    return counts
