"""Sampling of a world through portals: rectangles and ellipses by which light comes into a room.

Where some portals face a point, half of the directions to the world go through one of these, uniformly by solid angle
(of a rectangle), the others are chosen by the brightness of the world; densities are those of both together. A world
that is the same everywhere has a table of one texel. There no direction is chosen by brightness: scattered rays find
the light that comes by other ways as well by themselves.
"""

import warp as wp

from ....float32 import ONE_BELOW
from ....scene.description import LightKind
from ..area_shapes import meet_area_light, sample_area_light
from ..shapes import LightSample
from ..table import LightRecord, LightTable
from ..world import WorldDirection, sample_world, world_pdf

_ELLIPSE = wp.constant(int(LightKind.ELLIPSE))


@wp.func
def has_portals(table: LightTable) -> bool:
    """Whether the world is sampled through portals."""
    return table.lights.shape[0] > table.light_count


@wp.func
def _faces(portal: LightRecord, position: wp.vec3) -> bool:
    return wp.dot(position - portal.position, portal.axis) > 0.0


@wp.func
def _facing_count(table: LightTable, position: wp.vec3) -> int:
    count = int(0)
    for i in range(table.light_count, table.lights.shape[0]):
        if _faces(table.lights[i], position):
            count += 1
    return count


@wp.func
def _world_share(table: LightTable, facing: int) -> float:
    """Share of the directions that are chosen by brightness."""
    if table.world.width * table.world.height == 1:
        return 0.0
    return wp.where(facing > 0, 0.5, 1.0)


@wp.func
def portals_pdf(table: LightTable, position: wp.vec3, direction: wp.vec3) -> float:
    """Density with which `sample_through_portals` chooses `direction` at `position` [1/sr]."""
    facing = _facing_count(table, position)
    share = _world_share(table, facing)
    through = float(0.0)
    if facing > 0:
        for i in range(table.light_count, table.lights.shape[0]):
            portal = table.lights[i]
            if _faces(portal, position):
                met = meet_area_light(portal, position, direction, wp.where(portal.kind == _ELLIPSE, 1, 0))
                through += met.pdf / float(facing)
    density = (1.0 - share) * through
    if share > 0.0:
        density += share * world_pdf(table.world, direction)
    return density


@wp.func
def _sample_portal(table: LightTable, position: wp.vec3, facing: int, u: wp.vec2) -> LightSample:
    """A direction through one of the portals that face `position`; all are as likely."""
    stretched = u[0] * float(facing)
    number = wp.min(int(stretched), facing - 1)
    left = wp.vec2(wp.min(stretched - float(number), ONE_BELOW), u[1])
    sample = LightSample()
    for i in range(table.light_count, table.lights.shape[0]):
        portal = table.lights[i]
        if _faces(portal, position):
            if number == 0:
                sample = sample_area_light(portal, position, left, wp.where(portal.kind == _ELLIPSE, 1, 0))
            number -= 1
    return sample


@wp.func
def sample_through_portals(table: LightTable, position: wp.vec3, u: wp.vec2) -> WorldDirection:
    """A direction into the world, as seen from `position`; its density is 0 where none was found."""
    result = WorldDirection()
    facing = _facing_count(table, position)
    share = _world_share(table, facing)
    if u[0] < share:
        result = sample_world(table.world, wp.vec2(wp.min(u[0] / share, ONE_BELOW), u[1]))
    elif facing > 0:
        left = wp.vec2(wp.min((u[0] - share) / (1.0 - share), ONE_BELOW), u[1])
        found = _sample_portal(table, position, facing, left)
        result.direction = found.direction
        result.pdf = found.pdf
    if result.pdf > 0.0:
        result.pdf = portals_pdf(table, position, result.direction)
    return result
