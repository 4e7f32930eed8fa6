"""The primitives that chunks hold, and triangles of which their trees are built.

Where there are segments of curves, or vertices that move, a tree is built over *stand-ins*: triangles that are
diagonals of boxes, each around its primitive at all steps. Chunks are divided by them too. The primitives themselves
come into the leaves at last, those of all steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....scene.flatten import FlatGeometry
from ....scene.segments import are_segments, segment_boxes, segment_boxes_over
from ...build.encode import as_vectors
from ...build.mesh_tree import MeshPart, mesh_parts
from ...build.segments import place_primitives
from ...node import Layout, triangle_faces


@dataclass(frozen=True)
class OwnPrimitives:
    """The primitives of a mesh, in place of stand-ins."""

    positions: np.ndarray  # float32 [v, 3]
    triangles: np.ndarray  # int32 [n, 3], those of the mesh
    shifts: np.ndarray  # what is added to the indices of their vertices, by step, int32 [steps]

    @property
    def steps(self) -> int:
        """Steps of their vertices; 1 where these do not move."""
        return len(self.shifts)

    def placed(self, layout: Layout, blocks: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Words of the primitives of all steps, step by step; of QUANTISED their vertices too, int32 [units, 3].

        Args:
            blocks: of a tree over the stand-ins of `faces`, which it calls 0, 1, ...; they are overwritten.
            faces: int32, numbers in the mesh.
        """
        own = self.triangles[faces]
        found = []
        for shift in self.shifts:
            place_primitives(as_vectors(blocks), layout, self.positions, own + shift)
            found.append(blocks.copy())
        words = found[0] if len(found) == 1 else np.concatenate(found)
        if layout is Layout.BOXES:
            return words, None
        own = own[triangle_faces(layout, blocks)]
        return words, np.concatenate([own + shift for shift in self.shifts])


@dataclass(frozen=True)
class Primitives:
    """All primitives of a scene."""

    positions: np.ndarray  # those of the scene, float32 [v, 3], and behind them those of all steps
    triangles: np.ndarray  # int32 [n, 3], indices into them
    boxed_positions: np.ndarray  # likewise of stand-ins
    boxed_triangles: np.ndarray
    shifts: dict[int, np.ndarray]  # by `MeshPart.mesh` of those that deform: `OwnPrimitives.shifts`
    copies: int = 0  # of primitives, at further steps

    @staticmethod
    def of(flat: FlatGeometry) -> Primitives:
        """The primitives of `flat`; without segments, and vertices that move, they are their own stand-ins."""
        moving = {part: flat.motion.steps[part.mesh][0] for part in _deforming(flat)}
        positions, shifts, end = [flat.positions], {}, len(flat.positions)
        for part, steps in moving.items():
            shifts[part.mesh] = (end - part.vertex_first + np.arange(len(steps)) * steps.shape[1]).astype(np.int32)
            positions.append(steps.reshape(-1, 3))
            end += steps.shape[0] * steps.shape[1]
        every = flat.positions if len(positions) == 1 else np.concatenate(positions)
        copies = sum((len(steps) - 1) * part.triangle_count for part, steps in moving.items())
        return Primitives(every, flat.triangles, *_stand_ins(flat, moving), shifts, copies)

    @property
    def stand_in(self) -> bool:
        """Whether trees are built over stand-ins, which must not be split."""
        return self.boxed_triangles is not self.triangles

    def own(self, part: MeshPart) -> OwnPrimitives | None:
        """What comes in place of the stand-ins of a mesh; None where there are none."""
        triangles, shifts = self.triangles[part.span], self.shifts.get(part.mesh)
        if shifts is None:
            if not self.stand_in or np.array_equal(triangles, self.boxed_triangles[part.span]):
                return None
            shifts = np.zeros(1, np.int32)
        return OwnPrimitives(self.positions, triangles, shifts)


def _deforming(flat: FlatGeometry) -> list[MeshPart]:
    return [part for part in mesh_parts(flat) if flat.motion and part.mesh in flat.motion.steps]


def _stand_ins(flat: FlatGeometry, moving: dict[MeshPart, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and triangles of stand-ins; of triangles that need none they are those of `flat`."""
    still = are_segments(flat.positions, flat.triangles) if flat.curves else np.zeros(len(flat.triangles), bool)
    boxes = []
    for part, steps in moving.items():
        still[part.span] = False
        boxes.append((np.arange(part.triangle_first, part.span.stop), *_boxes_over(flat, part, steps)))
    if still.any():
        boxes.append((np.flatnonzero(still), *segment_boxes(flat.positions, flat.triangles[still])))
    if not boxes:
        return flat.positions, flat.triangles
    which, low, high = (np.concatenate(each) for each in zip(*boxes, strict=True))
    first = len(flat.positions) + np.arange(len(which), dtype=np.int32)
    triangles = flat.triangles.copy()
    triangles[which] = np.stack([first, first + np.int32(len(which)), first + np.int32(len(which))], 1)
    return np.concatenate([flat.positions, low, high]), triangles


def _boxes_over(flat: FlatGeometry, part: MeshPart, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates of the primitives of a mesh at all steps of its vertices."""
    own = flat.triangles[part.span] - np.int32(part.vertex_first)
    if flat.curves and are_segments(steps[0], own).any():
        return segment_boxes_over(steps, own)
    corners = [positions[own] for positions in steps]
    return np.min([each.min(1) for each in corners], 0), np.max([each.max(1) for each in corners], 0)
