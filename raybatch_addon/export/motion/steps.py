"""Motion while the shutter is open: the camera, the maps of instances, and the vertices of meshes."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Hashable
from dataclasses import replace
from itertools import chain

import bpy
import numpy as np

from ...core.scene.description import Camera, InstanceMaps, Instances, Mesh
from ...core.scene.motion import maps_at, motion_keys
from ...core.scene.notice import Notice, Weight
from ...core.scene.validate import kept_instances
from ..meshes.mesh_arrays import read, read_loops, read_positions, read_triangles
from ..meshes.meshes import used_vertices
from ..meshes.placements import FLATTENED, Placements, is_singular, left_out_objects
from .objects import object_steps
from .placed import placed_key
from .shutter import Exposure

CameraPlace = tuple[np.ndarray, tuple[float, float, float, float]]  # `Camera.transform` and `Camera.window`
# Nothing that is elsewhere
_NOWHERE = np.zeros(0, np.int32), np.zeros((0, 16), np.float32)


class MotionSteps:
    """Positions and shapes at evenly spaced times while the shutter is open."""

    def __init__(self, exposure: Exposure, placements: Placements, camera_steps: int) -> None:
        """Take what was exported in the middle."""
        self._exposure, self._placements = exposure, placements
        most = max([*(each.steps for each in placements.motion), 0])
        self._camera_steps = camera_steps
        self.count = max(most, camera_steps)
        self._here = placements.map_rows()
        # by step: placements that are elsewhere then, and where
        self._elsewhere: list[tuple[np.ndarray, np.ndarray]] = [_NOWHERE] * self.count
        self._always = np.ones(len(placements.motion), bool)  # there at every step
        # first placements of the items of the depsgraph's list, which have others behind; items by key, and the next of
        # the same key
        self._first, self._items, self._next = array("i"), dict[Hashable, int](), dict[int, int]()
        for i, each in enumerate(placements.motion):
            if i == 0 or each.item != placements.motion[i - 1].item:
                self._add_item(each.key)
                self._first.append(i)
        self._first.append(len(placements.motion))
        self._positions: dict[int, list[tuple[np.ndarray, np.ndarray | None] | None]] = {}
        self._cameras: list[CameraPlace] = []
        self.warnings: list[str] = []  # of what does not move as it should

    def collect(
        self, depsgraph: bpy.types.Depsgraph, camera_now: Callable[[], CameraPlace], cancelled: Callable[[], bool]
    ) -> bool:
        """Go through all times, from the middle, where the scene is, on; False where `cancelled()`. The scene stays at
        the last of them. `camera_now` says how the camera is.
        """
        middle = (self.count - 1) // 2
        cameras = {}
        for step in sorted(range(self.count), key=lambda step: step != middle):
            if cancelled():
                return False
            if step != middle:
                self._exposure.go_to(2 * step / (self.count - 1) - 1)
            cameras[step] = camera_now()
            self._add(depsgraph, step)
        self._cameras = [cameras[step] for step in range(self.count)]
        return True

    def _add_item(self, key: Hashable) -> None:
        new = len(self._first)
        item = self._items.setdefault(key, new)
        while item in self._next:
            item = self._next[item]
        if item != new:
            self._next[item] = new

    def _add(self, depsgraph: bpy.types.Depsgraph, step: int) -> None:
        done: set[int] = set()
        seen = np.zeros(len(self._always), bool)
        found, maps = array("i"), array("f")
        for placed in depsgraph.object_instances:
            obj = placed.object
            item = self._items.get(placed_key(placed, obj))
            while item is not None and seen[self._first[item]]:
                item = self._next.get(item)
            if item is None:
                continue
            for index in range(self._first[item], self._first[item + 1]):
                seen[index] = True
                each = self._placements.motion[index]
                if each.steps == 0:
                    continue
                found.append(index)
                maps.extend(chain.from_iterable(placed.matrix_world))
                if each.deforms and each.mesh not in done:
                    done.add(each.mesh)
                    self._positions.setdefault(each.mesh, [None] * self.count)[step] = self._now(obj, each.mesh)

        self._always &= seen
        indices = np.frombuffer(found, np.int32)
        there = np.frombuffer(maps, np.float32).reshape(-1, 16)
        moved = (there != self._here[indices]).any(1)
        self._elsewhere[step] = indices[moved], there[moved]

    def _now(self, obj: bpy.types.Object, mesh: int) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Vertices and normals of `obj`, which was `mesh` in the middle."""
        strands = self._placements.strands.get(mesh)
        if strands is not None:
            vertices = strands.vertices_of(obj)
            return None if vertices is None else (vertices, None)
        return self._vertices(obj.data, self._placements.meshes[mesh]) if isinstance(obj.data, bpy.types.Mesh) else None

    def _vertices(self, data: bpy.types.Mesh, mesh: Mesh) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Vertices and normals of `data`, which was `mesh` in the middle; None where it has other triangles now."""
        data.calc_loop_triangles()
        if len(data.loop_triangles) != len(mesh.triangles):
            return None
        loops = read_loops(data)
        positions, triangles = used_vertices(read_positions(data), read_triangles(data, loops))
        same = len(positions) == len(mesh.positions) and np.array_equal(triangles, mesh.triangles)
        if not (same and np.isfinite(positions).all()):
            return None
        normals = None
        if mesh.corner_normals is not None:
            normals = read(data.corner_normals, "vector", np.float32, len(data.loops), 3)[loops]
            normals = normals if np.isfinite(normals.sum()) else mesh.corner_normals
        return positions, normals

    # --- results

    def camera(self, camera: Camera) -> Camera:
        """`camera`, which moves as it did."""
        if self._camera_steps < 2 or len(self._cameras) != self.count:
            return camera
        maps = np.stack([each[0] for each in self._cameras])
        windows = np.array([each[1] for each in self._cameras], np.float32)[:: (self.count - 1) // 2]
        moves, zooms = (maps != maps[:1]).any(), (windows != windows[:1]).any()
        return replace(
            camera,
            motion=_with_steps(maps[None], self._camera_steps)[0] if moves else None,
            window_motion=windows if zooms else None,
        )

    def instances(self, instances: Instances) -> Instances:
        """`instances`, which move as they did. What is not there all the time stands still, and so does what has no
        place at some time, which is named; what is flat all the time is left out.
        """
        if self.count == 0 or len(instances) == 0:
            return instances
        moving = self._moving(instances)
        regular = ~is_singular(instances.transform)
        if moving.motion is not None:
            maps = moving.motion.maps
            regular[moving.motion.instance] |= ~is_singular(maps.reshape(-1, 3, 4)).reshape(maps.shape[:2]).all(1)
        if regular.all():
            return moving
        names = self._placements.object_names
        self.warnings += left_out_objects([names[index] for index in instances.object[~regular].tolist()], FLATTENED)
        return kept_instances(moving, regular)

    def _moving(self, instances: Instances) -> Instances:
        usable = self._placements.usable
        assert usable is not None  # since the instances were made
        which = np.unique(np.concatenate([indices for indices, _ in self._elsewhere]))
        which = which[self._always[which] & usable[which]]
        maps = np.repeat(self._here[which, None], self.count, 1)
        for step, (indices, there) in enumerate(self._elsewhere):
            known = np.isin(indices, which)
            maps[np.searchsorted(which, indices[known]), step] = there[known]
        maps = maps.reshape(-1, self.count, 4, 4)[:, :, :3]
        finite = np.isfinite(maps).all((1, 2, 3))
        self._name_lost(which[~finite])
        which, maps = which[finite], np.ascontiguousarray(maps[finite])
        if not len(which):
            return instances
        steps = np.array([self._placements.motion[i].steps for i in which.tolist()])
        for count in np.unique(steps).tolist():
            some = np.flatnonzero(steps == count)
            maps[some] = _with_steps(maps[some], count)
        number = np.cumsum(usable) - 1
        return replace(instances, motion=InstanceMaps(number[which].astype(np.int32), maps))

    def _name_lost(self, placements: np.ndarray) -> None:
        """Name the objects of `placements`, which have no place at some time."""
        names = [self._placements.object_names[self._placements.templates[i].object] for i in placements.tolist()]
        for name in dict.fromkeys(names):
            text = f"object “{name}”: its matrix is not finite at some time while the shutter is open; it stands still"
            self.warnings.append(Notice(text, Weight.REPAIRED, objects=[name]))

    def meshes(self) -> list[Mesh]:
        """All meshes, with vertices that move as they did."""
        found = list(self._placements.meshes)
        most: dict[int, int] = {}
        for each in self._placements.motion:
            most[each.mesh] = max(most.get(each.mesh, 0), each.steps)
        for index, steps in self._positions.items():
            known = [each for each in steps if each is not None]
            if len(known) < len(steps):
                continue
            positions, count = np.stack([each for each, _ in known]), most[index]
            if (positions == positions[:1]).all():
                continue
            normals = None
            if found[index].corner_normals is not None:
                of_steps = [normal for _, normal in known if normal is not None]
                assert len(of_steps) == len(known)  # since the mesh has normals of its own
                normals = _lines(np.stack(of_steps), count)
            found[index] = replace(found[index], motion=_lines(positions, count), motion_normals=normals)
        velocities = {each.mesh: each.velocity for each in self._placements.motion if each.steps}
        for index, velocity in velocities.items():
            if velocity is not None and velocity.any():
                half = velocity * np.float32(self._exposure.length / 2 / self._exposure.fps)
                times = np.linspace(-1, 1, max(self.count, 3), dtype=np.float32)
                found[index] = replace(found[index], motion=found[index].positions + times[:, None, None] * half)
        return found


def _with_steps(maps: np.ndarray, count: int) -> np.ndarray:
    """Maps [n, steps, 3, 4] as if only `count` of their steps were known, where the others lie between."""
    steps = maps.shape[1]
    if count >= steps:
        return maps
    kept = maps[:, :: (steps - 1) // (count - 1)]
    return maps_at(motion_keys(kept), np.linspace(0, 1, steps)).astype(np.float32)


def _lines(positions: np.ndarray, count: int) -> np.ndarray:
    """Positions or normals [steps, ...] as if only `count` of their steps were known, with lines between them."""
    steps = len(positions)
    if count >= steps:
        return positions
    every = (steps - 1) // (count - 1)
    at = np.arange(steps) / every
    before = np.minimum(at.astype(int), count - 2)
    share = (at - before).astype(np.float32).reshape(-1, *[1] * (positions.ndim - 1))
    kept = positions[::every]
    return kept[before] + share * (kept[before + 1] - kept[before])


def with_frames(still: tuple, moving: tuple) -> tuple[Camera, Instances, list[Mesh]]:
    """Camera, instances and meshes as they stand `still`, with where they are at the ends of the time in which they are
    `moving`.
    """
    ends = [0, -1]
    camera, instances, meshes = still
    if moving[0].motion is not None:
        camera = replace(camera, frames=moving[0].motion[ends])
    if moving[0].window_motion is not None:
        camera = replace(camera, window_frames=moving[0].window_motion[ends])
    if moving[1].motion is not None:
        frames = np.ascontiguousarray(moving[1].motion.maps[:, ends])
        instances = replace(instances, frames=InstanceMaps(moving[1].motion.instance, frames))
    meshes = [
        mesh if moved.motion is None else replace(mesh, frames=np.ascontiguousarray(moved.motion[ends]))
        for mesh, moved in zip(meshes, moving[2], strict=True)
    ]
    return camera, instances, meshes


def camera_steps(scene: bpy.types.Scene, view) -> int:
    """Times at which the camera's place is known; 0: it does not move."""
    camera = view.camera(scene)
    return object_steps(camera, None) if camera else 0
