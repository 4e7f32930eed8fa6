"""Memory of a scene's geometry and trees, computed before it is allocated.

Figures are lower bounds but for those named MOST: what is refused here would not fit, what is not may still fail when
it is allocated.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass

import numpy as np
import warp as wp

from ..device.devices import free_memory, total_memory
from ..device.failures import check_device
from ..errors import OutOfMemoryError, SceneError
from ..scene.description import Mesh, Scene
from ..scene.geometry import CORNERS_MOST
from ..scene.linking import RAY_BITS
from .build.cuda.build import BYTES_EACH
from .node import Layout

# Triangles and vertices are counted in int32
TRIANGLES_MAX = VERTICES_MAX = 2**31 - 1
# [bytes]
ROW = 12  # a triangle's indices, or a position
NORMALS = 36  # of the corners of a triangle
INSTANCE = 60  # its map, mesh, first slot and a material
ENTRY = 84  # of the top level: a mesh tree's place, with the inverse map, and its number in a leaf
ENTRY_HOST = 260  # what is known of an entry, its box and its binary tree, while the top level is built
# Nodes of the top level for each entry: from above, and at least
TOP_BYTES_MOST = {Layout.BOXES: 96, Layout.QUANTISED: 40}
TOP_BYTES = {Layout.BOXES: 36, Layout.QUANTISED: 11}
# Nodes and triangles, for each triangle: from above, so that a budget holds them; and with full groups and leaves
TREE_BYTES_MOST = {Layout.BOXES: 90, Layout.QUANTISED: 64}
TREE_BYTES = {Layout.BOXES: 45, Layout.QUANTISED: 55}
COPY_BYTES = {Layout.BOXES: 40, Layout.QUANTISED: 48}  # of a triangle in a block
# The same in pages that are packed, and what pages take more by gaps and by segments of curves, about
PACKED_BYTES, PACKED_COPY_BYTES, PAGES_OVER = 25, 15, 1.2
# Nodes of a tree for ranges of time (`build/mesh_ranges.py`) take at most so many times the memory of its triangles at
# further steps
NODES_OVER_TIME = 2
BUILD_BYTES_HOST = 100  # records, lists and nodes of a binary tree, for each triangle (`cpu/build.py`)


@dataclass(frozen=True)
class GeometrySize:
    """Counts of what `flatten` would put together."""

    triangles: int
    vertices: int
    largest: int  # triangles of the largest mesh tree
    smooth: bool  # whether there are normals
    _: KW_ONLY
    curves: bool = False  # whether some triangles are segments of curves
    copies: int = 0  # of triangles, at further steps of vertices that move
    step_vertices: int = 0  # vertices of all these steps, which lie behind the others
    step_triangles: int = 0  # triangles likewise
    step_normals: int = 0  # triangles likewise, of those that have normals at each step
    instances: int = 0
    entries: int = 0  # instances with triangles, of meshes that are placed more than once

    @staticmethod
    def of(scene: Scene) -> GeometrySize:
        """The meshes that `scene` places."""
        instances = scene.instances
        counts = np.bincount(instances.mesh, minlength=len(scene.meshes))
        used = np.flatnonzero(counts)
        uses = counts[used]
        meshes = [scene.meshes[i] for i in used.tolist()]
        filled = [(mesh, count) for mesh, count in zip(meshes, uses.tolist(), strict=True) if len(mesh.triangles)]
        trees = [len(mesh.triangles) for mesh, count in filled if count > 1]
        once = np.flatnonzero(counts[instances.mesh] == 1)
        seen = dict(zip(instances.mesh[once].tolist(), (instances.visibility[once] & RAY_BITS).tolist(), strict=True))
        baked: dict[int, int] = {}  # those that are placed once share a tree where they are seen alike
        for i, mesh, count in zip(used.tolist(), meshes, uses.tolist(), strict=True):
            if count == 1:
                baked[seen[i]] = baked.get(seen[i], 0) + len(mesh.triangles)
        moving = [(mesh, len(mesh.motion)) for mesh, _ in filled if mesh.motion is not None]
        return GeometrySize(
            sum(len(mesh.triangles) for mesh, _ in filled),
            sum(_vertices_of(mesh) for mesh, _ in filled),
            max([0, *trees, *baked.values()]),
            any(mesh.corner_normals is not None for mesh, _ in filled),
            curves=any(mesh.radii is not None for mesh, _ in filled),
            copies=sum((steps - 1) * len(mesh.triangles) for mesh, steps in moving),
            step_vertices=sum(steps * _vertices_of(mesh) for mesh, steps in moving),
            step_triangles=sum(steps * len(mesh.triangles) for mesh, steps in moving),
            step_normals=sum(steps * len(mesh.triangles) for mesh, steps in moving if mesh.motion_normals is not None),
            instances=len(instances),
            entries=sum(count for _, count in filled if count > 1),
        )

    def step_bytes(self, layout: Layout) -> int:
        """Memory of `copies`, in blocks that are full [bytes]."""
        return COPY_BYTES[layout] * self.copies

    def tree_bytes_most(self, layout: Layout) -> int:
        """Trees and triangles, with copies, nodes for ranges of time, and the top level, from above [bytes]."""
        return self.mesh_bytes_most(layout) + (ENTRY + TOP_BYTES_MOST[layout]) * self.entries

    def mesh_bytes_most(self, layout: Layout) -> int:
        """The same without the top level [bytes]."""
        return TREE_BYTES_MOST[layout] * self.triangles + (1 + NODES_OVER_TIME) * self.step_bytes(layout)

    def tree_bytes(self, layout: Layout) -> int:
        """Trees, triangles and the top level at least, without copies [bytes]."""
        return TREE_BYTES[layout] * self.triangles + (ENTRY + TOP_BYTES[layout]) * self.entries

    def arrays(self) -> int:
        """Geometry and instances, without trees [bytes]."""
        meshes = ROW * (self.triangles + self.vertices) + NORMALS * self.smooth * self.triangles
        return meshes + INSTANCE * self.instances

    def needed(self, layout: Layout, device: wp.Device) -> int:
        """Geometry and trees on `device`, the build included [bytes]."""
        build = BYTES_EACH if device.is_cuda else BUILD_BYTES_HOST
        trees = self.tree_bytes(layout) + self.step_bytes(layout)
        # the top level is built when the trees of meshes are there
        top = (BYTES_EACH if device.is_cuda else ENTRY_HOST) * self.entries
        # the CPU holds the geometry of the host and that of the device
        return self.arrays() * (1 if device.is_cuda else 2) + max(trees + top, build * self.largest)

    def beside_budget(self, device: wp.Device) -> int:
        """What the instances take on `device` beside `geometry_budget`, where trees lie behind it [bytes]."""
        return INSTANCE * self.instances + (0 if device.is_cuda else ENTRY_HOST) * self.entries

    def needed_paged(self, layout: Layout, device: wp.Device, budget: int) -> int:
        """All that is on `device` where trees lie behind it, of which `budget` may be there [bytes]."""
        return min(budget, self.tree_bytes(layout)) + self.beside_budget(device)


def _vertices_of(mesh: Mesh) -> int:
    """Vertices of `mesh`, with those that segments of curves are packed into."""
    return len(mesh.positions) + len(mesh.triangles) * (mesh.radii is not None)


def check_counts(size: GeometrySize, paged: bool = False, corners: bool = False) -> None:
    """Raise `SceneError` for more than indices can name. `paged`: trees are built part by part, so that nothing of the
    geometry lists the corners of all triangles, but for normals where there are some; `corners`: as for `with_motion`.
    """
    cure, steps = "instances of one mesh in place of copies", " at all steps of motion blur"
    at_steps = max(size.step_normals, corners * size.step_triangles)
    most = TRIANGLES_MAX if paged and not size.smooth else CORNERS_MOST
    if paged and size.smooth:
        cure += ", or flat shading"
    elif not paged:
        cure += ", or a geometry_budget below what they take"
    for count, at_most, what, other in (
        (size.triangles, most, "triangles", cure),
        (size.vertices, VERTICES_MAX, "vertices", cure),
        (at_steps and size.triangles + at_steps, CORNERS_MOST, f"triangles{steps}", "fewer steps"),
        (size.vertices + size.step_vertices, VERTICES_MAX, f"vertices{steps}", "fewer steps"),
    ):
        if count > at_most:
            raise SceneError(
                f"the scene's meshes have {count:,} {what}, and a scene holds {at_most:,}; use fewer, or {other}"
            )


def check_memory(
    size: GeometrySize, layout: Layout, device: wp.Device, all_of_it: bool, budget: int | None = None
) -> None:
    """Raise `OutOfMemoryError` where `device` has not so much memory: free, or with `all_of_it` at all. `budget`: of
    trees on the device, where the rest of them lies behind it.
    """
    needed = size.needed(layout, device) if budget is None else size.needed_paged(layout, device, budget)
    there = (total_memory(device) or needed) if all_of_it else free_memory(device)
    if needed > there:
        check_device(device)
        figure = f"{_gigabytes(there)} {'in all' if all_of_it else 'free'}"
        raise _out_of_memory(size, needed, device, figure, budget)


@contextlib.contextmanager
def explained_memory_errors(
    size: GeometrySize, layout: Layout, device: wp.Device, budget: int | None = None
) -> Iterator[None]:
    """Inside, an allocation that fails, here or on `device`, becomes an `OutOfMemoryError` with the figures; `budget`
    as for `check_memory`.
    """
    try:
        yield
    except OutOfMemoryError:
        raise
    except (MemoryError, RuntimeError) as error:
        # Warp has no class of its own for it
        if isinstance(error, RuntimeError) and not str(error).startswith("Failed to allocate"):
            raise
        check_device(device)
        needed = size.needed(layout, device) if budget is None else size.needed_paged(layout, device, budget)
        figure = f"{_gigabytes(free_memory(device))} free"
        raise _out_of_memory(size, needed, device, figure, budget) from error


def _out_of_memory(
    size: GeometrySize, needed: int, device: wp.Device, there: str, budget: int | None
) -> OutOfMemoryError:
    what, cure = f"{size.triangles:,} triangles", "triangles, instances in place of copies,"
    if size.instances > size.triangles:
        what, cure = f"{size.instances:,} instances", "instances"
    trees = "with their trees"
    if budget is not None:
        trees, cure = f"with a geometry budget of {_gigabytes(budget)}", f"{cure.rstrip(',')}, a smaller budget"
    return OutOfMemoryError(
        f"the scene's {what} need at least {_gigabytes(needed)} {trees}, and {device.alias} has {there}; "
        f"use fewer {cure} or a device with more memory"
    )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB"
