"""Scenes of quantised trees, kernels that trace them, and their hits by brute force."""

import dataclasses
import functools

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.build.collapse import collapse_entries, collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary, build_binary_from_boxes
from raybatch_addon.core.bvh.build.cuda.build import build_mesh, build_top
from raybatch_addon.core.bvh.intersect import EDGE_TINY
from raybatch_addon.core.bvh.margin import DIRECTION_LEAST, SLAB_MARGIN
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import NO_COUNTS, TraceCounts
from raybatch_addon.core.bvh.traverse.cuda import thread_count, trace_function
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native.build import native_source
from raybatch_addon.core.rays import DeviceRayList, RayList, Rays, fill_list
from raybatch_addon.core.scene.geometry import mat34, transform_point, transform_vector
from raybatch_addon.core.settings.device import TRACE_BLOCK_SIZE
from raybatch_addon.core.wavefront.rays import allocate_rays
from tests.support.under_test import BLOCK_DIM
from tests.support.wide_trees import soup, sphere

CLOSEST = TraceOptions(any_hit=False, instancing=False)
ANY = TraceOptions(any_hit=True, instancing=False)
WHOLE = BuildOptions(leaf_group=1, leaf_max=3)


@dataclasses.dataclass
class Hits:
    """Hits that came back, one row a ray."""

    t: np.ndarray
    instance: np.ndarray
    primitive: np.ndarray
    uv: np.ndarray

    def check_same(self, other) -> None:
        """Equal to the bit; of misses only that they are."""
        assert np.array_equal(self.instance, other.instance)
        hit = self.instance >= 0
        assert hit.any()
        for name in ("t", "primitive", "uv"):
            assert np.array_equal(
                getattr(self, name)[hit].view(np.uint32), getattr(other, name)[hit].view(np.uint32)
            ), name


# One entry of a scene: positions, triangles, instance (or a list of (instance, triangle count): merged), transform,
# visibility
@dataclasses.dataclass
class Entry:
    """A mesh in its place, or several baked into one."""

    positions: np.ndarray
    triangles: np.ndarray
    instance: int = 0
    merged: list[tuple[int, int]] | None = None  # instances and how many triangles each has
    to_world: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3, 4))
    visibility: int = -1


@dataclasses.dataclass
class Blocks:
    """A wide tree in host memory, as words of 16 bytes."""

    nodes: np.ndarray
    centre: np.ndarray
    box: np.ndarray
    triangles: np.ndarray | None = None  # of a mesh
    order: np.ndarray | None = None  # of a top level

    def __post_init__(self):
        words = {
            name: x.view(np.float32).reshape(-1, 4)
            for name in ("nodes", "triangles")
            if (x := getattr(self, name)) is not None
        }
        vars(self).update(words)


def mesh_blocks(entry: Entry, device: str, options: BuildOptions) -> Blocks:
    """By the CPU's builder; elsewhere by the device's own, which has no options and needs no compiler for the CPU."""
    positions, triangles = entry.positions, entry.triangles
    if device == "cpu":
        made = collapse_mesh(build_binary(positions, triangles, options), positions, triangles, Layout.QUANTISED)
        return Blocks(made.nodes, made.centre, made.box, triangles=made.triangles)
    uploaded = wp.array(positions, dtype=wp.vec3, device=device), wp.array(triangles, dtype=wp.vec3i, device=device)
    made = build_mesh(*uploaded, 0, len(triangles))
    return Blocks(made.nodes.numpy(), made.centre, made.box, triangles=made.triangles.numpy())


def top_blocks(low: np.ndarray, high: np.ndarray, device: str) -> Blocks:
    """The same over boxes."""
    if device == "cpu":
        made = collapse_entries(
            build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=1)), Layout.QUANTISED
        )
        return Blocks(made.nodes, made.centre, made.box, order=made.order)
    made = build_top(*(wp.array(x, dtype=wp.vec3, device=device) for x in (low, high)))
    return Blocks(made.nodes.numpy(), made.centre, made.box, order=made.order.numpy())


def make_tree(entries: list[Entry], device: str, instancing: bool, options: BuildOptions = WHOLE) -> Tree:
    """The trees of `entries`, each with blocks of its own."""
    meshes = [mesh_blocks(e, device, options) for e in entries]
    nodes, triangles = [m.nodes for m in meshes], [m.triangles for m in meshes]
    node_first, triangle_first = (
        np.cumsum([0] + [len(x) // size for x in blocks]) for blocks, size in ((nodes, 5), (triangles, 3))
    )
    to_world = np.array([e.to_world for e in entries], np.float64)
    inverse = np.linalg.inv(to_world[:, :, :3])
    from_world = np.concatenate([inverse, -inverse @ to_world[:, :, 3:]], 2).astype(np.float32)
    tree = Tree()
    tree.entry_count = len(entries)
    tree.top_node = int(node_first[-1])
    if instancing:
        # generous: some more than the error of carrying a ray to object space
        corners = np.array(
            [[[m.box[i, 0], m.box[j, 1], m.box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)] for m in meshes],
            np.float64,
        )
        world = np.einsum("eij,ecj->eci", to_world[:, :, :3], corners) + to_world[:, None, :, 3]
        reach = np.abs(world).max() * 1e-4
        low, high = (world.min(1) - reach).astype(np.float32), (world.max(1) + reach).astype(np.float32)
        top = top_blocks(low, high, device)
        nodes.append(top.nodes)
        tree.top_entry = wp.array(top.order, dtype=int, device=device)
        tree.top_centre = wp.vec3(*top.centre.tolist())
        tree.top_margin = 64 * SLAB_MARGIN

    def upload(values, dtype, shape=(-1,)):
        host = np.array(values, np.int32 if dtype is int else np.float32)
        return wp.array(host.reshape(shape), dtype=dtype, device=device)

    merged = [e.merged or [] for e in entries]
    tree.nodes = upload(np.concatenate(nodes), wp.vec4, (-1, 4))
    tree.triangles = upload(np.concatenate(triangles), wp.vec4, (-1, 4))
    tree.entry_node = upload(node_first[:-1], int)
    tree.entry_triangle = upload(triangle_first[:-1], int)
    tree.entry_centre = upload([m.centre for m in meshes], wp.vec3, (-1, 3))
    tree.entry_from_world = upload(from_world, mat34, (-1, 3, 4))
    tree.entry_instance = upload([-1 if e.merged else e.instance for e in entries], int)
    tree.entry_visibility = upload([e.visibility for e in entries], int)
    tree.merged_first = upload(np.cumsum([0] + [len(m) for m in merged]), int)
    tree.merged_instance = upload([i for m in merged for i, _ in m], int)
    tree.merged_triangle_first = upload([f for m in merged for f in np.cumsum([0] + [n for _, n in m])[:-1]], int)
    return tree


def make_rays(origin: np.ndarray, direction: np.ndarray, device: str, t_max=np.inf, visibility=1) -> Rays:
    rays = allocate_rays(len(origin), wp.get_device(device))
    rays.origin = wp.array(origin.astype(np.float32), dtype=wp.vec3, device=device)
    rays.direction = wp.array(direction.astype(np.float32), dtype=wp.vec3, device=device)
    rays.t_max = wp.array(np.broadcast_to(np.float32(t_max), len(origin)).copy(), dtype=float, device=device)
    rays.visibility = wp.array(np.broadcast_to(np.int32(visibility), len(origin)).copy(), dtype=int, device=device)
    return rays


@functools.cache
def trace_kernel(options: TraceOptions) -> wp.Kernel:
    trace = trace_function(options)

    @wp.kernel(**KERNEL_OPTIONS)
    def kernel(tree: Tree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), counts: TraceCounts):
        trace(tree, rays, listed, cursor, wp.tid(), counts)

    return kernel


def trace(tree: Tree, rays: Rays, options: TraceOptions, slots=None, counts=None) -> Hits:
    """Hits of the rays of `slots` (by default all), in the order of slots."""
    where = rays.origin.device
    slots = np.arange(rays.origin.shape[0]) if slots is None else slots
    work = wp.array(np.array(slots, np.int32), dtype=int, device=where)
    count, cursor = wp.array([len(slots)], dtype=int, device=where), wp.zeros(1, dtype=int, device=where)
    listed = DeviceRayList()
    fill_list(listed, RayList(work, count, len(slots)))
    inputs = [tree, rays, listed, cursor, counts or NO_COUNTS]
    wp.launch(
        trace_kernel(options),
        thread_count(len(slots), options, where),
        inputs,
        device=where,
        block_dim=TRACE_BLOCK_SIZE if where.is_cuda else 1,
    )
    return Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


# All triangles of one entry, by the arithmetic of the traversal and in no order to speak of
@wp.func_native(
    native_source(
        "traverse/triangle.h",
        "traverse/quantised/device.h",
        "traverse/quantised/ray.h",
        EDGE_TINY=EDGE_TINY,
        DIRECTION_LEAST=DIRECTION_LEAST,
    )
    + """
    const Ray r = begin_ray(o, d, wp::vec_t<3, float>(0.0f), 0.0f);
    const int axis = (r.order >> 5) & 3u;
    const ShearedRay sheared = {r.ox, r.oy, r.oz, r.sx, r.sy, along(axis, r.ix, r.iy, r.iz), axis};
    auto corner = [](const wp::vec_t<3, float>& p) -> Corner { return {p[0], p[1], p[2]}; };
    for (int face = 0; face < count; ++face) {
        const auto* a = corners.data + 3 * face;
        float t, v, w;
        if (!meet_triangle(sheared, corner(a[0]), corner(a[1]), corner(a[2]), t, v, w)) continue;
        const auto id = ids.data[face];
        const bool tie = t == rays_t.data[i] && instance.data[i] >= 0;
        const bool earlier = id[0] < instance.data[i]
            || (id[0] == instance.data[i] && id[1] < primitive.data[i]);
        if (t < rays_t.data[i] || (tie && earlier)) {
            rays_t.data[i] = t; instance.data[i] = id[0]; primitive.data[i] = id[1];
            uv.data[i] = wp::vec_t<2, float>(v, w);
        }
    }
"""
)
def meet_all(
    i: int,
    o: wp.vec3,
    d: wp.vec3,
    corners: wp.array(dtype=wp.vec3),
    ids: wp.array(dtype=wp.vec2i),
    count: int,
    rays_t: wp.array(dtype=float),
    instance: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
): ...


@wp.kernel(**KERNEL_OPTIONS)
def brute_kernel(
    rays: Rays,
    corners: wp.array(dtype=wp.vec3),
    ids: wp.array(dtype=wp.vec2i),
    count: int,
    from_world: mat34,
    moved: int,
    visibility: int,
):
    i = wp.tid()
    if (rays.visibility[i] & visibility) != 0:
        o = rays.origin[i]
        d = rays.direction[i]
        if moved != 0:
            o = transform_point(from_world, o)
            d = transform_vector(from_world, d)
        meet_all(i, o, d, corners, ids, count, rays.hit_t, rays.hit_instance, rays.hit_primitive, rays.hit_uv)


def brute(entries: list[Entry], rays: Rays, tree: Tree, instancing: bool) -> Hits:
    """Every ray against every triangle."""
    where = rays.origin.device
    rays.hit_t = wp.clone(rays.t_max)
    rays.hit_instance.fill_(-1)
    matrices = tree.entry_from_world.numpy()
    for k, e in enumerate(entries):
        parts = e.merged or [(e.instance, len(e.triangles))]
        ids = np.concatenate([np.stack([np.full(n, i), np.arange(n)], 1) for i, n in parts])
        corners = wp.array(e.positions[e.triangles].reshape(-1, 3), dtype=wp.vec3, device=where)
        inputs = [
            rays,
            corners,
            wp.array(ids, dtype=wp.vec2i, device=where),
            len(ids),
            mat34(matrices[k]),
            int(instancing),
        ]
        wp.launch(
            brute_kernel,
            len(rays.origin),
            [*inputs, e.visibility if instancing else -1],
            device=where,
            block_dim=BLOCK_DIM,
        )
    return Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


def random_rays(count: int, seed: int, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins in a cube, directions of all kinds: of any length, along axes and planes too."""
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-reach, reach, (count, 3))
    direction = rng.normal(size=(count, 3))
    direction[: count // 8, rng.integers(3)] = 0.0
    direction[: count // 16] = np.eye(3)[rng.integers(3, size=count // 16)] * rng.choice([-1, 1], (count // 16, 1))
    direction[count // 8 : count // 4, 0] *= 1e-12
    return origin, direction * 10 ** rng.uniform(-2, 2, (count, 1))


def placed(count: int, seed: int) -> list[Entry]:
    """Two meshes in many places, some turned inside out or flat, some seen by some rays alone, and two baked into
    one.
    """
    rng = np.random.default_rng(seed)
    meshes = [sphere(6, 0.3), soup(60, 4, 0.2)]
    entries = [Entry(*soup(80, 9, 0.5), merged=[(count, 30), (0, 50)])]
    for i in range(1, count):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        to_world = np.column_stack([turn * rng.uniform(0.1, 2, 3), rng.uniform(-2, 2, 3)])
        entries.append(Entry(*meshes[i % 2], instance=i, to_world=to_world, visibility=int(rng.integers(4))))
    return entries


def slivers(count: int, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Thin, flat and degenerate triangles far from the origin."""
    rng = np.random.default_rng(12)
    corner = rng.uniform(-1, 1, (count, 1, 3))
    along = rng.normal(size=(count, 1, 3)) * np.array([0.0, 1.0, 0.5])[None, :, None]
    across = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-8, -2, (count, 1, 1))
    positions = corner + along + across
    positions[: count // 4, :, rng.integers(3)] = 0.25  # in a plane across an axis
    positions[count // 4 : count // 3, 1] = positions[count // 4 : count // 3, 0]  # no area
    return (positions + far).reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
