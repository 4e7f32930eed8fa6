"""The entries of a scene: mesh trees as instances place them, and where they are in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...device.bulk import in_slices
from ...scene.flatten import FlatGeometry
from ...scene.motion import KEY_FLOATS, knots, maps_at, way_off


@dataclass(frozen=True, kw_only=True)
class Entries:
    """Mesh trees as instances place them: groups of baked instances, then instances of shared meshes. Shapes begin with
    [n].
    """

    mesh: np.ndarray  # index in `mesh_parts`, int64
    instance: np.ndarray  # instance id, or -1 for a group
    visibility: np.ndarray
    to_world: np.ndarray  # float64, shape [n, 3, 4]
    from_world: np.ndarray  # its inverse
    merged_first: np.ndarray  # first of an entry's baked instances in the next two, shape [n + 1]
    merged_instance: np.ndarray
    merged_triangle_first: np.ndarray
    motion: np.ndarray | None = None  # row of the entry's keys, or -1
    keys: np.ndarray | None = None  # `FlatMotion.keys`, float32, shape [rows, steps, KEY_FLOATS]

    def boxes(
        self, mesh_boxes: np.ndarray, first: float = 0.0, last: float = 1.0, which: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """World boxes of the entries `which` (all) from one time to another, float64, shape [n, 2, 3], from those of
        the mesh trees, shape [m, 2, 3] (Arvo 1990).
        """
        each, mesh, maps = mesh_boxes.astype(np.float64), self.mesh[which], self.to_world[which]
        found = np.empty((len(mesh), 2, 3))

        def move(part: slice) -> None:
            found[part] = _moved_boxes(maps[part], each[mesh[part]])

        in_slices(len(mesh), move, _IN_A_THREAD)
        row = np.full(len(mesh), -1) if self.motion is None else self.motion[which]
        moving = np.flatnonzero(row >= 0)
        for begin in range(0, len(moving), _AT_ONCE):
            some = moving[begin : begin + _AT_ONCE]
            found[some] = boxes_over_time(self.keys[row[some]], each[mesh[some]], first, last)
        return found

    def moving(self) -> np.ndarray:
        """Whether each entry moves as a whole: bool, shape [n]."""
        return np.zeros(len(self.to_world), bool) if self.motion is None else self.motion >= 0

    def conditions(self) -> tuple[np.ndarray, np.ndarray]:
        """By entry, as large as they become: the product of the sizes of its map and the inverse, and the largest
        coordinate of its origin.
        """
        size, reach = _condition(self.to_world, self.from_world), np.abs(self.to_world[:, :, 3]).max(1)
        moving = np.flatnonzero(self.moving())
        for first in range(0, len(moving), _AT_ONCE):
            some = moving[first : first + _AT_ONCE]
            keys = self.keys[self.motion[some]]
            maps = maps_at(keys, knots(keys))
            usable = np.abs(np.linalg.det(maps[..., :3])) > 0
            maps[~usable] = np.eye(3, 4)  # where there is no inverse nothing is hit
            flat = maps.reshape(-1, 3, 4)
            sizes = _condition(flat, inverse_transforms(flat)).reshape(maps.shape[:2])
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


def _condition(to_world: np.ndarray, from_world: np.ndarray) -> np.ndarray:
    """The product of the largest sums of a row's sizes of maps [n, 3, 4] and of their inverses: shape [n]."""
    found = np.empty(len(to_world))

    def measure(part: slice) -> None:
        there, back = (np.abs(maps[part, :, :3]).sum(2).max(1) for maps in (to_world, from_world))
        found[part] = there * back

    in_slices(len(to_world), measure, _IN_A_THREAD)
    return found


def entries_of(flat: FlatGeometry, visibility: np.ndarray) -> Entries:
    """The entries of `flat`; `visibility` holds the bits of each instance, int, shape [instance_count]."""
    groups, shared = flat.merged, flat.shared
    mesh = flat.instance_mesh[shared]
    mesh = (np.cumsum(np.bincount(mesh) > 0) - 1)[mesh]  # numbers without gaps
    to_world = np.concatenate(
        [np.broadcast_to(np.eye(3, 4), (len(groups), 3, 4)), flat.instance_transform[shared].astype(np.float64)]
    )
    merged_end = np.cumsum([len(group.instance) for group in groups], dtype=np.int64)
    none = np.zeros(0, np.int32)
    motion = flat.motion
    rows = motion.row[shared] if motion else np.full(len(shared), -1)
    return Entries(
        mesh=np.concatenate([np.arange(len(groups)), len(groups) + mesh]),
        instance=np.concatenate([np.full(len(groups), -1), shared]),
        visibility=np.concatenate([[group.visibility for group in groups], visibility[shared]]),
        to_world=to_world,
        from_world=inverse_transforms(to_world),
        merged_first=np.concatenate([[0], merged_end, np.full(len(shared), merged_end[-1] if groups else 0)]),
        merged_instance=np.concatenate([none, *(group.instance for group in groups)]),
        merged_triangle_first=np.concatenate([none, *(group.instance_triangle_first for group in groups)]),
        motion=np.concatenate([np.full(len(groups), -1), rows]).astype(np.int32),
        keys=motion.keys if motion else np.zeros((0, 2, KEY_FLOATS), np.float32),
    )


def inverse_transforms(matrices: np.ndarray) -> np.ndarray:
    """Inverses of affine maps, float64, shape [n, 3, 4]."""
    found = np.empty(matrices.shape)

    def invert(part: slice) -> None:
        inverse = np.linalg.inv(matrices[part, :, :3])
        found[part, :, :3] = inverse
        found[part, :, 3:] = -inverse @ matrices[part, :, 3:]

    in_slices(len(matrices), invert, _IN_A_THREAD)
    return found
