"""Parts of a scene that a render would lack, reported before the render; and renders that are refused for them."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import bpy

from ..core.errors import RayBatchError
from ..core.scene.notice import Notice, Weight, by_weight
from ..export.asked import asked
from . import exit_code

# By names of a scene and a view layer: of the last look, or the last render
_found: dict[str, dict[str, list[Notice]]] = {}
# What was written to standard error, and in which of Blender's renders
_printed: set[Notice] = set()
_job = 0


class Refused(RayBatchError):
    """A render that would lack what it may not lack."""


def found_in(scene: bpy.types.Scene) -> list[Notice] | None:
    """What the last look at `scene` found, the weightiest first; None where nobody has looked."""
    layers = _found.get(scene.name)
    return None if layers is None else by_weight(dict.fromkeys(each for found in layers.values() for each in found))


def keep_found(scene: bpy.types.Scene, layer: str, messages: Sequence[str]) -> list[Notice]:
    """Remember what was found in a view layer of `scene`, for the panel."""
    found = _found.setdefault(scene.name, {})[layer] = by_weight(messages)
    return found


def begin_look(scene: bpy.types.Scene) -> None:
    """Forget what was found in `scene` before."""
    _found.pop(scene.name, None)


@bpy.app.handlers.persistent
def forget_found(*_) -> None:
    """Forget what was found: in another file, scenes of the same names are others."""
    _found.clear()


def strictness(scene: bpy.types.Scene) -> Weight | None:
    """The weight from which on nothing may be missing; None: everything may. Raises `SettingsError`."""
    strict = asked().strict
    if strict is not None:
        return strict
    own = getattr(getattr(scene, "raybatch_export", None), "strict", "OFF")
    return None if own == "OFF" else Weight[own]


def refuse_what_lacks(scene: bpy.types.Scene, notices: Sequence[Notice]) -> None:
    """Raise `Refused` if something among `notices` may not be missing."""
    least = strictness(scene)
    if least is None:
        return
    heavy = [notice for notice in notices if notice.weight >= least]
    if not heavy:
        return
    if asked().strict is not None and bpy.app.background:
        exit_code.end_with(exit_code.REFUSED)
    more = f"; and {len(heavy) - 1} more" if len(heavy) > 1 else ""
    raise Refused(f"not rendered, as nothing may be missing: {heavy[0]}{more}")


def print_new_notices(notices: Sequence[Notice], job: int) -> None:
    """Write those of `notices` to standard error that were not written before in Blender's render number `job`: the
    frames of an animation mostly lack the same.
    """
    global _job
    if job != _job:
        _job = job
        _printed.clear()
    print_notices([notice for notice in notices if notice not in _printed])
    _printed.update(notices)


def print_notices(notices: Sequence[Notice], start: str = "RayBatch: warning") -> None:
    """Write `notices` to standard error, each in a line, with what to do."""
    for notice in notices:
        to_do = notice.to_do("-- --raybatch-")
        remedy = f" ({to_do})" if to_do else ""
        print(f"{start}: {notice}{remedy}", file=sys.stderr)
