"""The trees of single meshes on the device that traces them: built, and refitted when vertices move.

On the CPU: binned SAH and the layout BOXES. On CUDA: clusters in Morton order, built on the device, and the layout
QUANTISED; meshes with spatial splits are built by the CPU and uploaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import warp as wp

from ...device.devices import free_memory
from ...native.structs import to_numpy
from ...scene.flatten import FlatGeometry
from ...scene.geometry import Geometry
from ..memory import COPY_BYTES, NODES_OVER_TIME
from ..node import TRIANGLES_MAX_QUANTISED, VECTOR_BYTES, Layout
from .binary import BuildOptions
from .collapse import collapse_mesh
from .cpu.build import build_binary
from .cuda.build import DeviceMesh, build_mesh
from .encode import as_vectors, empty_vectors
from .mesh_ranges import MeshRanges, refitted_ranges, worthwhile
from .refit import NodeLevels, RefitResult, node_levels, refit_boxes, refit_quantised
from .refit_part import WholeBoxes, is_part, refit_part
from .segments import place_primitives, stand_ins
from .time_ranges import vertices_between

# A refitted tree is built anew when it costs rays so many times the least that it did (Wald, Boulos and Shirley
# 2007 find 1.5 to 2 usual; but a build takes as long as some thirty refits, and a frame's rays mostly longer)
SAH_GROWTH_MAX = 1.4


class MeshPart(NamedTuple):
    """The contiguous parts of the scene's arrays that one mesh tree is over."""

    triangle_first: int
    triangle_count: int
    vertex_first: int
    vertex_count: int
    mesh: int = -1  # index of a shared mesh among all; -1: a group of baked instances

    @property
    def span(self) -> slice:
        """The part's triangles among all."""
        return slice(self.triangle_first, self.triangle_first + self.triangle_count)


def mesh_parts(flat: FlatGeometry) -> list[MeshPart]:
    """The parts that the mesh trees of a scene are over: the groups of baked instances, then the shared meshes in their
    order.
    """
    starts = [(group.triangle_first, group.triangle_count, -1) for group in flat.merged]
    first = flat.mesh_triangle_first
    starts += [
        (int(first[i]), int(first[i + 1] - first[i]), i)
        for i in np.flatnonzero(np.bincount(flat.instance_mesh[flat.shared])).tolist()
    ]
    parts = []
    for start, count, mesh in starts:
        vertex_first, vertex_end = flat.mesh_vertex_first[np.searchsorted(first, [start, start + count])].tolist()
        parts.append(MeshPart(start, count, vertex_first, vertex_end - vertex_first, mesh))
    return parts


@dataclass(kw_only=True)
class MeshTree:
    """The blocks of one mesh on the device that traces them, or on the way there."""

    part: MeshPart
    nodes: wp.array  # vec4
    triangles: wp.array  # vec4
    centre: np.ndarray  # float32 [3]
    box: np.ndarray  # float32 [2, 3]
    node_count: int
    depth: int
    sah: float  # expected cost of a ray that meets the root's box, in node steps
    sah_built: float  # the least of it since the tree was built
    split: bool  # some triangles are listed more than once
    splits: bool  # triangles were split where that pays for the positions that it has
    level_first: list[int] | None  # as `NodeLevels.first`, of nodes that lie level by level
    step_units: int = 0  # blocks of one step of vertices that move, in `triangles` step behind step; 0: they do not
    levels: NodeLevels | None = None  # of QUANTISED, from the first refit on
    whole: WholeBoxes | None = None  # of BOXES, once a part of its triangles moved
    # of vertices that move: figures with 1, 2, 4, ... ranges of time, as far as they pay; and those that are used, with
    # their nodes, which lie among those of the tree then
    over_time: list[MeshRanges] = field(default_factory=list, repr=False)
    ranges: MeshRanges | None = None

    def as_ranges(self) -> MeshRanges:
        """The tree as it is at all times."""
        return MeshRanges(self.box[None], np.array([self.sah]), self.centre[None])


class MeshTrees:
    """Builds and refits the mesh trees of one frame."""

    def __init__(
        self,
        flat: FlatGeometry,
        geometry: Geometry,
        device: wp.Device,
        layout: Layout,
        spatial_splits: bool,
        on_device: bool | None = None,
    ):
        """Take the frame `flat`, whose arrays are on `device` as `geometry`.

        `on_device`: build where rays are traced, which can be asked for on the CPU too (QUANTISED, without splits);
        default: on CUDA, without splits.
        """
        self._on_device = device.is_cuda and not spatial_splits if on_device is None else on_device
        self._flat, self._geometry, self._device, self.layout = flat, geometry, device, layout
        if layout is Layout.QUANTISED:
            self._options = BuildOptions(leaf_group=1, leaf_max=TRIANGLES_MAX_QUANTISED, spatial_splits=spatial_splits)
        else:
            self._options = BuildOptions(spatial_splits=spatial_splits)

    def build(self, part: MeshPart) -> MeshTree:
        """A new tree. Raises `OutOfMemoryError` where it does not fit."""
        steps = self._flat.motion.steps.get(part.mesh) if self._flat.motion else None
        if steps is None:
            return self._build(part, self._options)
        vertices, _ = steps
        if self._flat.curves and np.isnan(vertices[0, -1, 2]):
            return self._with_steps_of_segments(part, vertices)
        # the tree of the middle, with boxes around all steps; parts of triangles would mean nothing at other times
        made = self._build(part, replace(self._options, spatial_splits=False))
        self._spread(made, vertices)
        return made

    def over_time(self, mesh: MeshTree) -> list[MeshRanges]:
        """`MeshTree.over_time` of a tree whose vertices move, the finest with its nodes."""
        further = len(self._flat.motion.steps[mesh.part.mesh][0]) - 1
        room = NODES_OVER_TIME * COPY_BYTES[self.layout] * further * mesh.part.triangle_count
        room = min(room, free_memory(self._device) // 4)
        most = room // (mesh.nodes.size * VECTOR_BYTES)
        return worthwhile(mesh.as_ranges(), most, lambda count: self.in_ranges(mesh, count))

    def in_ranges(self, mesh: MeshTree, count: int) -> MeshRanges:
        """The nodes of a tree whose vertices move, for each of `count` ranges of time."""
        steps, _ = self._flat.motion.steps[mesh.part.mesh]
        positions, own = self._own(mesh.part)
        segments = self._flat.curves and bool(np.isnan(steps[0, -1, 2]))

        def between(first: float, last: float) -> tuple[list[np.ndarray], np.ndarray]:
            corners = vertices_between(steps, first, last)
            if not segments:
                return corners, own
            for mixed in (corners := [each.copy() for each in corners]):
                mixed[own[:, 2]] = positions[own[:, 2]]  # words, which are no positions
            boxed, triangles = stand_ins(positions, own, np.stack(corners))
            return [boxed], triangles

        blocks = mesh.triangles[: mesh.step_units * self.layout.triangle_words // 4]
        levels = None
        if self.layout is Layout.QUANTISED:
            levels = mesh.levels or self._levels(mesh)
            if mesh.nodes.device == self._device:  # else they are the host's, and the tree is uploaded next
                mesh.levels = levels
        return refitted_ranges(mesh.nodes, blocks, self.layout, levels, between, count)

    def _with_steps_of_segments(self, part: MeshPart, steps: np.ndarray) -> MeshTree:
        """A tree over segments alone, whose boxes hold them at all `steps`, shape [steps, vertex_count, 3]."""
        positions, own = self._own(part)
        made = self._build(part, self._options, stand_ins(positions, own, steps))
        made.step_units = made.triangles.size * 4 // self.layout.triangle_words
        blocks = made.triangles
        device = blocks.device
        joined = empty_vectors(blocks.size * len(steps), device)
        for i, positions in enumerate(steps):
            place_primitives(blocks, self.layout, positions, own)
            wp.copy(joined, blocks, dest_offset=i * blocks.size)
        made.triangles = joined
        return made

    def _spread(self, mesh: MeshTree, steps: np.ndarray) -> None:
        """Give `mesh` the triangles and boxes of all `steps` of its vertices, shape [steps, vertex_count, 3]."""
        part = mesh.part
        triangles = self._flat.triangles[part.triangle_first : part.triangle_first + part.triangle_count]
        device = mesh.nodes.device
        own = wp.array(triangles - np.int32(part.vertex_first), dtype=wp.vec3i, device=device)
        positions = [wp.array(each, dtype=wp.vec3, device=device) for each in steps]
        mesh.step_units = mesh.triangles.size * 4 // self.layout.triangle_words
        blocks = empty_vectors(mesh.triangles.size * len(steps), device)
        for i in range(len(steps)):
            wp.copy(blocks, mesh.triangles, dest_offset=i * mesh.triangles.size)
        mesh.triangles = blocks
        if self.layout is Layout.QUANTISED:
            result = refit_quantised(mesh.nodes, blocks, self._levels(mesh), positions, own)
        else:
            result = refit_boxes(mesh.nodes, blocks, positions, own)
        mesh.centre, mesh.box, mesh.sah = result.centre, result.box, result.sah

    def _build(
        self, part: MeshPart, options: BuildOptions, boxed: tuple[np.ndarray, np.ndarray] | None = None
    ) -> MeshTree:
        boxed = boxed or self._stand_ins(part)
        if self._on_device:
            made = self._on_device_built(part, boxed)
            return MeshTree(
                part=part,
                nodes=made.nodes,
                triangles=made.triangles,
                centre=made.centre,
                box=made.box,
                node_count=made.node_count,
                depth=made.depth,
                sah=made.sah,
                sah_built=made.sah,
                split=False,
                splits=False,
                level_first=made.level_first,
            )
        positions, triangles = boxed or (self._flat.positions, self._flat.triangles[part.span])
        options = replace(options, spatial_splits=False) if boxed else options
        wide = collapse_mesh(build_binary(positions, triangles, options), positions, triangles, self.layout)
        if boxed:
            own = self._flat.positions, self._flat.triangles[part.span]
            place_primitives(as_vectors(wide.triangles), self.layout, *own)
        return MeshTree(
            part=part,
            nodes=as_vectors(wide.nodes),
            triangles=as_vectors(wide.triangles),
            centre=wide.centre,
            box=wide.box,
            node_count=wide.node_count,
            depth=wide.depth,
            sah=wide.sah,
            sah_built=wide.sah,
            split=wide.reference_count > part.triangle_count,
            splits=options.spatial_splits,
            level_first=None,
        )

    def _stand_ins(self, part: MeshPart) -> tuple[np.ndarray, np.ndarray] | None:
        """What a tree with segments of curves is built over, numbered from the first vertex of the mesh; None for
        triangles alone.
        """
        return stand_ins(*self._own(part)) if self._flat.curves else None

    def _own(self, part: MeshPart) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the mesh, and its triangles among them."""
        positions = self._flat.positions[part.vertex_first : part.vertex_first + part.vertex_count]
        return positions, self._flat.triangles[part.span] - np.int32(part.vertex_first)

    def _on_device_built(self, part: MeshPart, boxed: tuple[np.ndarray, np.ndarray] | None) -> DeviceMesh:
        positions, triangles = self._geometry.positions, self._geometry.triangles
        if boxed is None:
            return build_mesh(positions, triangles, part.triangle_first, part.triangle_count)
        made = build_mesh(*self._uploaded(boxed), 0, part.triangle_count)
        place_primitives(made.triangles, self.layout, positions, triangles[part.span])
        return made

    def refit(self, mesh: MeshTree, moved: Sequence[tuple[int, int]] | None = None) -> bool:
        """Fit `mesh` in place to the frame's positions; False when it has become so bad that it should be built anew.

        Parts of triangles that were split for the old positions are lost, so such a tree must cost no more than it did.
        Boxes are joined of what stands in for segments of curves, which come into their places behind. Trees over
        vertices that move while the shutter is open are built anew. `moved`: first and count of the triangles that
        moved, among the tree's; None: maybe all.
        """
        if mesh.step_units:
            return False
        own = self._geometry.positions, self._geometry.triangles[mesh.part.span]
        boxed = self._stand_ins(mesh.part)
        positions, triangles = self._uploaded(boxed) if boxed else own
        if self.layout is Layout.QUANTISED:
            mesh.levels = mesh.levels or self._levels(mesh)
            result = refit_quantised(mesh.nodes, mesh.triangles, mesh.levels, positions, triangles)
        else:
            result = self._refit_boxes(mesh, positions, triangles, None if boxed else moved)
        if boxed:
            place_primitives(mesh.triangles, self.layout, *own)
        mesh.centre, mesh.box, mesh.sah, mesh.splits = result.centre, result.box, result.sah, False
        if result.sah > mesh.sah_built * (1.0 if mesh.split else SAH_GROWTH_MAX):
            return False
        mesh.sah_built = min(mesh.sah_built, result.sah)
        return True

    def _refit_boxes(
        self, mesh: MeshTree, positions: wp.array, triangles: wp.array, moved: Sequence[tuple[int, int]] | None
    ) -> RefitResult:
        """Refit a tree of BOXES: what is above triangles that moved, once its boxes are known."""
        nodes, groups = (
            to_numpy(array).reshape(-1, words)
            for array, words in ((mesh.nodes, self.layout.node_words), (mesh.triangles, self.layout.triangle_words))
        )
        whole, mesh.whole = mesh.whole, None
        if moved is not None and whole is not None:
            vertices = to_numpy(positions), to_numpy(triangles)
            result = refit_part(nodes, groups, mesh.centre, whole, moved, *vertices)
            if result is not None:
                mesh.whole = whole
                return result
        result = refit_boxes(mesh.nodes, mesh.triangles, positions, triangles)
        if moved is not None and is_part(moved, mesh.part.triangle_count):
            mesh.whole = WholeBoxes.of(result.boxes, result.costs, nodes, len(groups))
        return result

    def _uploaded(self, boxed: tuple[np.ndarray, np.ndarray]) -> tuple[wp.array, wp.array]:
        """Positions and triangles of stand-ins where the tree is."""
        positions, triangles = boxed
        return (
            wp.array(positions, dtype=wp.vec3, device=self._device),
            wp.array(triangles, dtype=wp.vec3i, device=self._device),
        )

    def _levels(self, mesh: MeshTree) -> NodeLevels:
        device = mesh.nodes.device  # the host's, until a tree that was built there is uploaded
        if mesh.level_first is None:
            words = to_numpy(mesh.nodes).view(self.layout.node_type).reshape(-1, self.layout.node_words)
            return node_levels(words, device)
        numbers = wp.empty(mesh.node_count, dtype=int, device=device)
        wp.utils.array_scan(wp.full(mesh.node_count, 1, dtype=int, device=device), numbers, inclusive=False)
        return NodeLevels(numbers, mesh.level_first)
