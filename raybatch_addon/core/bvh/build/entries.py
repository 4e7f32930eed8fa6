"""The entries of a scene: mesh trees as instances place them, and where they are in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...device.bulk import in_slices
from ...scene.flatten import FlatGeometry
from ...scene.motion import KEY_FLOATS, knots, maps_at, way_off


@dataclass(frozen=True, kw_only=True)
class Entries:
    """Mesh trees as instances place them: groups of baked instances, then instances of shared meshes. Shapes begin with
    [n].
    """

    mesh: np.ndarray  # index in `mesh_parts`, int32
    instance: np.ndarray  # instance id, or -1 for a group, int32
    visibility: np.ndarray  # int32
    transform: np.ndarray  # to the world, of all instances: `FlatGeometry.instance_transform`, not by entry
    from_world: np.ndarray  # the inverse of the entry's map, rounded from float64: float32, shape [n, 3, 4]
    condition: np.ndarray  # the product of the sizes of the two maps (`map_condition`), float64
    merged_first: np.ndarray  # first of an entry's baked instances in the next two, int32, shape [n + 1]
    merged_instance: np.ndarray  # int32
    merged_triangle_first: np.ndarray  # int32
    motion: np.ndarray | None = None  # row of the entry's keys, or -1: int32
    keys: np.ndarray | None = None  # `FlatMotion.keys`, float32, shape [rows, steps, KEY_FLOATS]

    def __len__(self) -> int:
        return len(self.mesh)

    def to_world(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Maps to the world of the entries `which` (all): float64, shape [n, 3, 4]."""
        return _maps_of(self.transform, self.instance[which])

    def boxes(
        self, mesh_boxes: np.ndarray, first: float = 0.0, last: float = 1.0, which: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """World boxes of the entries `which` (all) from one time to another, float64, shape [n, 2, 3], from those of
        the mesh trees, shape [m, 2, 3] (Arvo 1990).
        """
        each, mesh, instance = mesh_boxes.astype(np.float64), self.mesh[which], self.instance[which]
        found = np.empty((len(mesh), 2, 3))

        def move(part: slice) -> None:
            found[part] = _moved_boxes(_maps_of(self.transform, instance[part]), each[mesh[part]])

        in_slices(len(mesh), move, _IN_A_THREAD)
        row = np.full(len(mesh), -1, np.int32) if self.motion is None else self.motion[which]
        moving = np.flatnonzero(row >= 0)
        for begin in range(0, len(moving), _AT_ONCE):
            some = moving[begin : begin + _AT_ONCE]
            found[some] = boxes_over_time(self.keys[row[some]], each[mesh[some]], first, last)
        return found

    def moving(self) -> np.ndarray:
        """Whether each entry moves as a whole: bool, shape [n]."""
        return np.zeros(len(self), bool) if self.motion is None else self.motion >= 0

    def conditions(self) -> tuple[np.ndarray, np.ndarray]:
        """By entry, as large as they become: the product of the sizes of its map and the inverse, and the largest
        coordinate of its origin.
        """
        size, reach = self.condition.copy(), np.empty(len(self))

        def measure(part: slice) -> None:
            reach[part] = np.abs(self.to_world(part)[:, :, 3]).max(1)

        in_slices(len(self), measure, _IN_A_THREAD)
        moving = np.flatnonzero(self.moving())
        for first in range(0, len(moving), _AT_ONCE):
            some = moving[first : first + _AT_ONCE]
            keys = self.keys[self.motion[some]]
            maps = maps_at(keys, knots(keys))
            usable = np.abs(np.linalg.det(maps[..., :3])) > 0
            maps[~usable] = np.eye(3, 4)  # where there is no inverse nothing is hit
            flat = maps.reshape(-1, 3, 4)
            sizes = map_condition(flat, inverse_transforms(flat)).reshape(maps.shape[:2])
            size[some] = np.maximum(size[some], _BETWEEN_KNOTS * sizes.max(1))
            reach[some] = np.maximum(reach[some], np.abs(keys[..., 4:7]).max((1, 2)))
        return size, reach


# Moving entries that are looked at together, for which arrays are made of each at many times
_AT_ONCE = 1024
# Entries whose maps a thread works on together
_IN_A_THREAD = 1 << 16
# How much larger a map's condition may be than at the times that are looked at. A scale that goes by 0 between them has
# no bound: rays there are as wrong as their own arithmetic
_BETWEEN_KNOTS = 2.0


def _moved_boxes(maps: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Boxes [..., 2, 3] around the boxes [..., 2, 3] under maps [..., 3, 4] (Arvo 1990)."""
    linear = maps[..., :3]
    middle = np.einsum("...ij,...j->...i", linear, box.mean(-2)) + maps[..., 3]
    reach = np.einsum("...ij,...j->...i", np.abs(linear), (box[..., 1, :] - box[..., 0, :]) / 2)
    return np.stack([middle - reach, middle + reach], -2)


def boxes_over_time(keys: np.ndarray, box: np.ndarray, first: float = 0.0, last: float = 1.0) -> np.ndarray:
    """Boxes [n, 2, 3] around all that things in the boxes [n, 2, 3] come by from one time to another, moved by keys
    [n, steps, KEY_FLOATS].
    """
    times = knots(keys)
    parts = (len(times) - 1) // (keys.shape[1] - 1)
    times = np.concatenate([[first], times[(times > first) & (times < last)], [last]])
    there = _moved_boxes(maps_at(keys, times), box[:, None])
    off = way_off(keys, np.linalg.norm(np.abs(box).max(1), axis=1), parts)[:, None]
    return np.stack([there[:, :, 0].min(1) - off, there[:, :, 1].max(1) + off], 1)


def _maps_of(transform: np.ndarray, instance: np.ndarray) -> np.ndarray:
    """Maps of entries of these instances, -1 for what is in the world already: float64, shape [n, 3, 4]."""
    maps = transform[np.maximum(instance, 0)].astype(np.float64) if len(transform) else np.empty((len(instance), 3, 4))
    maps[instance < 0] = np.eye(3, 4)
    return maps


def map_condition(to_world: np.ndarray, from_world: np.ndarray) -> np.ndarray:
    """The product of the largest sums of a row's sizes of maps [n, 3, 4] and of their inverses: shape [n]."""
    there, back = (np.abs(maps[:, :, :3]).sum(2).max(1) for maps in (to_world, from_world))
    return there * back


def placed_meshes(flat: FlatGeometry, visibility: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each entry of `flat`: the index in `mesh_parts`, the instance (-1: a group), and its visibility, int32 [n]."""
    groups, shared = flat.merged, flat.shared
    mesh = flat.instance_mesh[shared]
    mesh = (np.cumsum(np.bincount(mesh) > 0, dtype=np.int32) - 1)[mesh]  # numbers without gaps
    return (
        int32_joined(np.arange(len(groups)), np.int32(len(groups)) + mesh),
        int32_joined(np.full(len(groups), -1), shared),
        int32_joined([group.visibility for group in groups], visibility[shared]),
    )


def entries_of(flat: FlatGeometry, visibility: np.ndarray) -> Entries:
    """The entries of `flat`; `visibility` holds the bits of each instance, int, shape [instance_count]."""
    mesh, instance, seen = placed_meshes(flat, visibility)
    merged = np.cumsum([0, *(len(group.instance) for group in flat.merged)])
    return entries_at(
        flat,
        mesh=mesh,
        instance=instance,
        visibility=seen,
        merged_first=int32_joined(merged, np.full(len(flat.shared), merged[-1], np.int32)),
        merged_instance=int32_joined(*(group.instance for group in flat.merged)),
        merged_triangle_first=int32_joined(*(group.instance_triangle_first for group in flat.merged)),
    )


def entries_at(flat: FlatGeometry, *, mesh: np.ndarray, instance: np.ndarray, **columns: np.ndarray) -> Entries:
    """Entries over `mesh` where `instance` of `flat` has them; the other columns are given."""
    from_world, condition = np.empty((len(instance), 3, 4), np.float32), np.empty(len(instance))

    def invert(part: slice) -> None:
        maps = _maps_of(flat.instance_transform, instance[part])
        inverse = inverse_transforms(maps)
        from_world[part], condition[part] = inverse, map_condition(maps, inverse)

    in_slices(len(instance), invert, _IN_A_THREAD)
    motion = flat.motion
    return Entries(
        mesh=mesh,
        instance=instance,
        transform=flat.instance_transform,
        from_world=from_world,
        condition=condition,
        motion=np.where(instance < 0, np.int32(-1), motion.row[np.maximum(instance, 0)]) if motion else None,
        keys=motion.keys if motion else np.zeros((0, 2, KEY_FLOATS), np.float32),
        **columns,
    )


def int32_joined(*parts: npt.ArrayLike) -> np.ndarray:
    """The numbers of all `parts`, one behind another, int32."""
    return np.concatenate([np.zeros(0, np.int32), *(np.asarray(part, np.int32) for part in parts)])


def inverse_transforms(matrices: np.ndarray) -> np.ndarray:
    """Inverses of affine maps, float64, shape [n, 3, 4]."""
    found = np.empty(matrices.shape)
    inverse = np.linalg.inv(matrices[:, :, :3])
    found[:, :, :3] = inverse
    found[:, :, 3:] = -inverse @ matrices[:, :, 3:]
    return found
