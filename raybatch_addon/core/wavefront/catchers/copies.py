"""Facts that stages need about copies of paths, which see shadow catchers alone."""

from __future__ import annotations

import warp as wp

from ...shading.lights.emitters import CELL
from ...shading.lights.table import LightTable
from ..rays import Paths
from .state import Life

_WORLD, _COPY = int(Life.WORLD), int(Life.COPY)


@wp.func
def life_of(paths: Paths, path: int) -> int:
    """The `Life` of a path; 0 where there are no catchers, of which general kernels need not know."""
    if paths.passes.shape[0] > 0:
        if paths.passes[0].life.shape[0] > 0:
            return paths.passes[0].life[path]
    return 0


@wp.func
def is_copy(paths: Paths, path: int) -> bool:
    """Whether a path is a copy that sees shadow catchers alone."""
    return life_of(paths, path) >= wp.static(_COPY)


@wp.func
def is_once_more(paths: Paths, path: int) -> bool:
    """Whether a path that met a catcher is traced once more: with nothing in its way, or as a copy."""
    return life_of(paths, path) >= wp.static(_WORLD)


@wp.func
def receiver_of_copy(paths: Paths, path: int, receiver: int) -> int:
    """The light set by which light is chosen for a path at what is of the set `receiver`."""
    if is_copy(paths, path) and paths.passes[0].inputs.copy_receiver >= 0:
        return paths.passes[0].inputs.copy_receiver
    return receiver


@wp.func
def is_in_vacuum(paths: Paths, path: int, inside: wp.vec4i) -> bool:
    """Whether there is no volume for a path that is in those `inside` (`MediaState`): the world's is none for copies,
    and for rays that look at the world behind a catcher.
    """
    nowhere = inside[0] == 0 and inside[1] == 0 and inside[2] == 0 and inside[3] == 0
    return nowhere and is_once_more(paths, path)


@wp.func
def shines_on_copy(table: LightTable, paths: Paths, path: int, emitter: int) -> bool:
    """Whether light of `emitter` comes to a path: where that is a copy, of objects those that are catchers shine."""
    if emitter == table.world_emitter or not is_copy(paths, path):
        return True
    if emitter < table.light_count:
        if table.lights[emitter].kind != wp.static(CELL):
            return True
        return paths.passes[0].inputs.is_catcher[table.lights[emitter].sphere] != 0
    return paths.passes[0].inputs.is_catcher[table.triangle_instance[emitter - table.light_count]] != 0
