"""Meshes of an animation with Persistent Data: those that Blender did not evaluate anew are not read again.

Blender keeps the evaluated scene from frame to frame then, and reports what it evaluated. The report is lost where
nobody was there to hear it, as when a render is stopped between two frames; so all is read anew when a render begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..live.edits import updates_of
from .kept_meshes import end_export
from .live_meshes import LiveMeshes

_job = 0
_last: tuple[int, LiveMeshes] | None = None  # the address of an evaluated scene, and the meshes that it had last


def begin_frame(job: int) -> None:
    """A frame of the render `job`, a number, is to be read."""
    global _job, _last
    if job != _job:
        _job, _last = job, None


@contextmanager
def known_meshes(depsgraph: bpy.types.Depsgraph, moving: bool) -> Iterator[LiveMeshes | None]:
    """Meshes of the frame before, for a pass over `depsgraph`; None where they may have changed unheard: without
    Persistent Data, and where (`moving`) frames are stepped through.
    """
    global _last
    address, meshes = depsgraph.as_pointer(), None
    before, _last = _last, None  # a pass that does not come to its end leaves nothing
    if depsgraph.mode == "RENDER" and depsgraph.scene.render.use_persistent_data and not moving:
        meshes = before[1] if before is not None and before[0] == address else LiveMeshes()
        meshes.begin({each.uid for each in updates_of(depsgraph) if each.geometry})
        meshes.materials.forget()  # they are found again by their graphs
    try:
        yield meshes
        if meshes is not None:
            meshes.end(is_whole=True)
            _last = address, meshes
    finally:
        end_export()
