"""Scenes of BOXES on the CPU, kernels that trace them, and their hits by brute force."""

import functools
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.build.collapse import collapse_entries, collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary, build_binary_from_boxes
from raybatch_addon.core.bvh.build.encode import as_vectors
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.bvh.node import BOXES_NODE, Layout, aligned_empty
from raybatch_addon.core.bvh.traverse.counts import NO_COUNTS, TraceCounts
from raybatch_addon.core.bvh.traverse.cpu import make_cpu_traversal
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import DeviceRayList, Rays
from raybatch_addon.core.scene.geometry import mat34
from raybatch_addon.core.wavefront.rays import allocate_rays
from tests.support.wide_trees import needles, soup, sphere
from tests.twins.watertight import intersect_float32

EYE = np.eye(3, 4)
SPLIT = BuildOptions(spatial_splits=True)
INTERLEAVES = (1, 4, 16)


@dataclass
class Entry:
    """A mesh in its place, or several baked into one."""

    positions: np.ndarray
    triangles: np.ndarray
    instance: int = 0
    merged: tuple[tuple[int, int], ...] = ()  # instances and how many triangles each has
    to_world: np.ndarray = field(default_factory=lambda: EYE)
    visibility: int = -1

    def owners(self) -> tuple[np.ndarray, np.ndarray]:
        """Instance and primitive of each triangle."""
        parts = self.merged or ((self.instance, len(self.triangles)),)
        return np.concatenate([np.full(n, i) for i, n in parts]), np.concatenate([np.arange(n) for _, n in parts])


@dataclass
class Scene:
    """A tree with what it was made from."""

    tree: Tree
    entries: list[Entry]
    from_world: np.ndarray
    keep: list


def make_scene(
    entries: list[Entry], instancing: bool, options: BuildOptions = BuildOptions(), shuffle: int = 0
) -> Scene:
    """The trees of `entries`; `shuffle` puts the children of every node into another order."""
    meshes = [
        collapse_mesh(build_binary(e.positions, e.triangles, options), e.positions, e.triangles, Layout.BOXES)
        for e in entries
    ]
    blocks = [m.nodes for m in meshes]
    to_world = np.array([e.to_world for e in entries], np.float64).reshape(-1, 3, 4)
    inverse = np.linalg.inv(to_world[:, :, :3])
    from_world = np.concatenate([inverse, -inverse @ to_world[:, :, 3:]], 2).astype(np.float32)
    tree = Tree()
    tree.entry_count = len(entries)
    tree.top_node = sum(m.node_count for m in meshes)
    if instancing:
        # generous: some more than the error of carrying a ray to object space
        corners = np.array(
            [[[m.box[i, 0], m.box[j, 1], m.box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)] for m in meshes],
            np.float64,
        )
        world = np.einsum("eij,ecj->eci", to_world[:, :, :3], corners) + to_world[:, None, :, 3]
        reach = np.abs(world).max() * 1e-4
        low, high = (world.min(1) - reach).astype(np.float32), (world.max(1) + reach).astype(np.float32)
        top = collapse_entries(build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=4)), Layout.BOXES)
        blocks.append(top.nodes)
        tree.top_entry = wp.array(top.order, dtype=int, device="cpu")
        tree.top_centre = wp.vec3(*top.centre.tolist())
        tree.top_margin = 64 * SLAB_MARGIN

    def joined(parts: list[np.ndarray], words: int) -> np.ndarray:
        whole = aligned_empty((sum(len(p) for p in parts), words), np.float32)
        np.concatenate([p.view(np.float32).reshape(-1, words) for p in parts], out=whole) if parts else None
        return whole

    nodes, triangles = joined(blocks, 64), joined([m.triangles for m in meshes], 80)
    if shuffle:
        order = np.random.default_rng(shuffle).permuted(np.tile(np.arange(8), (len(nodes), 1)), axis=1)
        fields = nodes.view(BOXES_NODE)[:, 0]
        fields["planes"] = np.take_along_axis(fields["planes"], order[:, None, None], -1)
        fields["child"] = np.take_along_axis(fields["child"], order, -1)

    def upload(values, dtype, shape=(-1,)):
        return wp.array(
            np.array(values, np.int32 if dtype is int else np.float32).reshape(shape), dtype=dtype, device="cpu"
        )

    tree.nodes, tree.triangles = as_vectors(nodes), as_vectors(triangles)
    tree.entry_node = upload(np.cumsum([0] + [m.node_count for m in meshes])[:-1], int)
    tree.entry_triangle = upload(np.cumsum([0] + [len(m.triangles) for m in meshes])[:-1], int)
    tree.entry_centre = upload([m.centre for m in meshes], wp.vec3, (-1, 3))
    tree.entry_from_world = upload(from_world, mat34, (-1, 3, 4))
    tree.entry_instance = upload([-1 if e.merged else e.instance for e in entries], int)
    tree.entry_visibility = upload([e.visibility for e in entries], int)
    tree.merged_first = upload(np.cumsum([0] + [len(e.merged) for e in entries]), int)
    tree.merged_instance = upload([i for e in entries for i, _ in e.merged], int)
    tree.merged_triangle_first = upload(
        [f for e in entries for f in np.cumsum([0] + [n for _, n in e.merged])[:-1][: len(e.merged)]], int
    )
    return Scene(tree, entries, from_world, [nodes, triangles])


def scene_of(
    positions: np.ndarray, triangles: np.ndarray, options: BuildOptions = BuildOptions(), shuffle: int = 0
) -> Scene:
    return make_scene([Entry(positions, triangles)], False, options, shuffle)


@functools.cache
def trace_kernel(any_hit: bool, instancing: bool, interleave: int, counters: bool = False) -> wp.Kernel:
    trace = make_cpu_traversal(
        TraceOptions(any_hit=any_hit, instancing=instancing, interleave=interleave, counters=counters)
    )

    @wp.kernel(**KERNEL_OPTIONS)
    def kernel(tree: Tree, rays: Rays, listed: DeviceRayList, first: int, end: int, counts: TraceCounts):
        trace(tree, rays, listed, first, end, counts)

    return kernel


def list_of(slots) -> DeviceRayList:
    listed = DeviceRayList()
    listed.slots = wp.array(slots, dtype=int, device="cpu")
    return listed


@dataclass
class Hits:
    """One row a ray."""

    t: np.ndarray
    instance: np.ndarray
    primitive: np.ndarray
    uv: np.ndarray

    def check_same(self, other: "Hits") -> None:
        """Equal to the bit."""
        assert np.array_equal(self.instance, other.instance)
        hit = self.instance >= 0
        assert hit.any()
        for name in ("t", "primitive", "uv"):
            assert np.array_equal(getattr(self, name)[hit], getattr(other, name)[hit]), name


def fill_rays(origin, direction, t_max=np.inf, visibility=1) -> Rays:
    count = len(origin)
    rays = allocate_rays(count, wp.get_device("cpu"))
    rays.origin.assign(np.asarray(origin, np.float32))
    rays.direction.assign(np.asarray(direction, np.float32))
    rays.t_max.assign(np.broadcast_to(np.float32(t_max), count))
    rays.visibility.assign(np.broadcast_to(np.int32(visibility), count))
    rays.hit_instance.fill_(-7)
    return rays


def trace(
    scene: Scene,
    origin,
    direction,
    t_max=np.inf,
    visibility=1,
    instancing=False,
    interleave=16,
    any_hit=False,
    slots=None,
) -> Hits:
    """Hits of all rays, or of those of `slots` alone (in the order of the rays)."""
    rays = fill_rays(origin, direction, t_max, visibility)
    listed = np.arange(len(origin)) if slots is None else slots
    wp.launch(
        trace_kernel(any_hit, instancing, interleave),
        1,
        [scene.tree, rays, list_of(listed), 0, len(listed), NO_COUNTS],
        device="cpu",
    )
    return Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


def brute_force(scene: Scene, origin, direction, t_max=np.inf, visibility=1) -> Hits:
    """The least (t, instance, primitive) over all triangles."""
    origin, direction = np.asarray(origin, np.float32), np.asarray(direction, np.float32)
    count = len(origin)
    t_max, visibility = np.broadcast_to(np.float32(t_max), count), np.broadcast_to(visibility, count)
    out = Hits(np.zeros(count, np.float32), np.full(count, -1), np.full(count, -1), np.zeros((count, 2), np.float32))
    for entry, matrix in zip(scene.entries, scene.from_world):
        o, d = origin, direction
        if not np.array_equal(matrix, EYE):
            products = matrix[None, :, :3] * o[:, None]
            o = products[..., 0] + products[..., 1] + products[..., 2] + matrix[:, 3]
            products = matrix[None, :, :3] * d[:, None]
            d = products[..., 0] + products[..., 1] + products[..., 2]
        owners = entry.owners()
        corners = entry.positions[entry.triangles]
        seen = np.flatnonzero(entry.visibility & visibility)
        for i in np.array_split(seen, max(1, len(seen) * len(corners) // 100_000)):
            ray, face = (x.ravel() for x in np.meshgrid(i, np.arange(len(corners)), indexing="ij"))
            hit, t, v, w = intersect_float32(o[ray], d[ray], corners[face, 0], corners[face, 1], corners[face, 2])
            found = np.flatnonzero(hit & (t < t_max[ray]))
            found = found[np.lexsort((owners[1][face[found]], owners[0][face[found]], t[found], ray[found]))]
            for k in found[np.unique(ray[found], return_index=True)[1]]:
                r, instance, primitive = ray[k], owners[0][face[k]], owners[1][face[k]]
                if out.instance[r] < 0 or (t[k], instance, primitive) < (out.t[r], out.instance[r], out.primitive[r]):
                    out.t[r], out.instance[r], out.primitive[r], out.uv[r] = t[k], instance, primitive, (v[k], w[k])
    return out


def random_rays(count: int, seed: int = 1, size: float = 1.0, centre=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Rays from in and around a cube, a third of them with directions along axes or in planes of them."""
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-size, size, (count, 3)) + np.asarray(centre)
    direction = rng.normal(size=(count, 3))
    direction[: count // 6, 1:] = 0.0
    direction[count // 6 : count // 3, 2] = -0.0
    direction = direction[rng.permutation(count)][:, rng.permutation(3)]
    return origin.astype(np.float32), (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)


def aimed_rays(positions, triangles, count: int, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Rays at vertices, at points of edges, and from surfaces."""
    rng = np.random.default_rng(seed)
    corners = positions[triangles].astype(np.float64)
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    weights = rng.dirichlet((1, 1, 1), count)
    weights[: count // 3] = np.eye(3)[rng.integers(3, size=count // 3)]  # vertices
    weights[count // 3 : 2 * count // 3, 0] = 0.0  # edges
    weights /= weights.sum(1, keepdims=True)
    target = np.einsum("nc,nck->nk", weights, corners[rng.integers(len(corners), size=count)])
    origin = target + extent * rng.normal(size=(count, 3))
    origin[-count // 6 :] = target[rng.permutation(count)][-count // 6 :]
    origin = origin.astype(np.float32)
    direction = target - origin
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 0, direction / np.where(length > 0, length, 1), (0, 0, 1))
    return origin, direction.astype(np.float32)


def both_rays(positions, triangles, count: int) -> tuple[np.ndarray, np.ndarray]:
    middle = (positions.min(0).astype(np.float64) + positions.max(0)) / 2
    size = np.ptp(positions.astype(np.float64), axis=0).max()
    a, b = random_rays(count // 2, 1, size, middle), aimed_rays(positions, triangles, count // 2)
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]])


def slivers(count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Triangles a million times as long as they are wide."""
    rng = np.random.default_rng(5)
    start, along, aside = (
        rng.uniform(-1, 1, (count, 3)),
        rng.normal(size=(count, 3)),
        1e-6 * rng.normal(size=(count, 3)),
    )
    return np.stack([start, start + along, start + 0.5 * along + aside], 1).reshape(-1, 3).astype(
        np.float32
    ), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def scaled(mesh, scale: float, offset=0.0) -> tuple[np.ndarray, np.ndarray]:
    return (mesh[0].astype(np.float64) * scale + offset).astype(np.float32), mesh[1]


def copies(mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    return mesh[0], np.tile(mesh[1], (count, 1))


MESHES = {
    "one": lambda: soup(1),
    "soup": lambda: soup(600),
    "sphere": lambda: sphere(12),
    "needles": lambda: needles(200),
    "slivers": slivers,
    "far": lambda: scaled(sphere(10), 1.0, (1e4, -2e4, 3e3)),
    "tiny": lambda: scaled(sphere(10), 1e-18),
    "huge": lambda: scaled(sphere(10), 5e17),
    "copies": lambda: copies(soup(40, size=0.4), 20),
    "flat": lambda: scaled(soup(300, size=0.3), np.array([1.0, 1.0, 0.0])),
}


def turned(angle: float, scale, offset) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) * scale, offset])


def instanced_entries() -> list[Entry]:
    rng = np.random.default_rng(8)
    ball, parts = sphere(6), [soup(80, 1), soup(50, 2), soup(30, 3)]
    positions = np.concatenate([p for p, _ in parts])
    first = np.cumsum([0] + [len(p) for p, _ in parts])
    triangles = np.concatenate([t + f for (_, t), f in zip(parts, first)])
    entries = [Entry(positions, triangles, merged=((2, 80), (5, 50), (40, 30)))]
    for i in range(30):
        matrix = turned(rng.uniform(0, 6), rng.uniform(0.1, 0.4, (1, 3)), rng.uniform(-1, 1, 3))
        entries.append(Entry(*ball, instance=6 + i, to_world=matrix, visibility=1 + i % 3))
    # several in the same place: the lowest instance wins
    entries += [Entry(*ball, instance=i, to_world=entries[7].to_world, visibility=3) for i in (4, 39, 3)]
    return entries
