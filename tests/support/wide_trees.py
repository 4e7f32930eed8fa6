"""Meshes to build trees of, and what must hold for every wide tree."""

from dataclasses import replace

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.build.collapse import BOXES_COST, QUANTISED_COST, CollapseCost, collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary
from raybatch_addon.core.bvh.build.encode import as_vectors
from raybatch_addon.core.bvh.build.refit import node_levels, refit_boxes, refit_quantised
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.bvh.node import (
    QUANTISED_TRIANGLE,
    Layout,
    WideMesh,
    aligned_empty,
    decode_children,
    triangle_faces,
)
from tests.twins.tree_walk import Walk, triangle_corners, walk_tree

OPTIONS = {Layout.BOXES: BuildOptions(), Layout.QUANTISED: BuildOptions(leaf_group=1, leaf_max=3)}


def sphere(rings: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere of 4 rings (rings - 1) triangles."""
    around = 2 * rings
    polar = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    ring = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar) + 0 * angle], -1)
    positions = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i, j = np.meshgrid(np.arange(rings - 2), np.arange(around), indexing="ij")
    a, b = (i * around + j).ravel(), (i * around + (j + 1) % around).ravel()
    c, d = a + around, b + around
    top, j = len(positions) - 2, np.arange(around)
    next_j, last = (j + 1) % around, (rings - 2) * around
    caps = [np.stack([j, next_j, 0 * j + top], 1), np.stack([last + next_j, last + j, 0 * j + top + 1], 1)]
    triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1), *caps])
    return (radius * positions).astype(np.float32), triangles.astype(np.int32)


def soup(count: int, seed: int = 0, size: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Separate triangles in a unit cube."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-0.5, 0.5, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))
    return positions.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def needles(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Long thin triangles in all directions, which spatial splits cut."""
    rng = np.random.default_rng(seed)
    start, along, aside = (
        rng.uniform(-1, 1, (count, 3)),
        rng.normal(size=(count, 3)),
        0.01 * rng.normal(size=(count, 3)),
    )
    positions = np.stack([start, start + along, start + aside], 1)
    return positions.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def wide(positions: np.ndarray, triangles: np.ndarray, layout: Layout) -> WideMesh:
    """The tree of a mesh as the core makes it."""
    return collapse_mesh(build_binary(positions, triangles, OPTIONS[layout]), positions, triangles, layout)


def refit_mesh(
    mesh: WideMesh, positions: np.ndarray, triangles: np.ndarray, cost: CollapseCost | None = None
) -> WideMesh:
    """The tree `mesh` for new positions, on the CPU; `mesh` stays as it is.

    Args:
        mesh: tree of either layout.
        positions: new vertices, float32, shape [v, 3].
        triangles: the mesh's triangles as when the tree was built, int32, shape [m, 3].
        cost: weights for `sah`; those of the collapse by default.
    """
    nodes, blocks = _copy(mesh.nodes), _copy(mesh.triangles)
    vertices = (
        wp.array(positions, dtype=wp.vec3, device="cpu", copy=False),
        wp.array(triangles, dtype=wp.vec3i, device="cpu", copy=False),
    )
    if mesh.layout is Layout.QUANTISED:
        levels = node_levels(mesh.nodes, "cpu")
        result = refit_quantised(as_vectors(nodes), as_vectors(blocks), levels, *vertices, cost or QUANTISED_COST)
    else:
        result = refit_boxes(as_vectors(nodes), as_vectors(blocks), *vertices, cost or BOXES_COST)
    return replace(mesh, nodes=nodes, triangles=blocks, centre=result.centre, box=result.box, sah=result.sah)


def _copy(array: np.ndarray) -> np.ndarray:
    copy = aligned_empty(array.shape, array.dtype.type)
    copy[:] = array
    return copy


def whole_boxes(mesh: WideMesh) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of the whole triangles below each child, relative to the centre, float64, shape [n, 8, 3]; inverted where
    there is none.
    """
    children = decode_children(mesh.layout, mesh.nodes)
    corners = triangle_corners(mesh.layout, mesh.triangles).astype(np.float64) - mesh.centre.astype(np.float64)
    there = (triangle_faces(mesh.layout, mesh.triangles) >= 0)[..., None, None]
    axes = tuple(range(1, corners.ndim - 1))
    block_low, block_high = np.where(there, corners, np.inf).min(axes), np.where(there, corners, -np.inf).max(axes)
    low, high = np.full((mesh.node_count, 8, 3), np.inf), np.full((mesh.node_count, 8, 3), -np.inf)
    for offset in range(int(children.count.max())):
        node, slot = np.nonzero(children.count > offset)
        block = children.first[node, slot] + offset
        low[node, slot] = np.minimum(low[node, slot], block_low[block])
        high[node, slot] = np.maximum(high[node, slot], block_high[block])
    for i in range(mesh.node_count - 1, -1, -1):  # nodes come after those that hold them
        for s in np.flatnonzero(children.inner[i] >= 0):
            low[i, s], high[i, s] = low[children.inner[i, s]].min(0), high[children.inner[i, s]].max(0)
    return low, high


def node_margins(mesh: WideMesh) -> np.ndarray:
    """By how much the child boxes of each node must be grown, float64, shape [n]."""
    low, high = whole_boxes(mesh)
    return SLAB_MARGIN * np.maximum(-low.min((1, 2)), high.max((1, 2))).clip(0)


def check_blocks(mesh: WideMesh, positions: np.ndarray, triangles: np.ndarray) -> Walk:
    """Encodings, order and contents of the blocks, whatever the boxes."""
    walk = walk_tree(mesh.layout, mesh.nodes)
    assert mesh.nodes.ctypes.data % 64 == 0 and mesh.triangles.ctypes.data % 64 == 0
    assert walk.depth.max() + 1 == mesh.depth and len(walk.leaf_node) == mesh.leaf_count
    order = np.argsort(walk.leaf_first)
    ends = np.cumsum(walk.leaf_count[order])
    assert ends[-1] == len(mesh.triangles) and (walk.leaf_first[order] == ends - walk.leaf_count[order]).all()

    faces, corners = triangle_faces(mesh.layout, mesh.triangles), triangle_corners(mesh.layout, mesh.triangles)
    assert np.array_equal(corners[faces >= 0], positions[triangles[faces[faces >= 0]]])
    assert not corners[faces < 0].any()
    assert (faces >= 0).sum() == mesh.reference_count
    seen = np.bincount(faces[faces >= 0], minlength=mesh.triangle_count)
    assert len(seen) == mesh.triangle_count and (seen >= 1).all()
    children = decode_children(mesh.layout, mesh.nodes)
    if mesh.layout is Layout.BOXES:
        # depth first: the children of a node follow it, each after what is below the one before
        for i in range(mesh.node_count):
            inner = children.inner[i][children.inner[i] >= 0]
            assert len(inner) == 0 or inner[0] == i + 1
            assert (np.diff(inner) > 0).all()
        leaf_order = np.lexsort((walk.leaf_slot, walk.leaf_node))
        assert (np.diff(walk.leaf_first[leaf_order]) > 0).all()
        assert (walk.leaf_count == 1).all()
    else:
        fields = mesh.triangles.view(QUANTISED_TRIANGLE)
        assert not fields["spare_b"].any() and not fields["spare_c"].any()
    return walk


def check_whole(mesh: WideMesh, positions: np.ndarray, triangles: np.ndarray, once: bool = True) -> None:
    """A tree whose boxes hold whole triangles: each `once`, and the boxes grown by their margin."""
    check_blocks(mesh, positions, triangles)
    faces = triangle_faces(mesh.layout, mesh.triangles)
    assert not once or (np.bincount(faces[faces >= 0]) == 1).all()
    children = decode_children(mesh.layout, mesh.nodes)
    low, high = whole_boxes(mesh)
    margin = node_margins(mesh)[:, None, None]
    assert (children.low <= low - margin).all() and (children.high >= high + margin).all()
    used = positions[triangles.ravel()]
    assert np.array_equal(mesh.box, [used.min(0), used.max(0)])


def check_parts(mesh: WideMesh, positions: np.ndarray, triangles: np.ndarray, samples: int = 50) -> None:
    """A tree that may have split triangles: each of their points is met in a leaf that lists it, through boxes with
    their margins.
    """
    walk = check_blocks(mesh, positions, triangles)
    children = decode_children(mesh.layout, mesh.nodes)
    margin = node_margins(mesh)
    low, high = children.low + margin[:, None, None], children.high - margin[:, None, None]
    # what remains of the way to each node when every box loses its margin
    node_low, node_high = np.full((mesh.node_count, 3), -np.inf), np.full((mesh.node_count, 3), np.inf)
    for i in range(mesh.node_count):
        low[i], high[i] = np.maximum(low[i], node_low[i]), np.minimum(high[i], node_high[i])
        for s in np.flatnonzero(children.inner[i] >= 0):
            node_low[children.inner[i, s]], node_high[children.inner[i, s]] = low[i, s], high[i, s]
    weights = np.random.default_rng(0).dirichlet((0.7, 0.7, 0.7), samples)
    points = np.einsum("sc,tck->tsk", weights, positions[triangles].astype(np.float64)) - mesh.centre.astype(np.float64)
    low, high = low - 1e-14 * np.abs(positions).max(), high + 1e-14 * np.abs(positions).max()  # the points are rounded
    met = np.zeros(points.shape[:2], bool)
    faces = triangle_faces(mesh.layout, mesh.triangles).reshape(len(mesh.triangles), -1)
    for node, slot, first, count in zip(walk.leaf_node, walk.leaf_slot, walk.leaf_first, walk.leaf_count):
        listed = faces[first : first + count]
        for face in listed[listed >= 0]:
            met[face] |= ((points[face] >= low[node, slot]) & (points[face] <= high[node, slot])).all(-1)
    assert met.all()
