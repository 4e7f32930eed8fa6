"""A viewport's scene from edit to edit, read in slices that each fit into a callback of Blender's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...core.scene.description import Camera, CameraKind, Scene
from ...core.scene.notice import by_weight
from ..meshes.live_meshes import LiveMeshes
from ..meshes.live_pass import LivePass
from ..meshes.placements import is_singular
from ..nodes.signature import NoSignature, Signatures
from ..scene import assembled, export_frame, reading, world_of
from ..world import has_nodes
from .edits import Edits, Update

# Each restart of a pass doubles the time of its slices, so often at most: edits that come faster than a pass goes
# through, as while an animation plays, do not put it off for ever
_RESTARTS_MOST = 5
# Where no view is known yet: every view replaces it
_NO_CAMERA = Camera(CameraKind.PERSPECTIVE, np.eye(3, 4, dtype=np.float32), (-1.0, 1.0, -1.0, 1.0))


class LiveScene:
    """The core's scene as a viewport shows it. Nothing of Blender's is kept between calls."""

    def __init__(self) -> None:
        self.scene: Scene | None = None  # as it was read last, with a camera that means nothing
        self.warnings: Sequence[str] = ()  # about parts of `scene` that are not rendered as they are
        self.is_locked = False  # the last `read` did nothing, because a final render reads
        self.counts: Counter[str] = Counter()  # what was done so far: passes, meshes, places, scenes
        self._meshes = LiveMeshes()
        self._pass = LivePass(self._meshes)
        self._restarts = 0  # of passes, since one came to its end
        self._edits = Edits(is_whole=True)
        self._place: dict[int, int] = {}  # of objects that are placed once, by themselves: index of their instance
        self._frame: float | None = None  # of the last pass
        self._moves_others = True  # what places of objects do not show depends on them

    @property
    def is_current(self) -> bool:
        """Whether all edits were read."""
        return not self._edits

    def note(self, updates: list[Update]) -> None:
        """Blender evaluated anew what `updates` say."""
        self._restart()  # the list that it goes through may be another now
        self._edits.add(updates)

    def look_again(self) -> None:
        """Something changed that Blender does not list: go through the scene once more."""
        self._restart()
        self._edits.is_whole = True

    def forget(self) -> None:
        """Anything may have changed: read all of the scene once more."""
        self.look_again()
        self._meshes.clear()
        self._edits.any_material = True

    def read(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, seconds: float) -> bool:
        """Read what was edited, and stop after the object during which `seconds` have passed. True: `scene` is another
        than before; otherwise it is the same, or there is more to read. Raises `RayBatchError`.
        """
        self.is_locked = False
        if not self._edits:
            return False
        if not reading.acquire(blocking=False):
            self.is_locked = True
            return False
        try:
            return self._read(depsgraph, space, seconds)
        finally:
            reading.release()

    def _read(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, seconds: float) -> bool:
        before = self.scene
        if not self._edits.is_whole and self._move(depsgraph):
            self._edits.clear()
            return self.scene is not before
        return self._read_all(depsgraph, space, seconds * 2 ** min(self._restarts, _RESTARTS_MOST))

    def _restart(self) -> None:
        self._restarts += self._pass.is_under_way
        self._pass.drop()

    # --- places alone

    def _move(self, depsgraph: bpy.types.Depsgraph) -> bool:
        """Put what was moved where it is now; False where that is not enough."""
        moved = self._edits.moved
        if self.scene is None or self._moves_others or depsgraph.scene.frame_current_final != self._frame:
            return False
        where: dict[int, np.ndarray] = {}
        cameras = 0  # each view looks where they are by itself
        for update in depsgraph.updates:
            uid = update.id.original.session_uid
            if uid in moved and isinstance(update.id, bpy.types.Object):
                if update.id.type == "CAMERA":
                    cameras += 1
                elif update.id.animation_data is not None:  # what a driver sets besides the place, nobody lists
                    return False
                elif uid in self._place:
                    where[self._place[uid]] = np.array(update.id.matrix_world, np.float32)[:3]
        if len(where) + cameras != len(moved):  # one of them is no instance, or was moved before another callback
            return False
        if not where:
            return True
        matrices = np.stack(list(where.values()))
        if not np.isfinite(matrices).all() or is_singular(matrices).any():
            return False
        transform = self.scene.instances.transform.copy()
        transform[list(where)] = matrices
        self.scene = replace(self.scene, instances=replace(self.scene.instances, transform=transform))
        self.counts["places"] += len(where)
        self.counts["scenes"] += 1
        return True

    # --- all of it

    def _read_all(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, seconds: float) -> bool:
        meshes, before = self._meshes, self._meshes.read_count
        if not self._pass.is_under_way:
            meshes.begin(self._edits.reshaped)
            meshes.materials.forget(None if self._edits.any_material else self._edits.materials)
            self._edits.forgotten()  # what is touched is read when the pass comes by
        placements = self._pass.go_on(depsgraph, space, seconds)
        self.counts["meshes"] += meshes.read_count - before
        if placements is None:
            self.counts["slices"] += 1
            return False
        self._restarts, self._frame = 0, depsgraph.scene.frame_current_final
        self.counts["passes"] += 1
        self.counts["materials"] += placements.materials.compiled_count
        scene = depsgraph.scene
        frame = export_frame(scene, depsgraph.view_layer, depsgraph.scene_eval.world)
        frame = replace(frame, border=None, passes=("Combined",))
        warnings: list[str] = []
        read = assembled(depsgraph, _NO_CAMERA, frame, placements, warnings)
        self.warnings = by_weight(dict.fromkeys(warnings))
        self._note_places(placements.usable)
        self._moves_others = placements.materials.reads_elsewhere or _reads_elsewhere(depsgraph)
        self._edits.clear()
        if self.scene is not None and is_same(self.scene, read):
            return False
        self.scene = read
        self.counts["scenes"] += 1
        return True

    def _note_places(self, usable: np.ndarray | None) -> None:
        """Remember which instance is which object's; what is placed twice, or places others, is none of these."""
        owners = self._meshes.owners
        times = Counter(owners)
        self._place = {}
        if usable is None:
            return
        numbers = np.cumsum(usable) - 1
        for index, owner in enumerate(owners):
            if owner and times[owner] == 1 and usable[index] and owner not in self._meshes.instancers:
                self._place[owner] = int(numbers[index])


def _reads_elsewhere(depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether graphs of lights or of the world may read places of objects."""
    lights = [each.data for each in depsgraph.objects if each.type == "LIGHT"]
    world, signatures = world_of(depsgraph.scene_eval, depsgraph.view_layer_eval), Signatures()
    try:
        for each in (*lights, *([] if world is None else [world])):
            if has_nodes(each):
                signatures.of(each.node_tree)
    except NoSignature:
        return True
    return False


def is_same(a: Any, b: Any) -> bool:
    """Whether two descriptions say the same. Arrays are compared by their numbers, unless they are one and the same."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if is_dataclass(a):
        return all(is_same(getattr(a, each.name), getattr(b, each.name)) for each in fields(a))
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(is_same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(is_same(a[key], b[key]) for key in a)
    return bool(a == b)
