"""Triangles of a mesh where a device reads them, and kernels that find their boxes, their cells of a grid, and lists of
them by the labels of cells.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....scene.geometry import readable


@wp.struct
class MeshTriangles:
    """Triangles of a mesh, where a device can read them."""

    positions: wp.array(dtype=wp.vec3)  # [m]; not looked at where there are `corners`
    triangles: wp.array(dtype=wp.vec3i)  # indices into `positions` of all meshes
    corners: wp.array(dtype=wp.vec3)  # [m], of one triangle after another; or empty
    first: int  # first triangle of the mesh


@wp.struct
class CellGrid:
    """The grid of cells, as `Grid` of `partition.py`; triangles whose boxes have longer edges have a cell behind all
    others.
    """

    low: wp.vec3
    scale: wp.vec3
    shape: wp.vec3i
    long_edge: float


@wp.func
def mesh_corner(mesh: MeshTriangles, triangle: int, k: int) -> wp.vec3:
    """Corner `k` of triangle number `triangle` of the mesh."""
    i = mesh.first + triangle
    if mesh.corners.shape[0] > 0:
        return mesh.corners[3 * i + k]
    return mesh.positions[mesh.triangles[i][k]]


@wp.func
def triangle_box(mesh: MeshTriangles, triangle: int) -> tuple[wp.vec3, wp.vec3]:
    """Least and greatest corner of a triangle's box."""
    a, b, c = mesh_corner(mesh, triangle, 0), mesh_corner(mesh, triangle, 1), mesh_corner(mesh, triangle, 2)
    return wp.min(wp.min(a, b), c), wp.max(wp.max(a, b), c)


@wp.func
def number_at(numbers: wp.array(dtype=int), start: int, i: int) -> int:
    """The triangle at `start + i`: of `numbers`, or of all where it is empty."""
    if numbers.shape[0] == 0:
        return start + i
    return numbers[start + i]


@wp.func
def cell_of(mesh: MeshTriangles, grid: CellGrid, triangle: int) -> int:
    """The cell of a triangle."""
    low, high = triangle_box(mesh, triangle)
    extent = high - low
    if wp.max(wp.max(extent[0], extent[1]), extent[2]) > grid.long_edge:
        return grid.shape[0] * grid.shape[1] * grid.shape[2]
    place = wp.cw_mul(low + high - grid.low, grid.scale)
    cell = int(0)
    for axis in range(3):
        cell = cell * grid.shape[axis] + wp.clamp(int(place[axis]), 0, grid.shape[axis] - 1)
    return cell


@wp.kernel(**KERNEL_OPTIONS)
def middle_bounds_kernel(
    mesh: MeshTriangles,
    numbers: wp.array(dtype=int),
    start: int,
    count: int,
    lanes: int,
    bounds: wp.array2d(dtype=wp.vec3),
):
    """Row `lane` of `bounds`: least and greatest of twice the middles of boxes, of every `lanes`-th triangle."""
    lane = wp.tid()
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    for i in range(lane, count, lanes):
        first, last = triangle_box(mesh, number_at(numbers, start, i))
        low, high = wp.min(low, first + last), wp.max(high, first + last)
    bounds[lane, 0] = low
    bounds[lane, 1] = high


@wp.kernel(**KERNEL_OPTIONS)
def cells_kernel(
    mesh: MeshTriangles,
    grid: CellGrid,
    numbers: wp.array(dtype=int),
    start: int,
    cells: wp.array(dtype=int),
    held: wp.array(dtype=int),
):
    """The cell of each triangle from `start` on, where `cells` has room, and how many triangles cells hold."""
    i = wp.tid()
    cell = cell_of(mesh, grid, number_at(numbers, start, i))
    if cells.shape[0] > 0:
        cells[start + i] = cell
    wp.atomic_add(held, cell, 1)


@wp.kernel(**KERNEL_OPTIONS)
def count_labels_kernel(
    labels: wp.array(dtype=int), cells: wp.array(dtype=int), start: int, counts: wp.array(dtype=int)
):
    """How many triangles from `start` on have each label (on the CPU)."""
    wp.atomic_add(counts, labels[cells[start + wp.tid()]], 1)


@wp.kernel(**KERNEL_OPTIONS)
def scatter_kernel(
    labels: wp.array(dtype=int),
    cells: wp.array(dtype=int),
    numbers: wp.array(dtype=int),
    start: int,
    ends: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Triangles from `start` on behind those with their labels (on the CPU, where one comes after another)."""
    i = wp.tid()
    order[wp.atomic_add(ends, labels[cells[start + i]], 1)] = number_at(numbers, start, i)


@wp.kernel(**KERNEL_OPTIONS)
def labels_kernel(
    mesh: MeshTriangles,
    grid: CellGrid,
    labels: wp.array(dtype=int),
    numbers: wp.array(dtype=int),
    start: int,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Labels as keys of a sort, and the triangles that have them."""
    i = wp.tid()
    triangle = number_at(numbers, start, i)
    keys[i] = labels[cell_of(mesh, grid, triangle)]
    order[i] = triangle


def mesh_triangles(
    positions: np.ndarray, triangles: np.ndarray, device: wp.Device, corners: wp.array | None = None
) -> MeshTriangles:
    """All triangles where `device` reads them: on CUDA in host memory, locked as long as this lives.

    Args:
        positions: [m], float32 [v, 3].
        triangles: int32 [n, 3], indices into them.
        corners: their corners, wp.vec3 [3 n], which `device` reads faster, if there are any.
    """
    mesh = MeshTriangles()
    mesh.corners = wp.empty(0, dtype=wp.vec3, device=device) if corners is None else corners
    mesh.positions = readable(positions if corners is None else positions[:0], wp.vec3, device)
    mesh.triangles = readable(triangles, wp.vec3i, device)
    return mesh


def mesh_from(every: MeshTriangles, first: int) -> MeshTriangles:
    """The mesh whose first triangle is number `first` of `every`."""
    mesh = MeshTriangles()
    mesh.positions, mesh.triangles, mesh.corners, mesh.first = every.positions, every.triangles, every.corners, first
    return mesh
