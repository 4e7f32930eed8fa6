"""How bright cells of volumes are, estimated at some points of each: by the program of the volume, and by the share of
the points that lie within its surface. All cells of all volumes are looked at together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.devices import load_module
from ....device.kernel import KERNEL_OPTIONS
from ....native.structs import to_numpy
from ....scene.description import ClosureKind, Scene, Volume
from ....shading.volumes.enclosures import AHEAD, FARTHEST
from ..bounds import CELL_POINTS, CELLS_MOST, Bounded, largest_of_cells, point_of_cell, slots_of
from ..grids import density_scale
from ..table import BoundBox, BoundWork, VolumeData
from .weigh import POINTS

# Share of its own brightness that a cell gives to the cells around it, whose points may have missed something
_SPREAD = 0.1


@wp.kernel(**KERNEL_OPTIONS)
def inside_kernel(mesh: wp.uint64, boxes: wp.array(dtype=wp.vec4), cells: int, found: wp.array(dtype=float)):
    """The share of the points of each cell of `boxes`, corners and edges, that are in a closed surface."""
    i = wp.tid()
    box = boxes[i / (cells * cells * cells)]
    number = i % (cells * cells * cells)
    inside = int(0)
    for k in range(CELL_POINTS):
        ahead = wp.normalize(wp.vec3(wp.static(AHEAD[0]), wp.static(AHEAD[1]), wp.static(AHEAD[2])))
        place = wp.vec3(box[0], box[1], box[2]) + box[3] * (point_of_cell(number, cells, k) / float(cells))
        hit = wp.mesh_query_ray(mesh, place, ahead, wp.static(FARTHEST))
        if hit.result and hit.sign < 0.0:
            inside += 1
    found[i] = float(inside) / float(CELL_POINTS)


@dataclass(frozen=True)
class CellBoxes:
    """Boxes that are parts of the boxes of volumes, all of `count`^3 cells; float64."""

    of: np.ndarray  # number of the volume, int, shape [g]
    corner: np.ndarray  # of its box, from 0 to 1, shape [g, 3]
    edge: np.ndarray  # of 1, shape [g]
    count: int

    def __len__(self) -> int:
        return len(self.of)


@dataclass(frozen=True)
class Looked:
    """What cells of `CellBoxes` are estimated to be: float64, shape [g, count^3] each."""

    strength: np.ndarray  # intensity, mean of the channels [W/sr]
    rate: np.ndarray  # see `EmissiveCells`
    fill: np.ndarray  # about the share of the cell that emits


class Estimates:
    """Estimates of cells of the volumes `bounded` of `scene`."""

    def __init__(
        self,
        volumes: VolumeData,
        scene: Scene,
        bounded: list[Bounded],
        filling: list[Volume],
        volume_of: np.ndarray,
        launch: Callable[[VolumeData, int], None],
        device: wp.Device,
    ) -> None:
        """As `find_cells` has them; `filling`: all volumes."""
        self._volumes, self._filling, self._launch, self._device = volumes, filling, launch, device
        self._volume = np.array([each.volume for each in bounded])
        self.code = 1 + np.array([each.instance for each in bounded]) * volumes.volume_count + self._volume
        placed = np.stack([each.to_world for each in bounded])
        boxes = np.stack([each.box for each in bounded])
        low, size = boxes[:, 0], boxes[:, 1] - boxes[:, 0]
        # as kernels have it: cells begin where they are looked for
        self.origin = np.einsum("nij,nj->ni", placed[:, :, :3], low) + placed[:, :, 3]
        self.origin = self.origin.astype(np.float32).astype(np.float64)
        self.edges = placed[:, :, :3] * size[:, None]  # columns [m]
        thinner = density_scale(scene)
        self._scale = np.ones(len(bounded)) if thinner is None else thinner[[each.instance for each in bounded]]
        self.surface_of = np.zeros(len(bounded), int)
        self.surfaces: list[tuple[Bounded, np.ndarray]] = []  # and the triangles
        numbers: dict[tuple, int] = {}
        for number, each in enumerate(bounded):
            mesh = each.mesh
            assert mesh is not None
            first = int(scene.instances.slot_first[each.instance])
            slots = volume_of[scene.slot_materials[first : first + slots_of(mesh)]] == each.volume
            key = (id(mesh), slots.tobytes())
            if key not in numbers:
                numbers[key] = len(self.surfaces)
                taken = mesh.triangles if mesh.triangle_slot is None else mesh.triangles[slots[mesh.triangle_slot]]
                self.surfaces.append((each, taken))
            self.surface_of[number] = numbers[key]
        self._trees: dict[int, wp.Mesh] = {}  # of surfaces

    def placed(self, parts: CellBoxes) -> tuple[np.ndarray, np.ndarray]:
        """Corners [g, 3] and edges, by columns, [g, 3, 3] of `parts` in the world [m]."""
        edges = self.edges[parts.of]
        corner = self.origin[parts.of] + np.einsum("gij,gj->gi", edges, parts.corner)
        return corner, edges * parts.edge[:, None, None]

    def look(self, parts: CellBoxes) -> Looked:
        """The estimates of the cells of `parts`."""
        count, shape = parts.count, (len(parts), parts.count**3)
        corner, edges = self.placed(parts)
        share = self._inside(parts)
        longest = np.linalg.norm(self.edges[parts.of], axis=1).max(1)
        light, square, densest = (np.zeros(shape) for _ in range(3))
        by_program = np.array([volume.program is not None for volume in self._filling])[self._volume[parts.of]]
        for number in np.unique(self._volume[parts.of[~by_program]]).tolist():
            these = np.flatnonzero(~by_program & (self._volume[parts.of] == number))
            weights = {True: np.zeros(3), False: np.zeros(3)}
            for closure in self._filling[number].closures:
                weights[closure.kind == ClosureKind.EMISSION] += np.asarray(closure.weight, float)
            scale = self._scale[parts.of[these], None]
            light[these] = scale * weights[True].mean()
            square[these], densest[these] = light[these] ** 2, scale * weights[False].max()
        rate = densest + POINTS / longest[:, None]
        if by_program.any():
            found, means = self._evaluated(parts.of[by_program], corner[by_program], edges[by_program], count)
            light[by_program], square[by_program] = means[..., 0], means[..., 1]
            least = (CELLS_MOST if self._volumes.varies else POINTS) / longest[by_program, None]
            rate[by_program] = np.maximum(found, least)
        with np.errstate(all="ignore"):
            strength = light * share * np.abs(np.linalg.det(edges))[:, None] / count**3
            strength = np.where(np.isfinite(strength), _spread(strength, count) * (share > 0), 0.0)
            fill = share * np.where(square > 0, light**2 / square, 0.0)
        return Looked(strength, rate, fill)

    def _inside(self, parts: CellBoxes) -> np.ndarray:
        """Share of each cell that is in the surface, float64, shape [g, count^3]; alike parts are looked at once."""
        boxes = np.column_stack([parts.corner, parts.edge])
        rows, row_of = np.unique(np.column_stack([self.surface_of[parts.of], boxes]), axis=0, return_inverse=True)
        result = np.zeros((len(rows), parts.count**3))
        load_module(inside_kernel, self._device)
        for number in np.unique(rows[:, 0]).astype(int).tolist():
            volume, triangles = self.surfaces[number]
            if not len(triangles):
                continue
            these = np.flatnonzero(rows[:, 0] == number)
            if number not in self._trees:
                low, size = volume.box[0], volume.box[1] - volume.box[0]
                positions = ((volume.mesh.positions - low) / size).astype(np.float32)  # type: ignore[union-attr]
                self._trees[number] = wp.Mesh(
                    wp.array(positions, dtype=wp.vec3, device=self._device),
                    wp.array(np.ascontiguousarray(triangles, np.int32).ravel(), dtype=int, device=self._device),
                )
            surface = self._trees[number]
            asked = wp.array(rows[these, 1:].astype(np.float32), dtype=wp.vec4, device=self._device)
            found = wp.zeros(len(these) * parts.count**3, dtype=float, device=self._device)
            wp.launch(inside_kernel, len(found), [surface.id, asked, parts.count, found], device=self._device)
            result[these] = to_numpy(found).reshape(len(these), -1)
        return result[row_of.ravel()]

    def _evaluated(
        self, of: np.ndarray, corner: np.ndarray, edges: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of each cell of boxes of volumes with programs: the largest extinction [1/m], and means as in
        `BoundWork.emitted`; float64, shapes [g, count^3] and [g, count^3, 2].
        """
        volumes = self._volumes
        boxes = np.zeros(len(of), BoundBox.numpy_dtype())
        boxes["origin"], boxes["edges"], boxes["code"], boxes["moving"] = corner, edges, self.code[of], -1
        boxes["first"] = np.arange(len(of)) * count**3
        asked = BoundWork()
        asked.boxes, asked.cells, asked.rays = wp.array(boxes, dtype=BoundBox, device=self._device), count, 1
        asked.found = wp.zeros(len(of) * count**3 * CELL_POINTS, dtype=wp.vec2, device=self._device)
        asked.emitted = wp.zeros(len(of) * count**3, dtype=wp.vec2, device=self._device)
        world, volumes.world, volumes.asked = volumes.world, -1, asked
        self._launch(volumes, len(of) * count**3)
        volumes.asked, volumes.world = BoundWork(), world
        found, emitted = largest_of_cells(asked.found), to_numpy(asked.emitted).astype(np.float64)
        return found.reshape(len(of), -1), emitted.reshape(len(of), -1, 2)


def _spread(strength: np.ndarray, n: int) -> np.ndarray:
    """`strength` of cells, shape [g, n^3], with a part of the mean of those around."""
    padded = np.pad(strength.reshape(-1, n, n, n), ((0, 0), (1, 1), (1, 1), (1, 1)))
    around = sum(padded[:, x : x + n, y : y + n, z : z + n] for x in range(3) for y in range(3) for z in range(3))
    return strength + _SPREAD / 27 * around.reshape(strength.shape)
