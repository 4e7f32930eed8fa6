"""Traversal of quantised trees against brute force, to the bit: on a CPU one ray at a time, on CUDA by warps."""

import dataclasses
import functools

import numpy as np
import pytest
import warp as wp
from under_test import BLOCK_DIM
from wide_trees import soup, sphere

from raybatch_addon.core.bvh.binary import BuildOptions
from raybatch_addon.core.bvh.build_cuda import build_mesh, build_top
from raybatch_addon.core.bvh.build_sah import build_binary, build_binary_from_boxes
from raybatch_addon.core.bvh.collapse import collapse_entries, collapse_mesh
from raybatch_addon.core.bvh.intersect import TRIANGLE_TEXT
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.trace_counts import TraceCounts
from raybatch_addon.core.bvh.traverse_cuda import BLOCK_SIZE, TraceOptions, thread_count, trace_function
from raybatch_addon.core.bvh.traverse_cuda_text import DEVICE_TEXT, RAY_TEXT
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.geometry import mat34, transform_point, transform_vector
from raybatch_addon.core.wavefront.rays import Rays, allocate_rays

CLOSEST = TraceOptions(any_hit=False, instancing=False)
ANY = TraceOptions(any_hit=True, instancing=False)
WHOLE = BuildOptions(leaf_group=1, leaf_max=3)


@dataclasses.dataclass
class Hits:
    """What came back, one row a ray."""

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
            assert np.array_equal(getattr(self, name)[hit].view(np.uint32), getattr(other, name)[hit].view(np.uint32)), name


# One entry of a scene: positions, triangles, instance (or a list of (instance, triangle count): merged), transform, visibility
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
        words = {name: x.view(np.float32).reshape(-1, 4) for name in ("nodes", "triangles") if (x := getattr(self, name)) is not None}
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
        made = collapse_entries(build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=1)), Layout.QUANTISED)
        return Blocks(made.nodes, made.centre, made.box, order=made.order)
    made = build_top(*(wp.array(x, dtype=wp.vec3, device=device) for x in (low, high)))
    return Blocks(made.nodes.numpy(), made.centre, made.box, order=made.order.numpy())


def make_tree(entries: list[Entry], device: str, instancing: bool, options: BuildOptions = WHOLE) -> Tree:
    """The trees of `entries`, each with blocks of its own."""
    meshes = [mesh_blocks(e, device, options) for e in entries]
    nodes, triangles = [m.nodes for m in meshes], [m.triangles for m in meshes]
    node_first, triangle_first = (np.cumsum([0] + [len(x) // size for x in blocks]) for blocks, size in ((nodes, 5), (triangles, 3)))
    to_world = np.array([e.to_world for e in entries], np.float64)
    inverse = np.linalg.inv(to_world[:, :, :3])
    from_world = np.concatenate([inverse, -inverse @ to_world[:, :, 3:]], 2).astype(np.float32)
    tree = Tree()
    tree.entry_count = len(entries)
    tree.top_node = int(node_first[-1])
    if instancing:
        # generous: some more than the error of carrying a ray to object space
        corners = np.array([[[m.box[i, 0], m.box[j, 1], m.box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)] for m in meshes], np.float64)
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

    if options.counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def counted(
            tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), cursor: wp.array(dtype=int), counts: TraceCounts
        ):
            trace(
                tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
                rays.hit_uv, slots, count, cursor, wp.tid(), counts,
            )  # fmt: skip

        return counted

    @wp.kernel(**KERNEL_OPTIONS)
    def plain(tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), cursor: wp.array(dtype=int)):
        trace(
            tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
            rays.hit_uv, slots, count, cursor, wp.tid(),
        )  # fmt: skip

    return plain


def trace(tree: Tree, rays: Rays, options: TraceOptions, slots=None, counts=None) -> Hits:
    """Hits of the rays of `slots` (by default all), in the order of slots."""
    where = rays.origin.device
    slots = np.arange(rays.origin.shape[0]) if slots is None else slots
    work = wp.array(np.array(slots, np.int32), dtype=int, device=where)
    count, cursor = wp.array([len(slots)], dtype=int, device=where), wp.zeros(1, dtype=int, device=where)
    inputs = [tree, rays, work, count, cursor] + ([counts] if counts else [])
    wp.launch(
        trace_kernel(options), thread_count(len(slots), options, where), inputs, device=where, block_dim=BLOCK_SIZE if where.is_cuda else 1
    )
    return Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


# All triangles of one entry, by the arithmetic of the traversal and in no order to speak of
@wp.func_native(
    TRIANGLE_TEXT
    + DEVICE_TEXT
    + RAY_TEXT
    + """
    const Ray r = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], 0.0f, 0.0f, 0.0f, 0.0f);
    const int axis = (r.order >> 5) & 3u;
    const ShearedRay sheared = {r.ox, r.oy, r.oz, r.sx, r.sy, along(axis, r.ix, r.iy, r.iz), axis};
    for (int face = 0; face < count; ++face) {
        const auto a = corners.data[3 * face], b = corners.data[3 * face + 1], c = corners.data[3 * face + 2];
        float t, v, w;
        if (!meet_triangle(sheared, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], t, v, w)) continue;
        const auto id = ids.data[face];
        const bool tie = t == rays_t.data[i] && instance.data[i] >= 0;
        if (t < rays_t.data[i] || (tie && (id[0] < instance.data[i] || (id[0] == instance.data[i] && id[1] < primitive.data[i])))) {
            rays_t.data[i] = t; instance.data[i] = id[0]; primitive.data[i] = id[1]; uv.data[i] = wp::vec_t<2, float>(v, w);
        }
    }
"""
)
def meet_all(
    i: int, o: wp.vec3, d: wp.vec3, corners: wp.array(dtype=wp.vec3), ids: wp.array(dtype=wp.vec2i), count: int,
    rays_t: wp.array(dtype=float), instance: wp.array(dtype=int), primitive: wp.array(dtype=int), uv: wp.array(dtype=wp.vec2),
): ...  # fmt: skip


@wp.kernel(**KERNEL_OPTIONS)
def brute_kernel(rays: Rays, corners: wp.array(dtype=wp.vec3), ids: wp.array(dtype=wp.vec2i), count: int, from_world: mat34, moved: int, visibility: int):
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
        inputs = [rays, corners, wp.array(ids, dtype=wp.vec2i, device=where), len(ids), mat34(matrices[k]), int(instancing)]
        wp.launch(brute_kernel, len(rays.origin), [*inputs, e.visibility if instancing else -1], device=where, block_dim=BLOCK_DIM)
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


VARIANTS = [
    CLOSEST,
    dataclasses.replace(CLOSEST, refill=0),
    dataclasses.replace(CLOSEST, leaf_groups=1),
    dataclasses.replace(CLOSEST, leaf_groups=1, every_triangle=True),
]


@pytest.mark.parametrize("options", VARIANTS, ids=str)
def test_closest_hits_are_those_of_brute_force(device, options):
    entries = [Entry(*soup(600, 1), merged=[(3, 250), (5, 100), (4, 250)])]
    tree = make_tree(entries, device, False)
    rays = make_rays(*random_rays(2000, 2), device)
    found = trace(tree, rays, options)
    expected = brute(entries, rays, tree, False)
    found.check_same(expected)


def placed(count: int, seed: int) -> list[Entry]:
    """Two meshes in many places, some turned inside out or flat, some seen by some rays alone, and two baked into one."""
    rng = np.random.default_rng(seed)
    meshes = [sphere(6, 0.3), soup(60, 4, 0.2)]
    entries = [Entry(*soup(80, 9, 0.5), merged=[(count, 30), (0, 50)])]
    for i in range(1, count):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        to_world = np.column_stack([turn * rng.uniform(0.1, 2, 3), rng.uniform(-2, 2, 3)])
        entries.append(Entry(*meshes[i % 2], instance=i, to_world=to_world, visibility=int(rng.integers(4))))
    return entries


@pytest.mark.parametrize("refill", (0, 8))
def test_instances_are_met_as_by_brute_force(device, refill):
    entries = placed(25, 5)
    tree = make_tree(entries, device, True)
    visibility = np.random.default_rng(6).integers(1, 4, 3000)
    rays = make_rays(*random_rays(3000, 7, 3.0), device, visibility=visibility)
    found = trace(tree, rays, dataclasses.replace(CLOSEST, instancing=True, refill=refill))
    expected = brute(entries, rays, tree, True)
    found.check_same(expected)
    assert len(set(found.instance.tolist())) > 15
    shadow = trace(tree, rays, dataclasses.replace(ANY, instancing=True, refill=refill))
    assert np.array_equal(shadow.instance >= 0, expected.instance >= 0)


def test_any_hit_agrees_with_closest_hit_and_ends_before_t_max(device):
    tree = make_tree([Entry(*soup(800, 1))], device, False)
    origin, direction = random_rays(3000, 8)
    rays = make_rays(origin, direction, device)
    found = trace(tree, rays, CLOSEST)
    hit = found.instance >= 0
    t = np.where(hit, found.t, np.float32(1))
    for t_max, expected in ((np.inf, hit), (t, np.zeros(len(t), bool)), (np.nextafter(t, np.float32(np.inf)), hit), (np.float32(0), 0 * hit > 0)):
        assert np.array_equal(trace(tree, make_rays(origin, direction, device, t_max), ANY).instance >= 0, expected)
        assert np.array_equal(trace(tree, make_rays(origin, direction, device, t_max), CLOSEST).instance >= 0, expected)


def test_of_equal_distances_the_lowest_instance_and_primitive_win(device):
    """The same triangles over and over: in one mesh, and in many entries in one place."""
    positions, triangles = sphere(5)
    copies = np.tile(triangles, (4, 1))
    shuffled = np.random.default_rng(1).permutation(len(copies))
    origin, direction = random_rays(1000, 9, 0.2)
    rays = make_rays(origin, direction, device)
    tree = make_tree([Entry(positions, copies[shuffled])], device, False)
    trace(tree, rays, CLOSEST).check_same(brute([Entry(positions, copies[shuffled])], rays, tree, False))

    count = len(triangles)
    entries = [Entry(positions, triangles, instance=i) for i in (7, 3, 9, 5)]
    entries += [Entry(positions, np.tile(triangles, (2, 1)), merged=[(2, count), (8, count)]), Entry(positions, triangles, instance=4)]
    tree = make_tree(entries, device, True)
    found = trace(tree, rays, dataclasses.replace(CLOSEST, instancing=True))
    found.check_same(brute(entries, rays, tree, True))
    assert set(found.instance.tolist()) == {2}


def test_the_order_of_work_changes_nothing(device):
    entries = placed(12, 3)
    tree = make_tree(entries, device, True)
    origin, direction = random_rays(2000, 10, 3.0)
    options = dataclasses.replace(CLOSEST, instancing=True)
    first = trace(tree, make_rays(origin, direction, device), options)
    for seed in range(3):
        slots = np.random.default_rng(seed).permutation(2000)
        first.check_same(trace(tree, make_rays(origin, direction, device), options, slots))


def test_only_listed_rays_are_traced(device):
    tree = make_tree([Entry(*sphere(5))], device, False)
    rays = make_rays(np.zeros((100, 3)), random_rays(100, 11)[1], device)
    rays.hit_instance.fill_(-7)
    slots = np.arange(3, 90, 2)
    found = trace(tree, rays, CLOSEST, slots)
    listed = np.isin(np.arange(100), slots)
    assert (found.instance[listed] == 0).all() and (found.instance[~listed] == -7).all()
    assert np.array_equal(trace(tree, rays, CLOSEST, []).instance, found.instance)


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


@pytest.mark.parametrize("far", (0.0, 1000.0))
def test_no_hit_on_slivers_is_lost(device, far):
    """Rays at points of the triangles themselves, and along them."""
    entries = [Entry(*slivers(400, far))]
    positions, triangles = entries[0].positions, entries[0].triangles
    rng = np.random.default_rng(13)
    weights = rng.dirichlet([0.3] * 3, 4000)
    face = rng.integers(len(triangles), size=4000)
    target = np.einsum("ri,rij->rj", weights, positions[triangles[face]].astype(np.float64))
    origin = far + rng.uniform(-3, 3, (4000, 3))
    origin[:500, 0] = target[:500, 0]
    direction = target - origin.astype(np.float32)
    rays = make_rays(origin, direction, device)
    tree = make_tree(entries, device, False)
    trace(tree, rays, CLOSEST).check_same(brute(entries, rays, tree, False))


def test_closed_surface_has_no_gaps(device):
    """Rays from inside at vertices and edges all hit."""
    positions, triangles = sphere(12)
    corners = positions[triangles].astype(np.float64)
    target = np.concatenate([positions, (corners[:, 0] + corners[:, 1]) / 2, corners.mean(1)])
    origin = np.broadcast_to(np.float32([0.011, -0.023, 0.037]), target.shape)
    rays = make_rays(origin, target - origin, device)
    assert (trace(make_tree([Entry(positions, triangles)], device, False), rays, CLOSEST).instance == 0).all()


def test_deep_trees_fit_on_the_stack(device):
    """Triangles whose sizes and distances double: each split leaves out one."""
    size = 2.0 ** np.arange(-30, 30, 0.25)
    corner = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    positions = (corner[None] * size[:, None, None]).reshape(-1, 3).astype(np.float32)
    entries = [Entry(positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3))]
    tree = make_tree(entries, device, False, BuildOptions(leaf_group=1, leaf_max=1))
    direction = np.random.default_rng(14).uniform(0, 1, (500, 3)) + [0, 0, 0.5]
    rays = make_rays(np.zeros((500, 3)), direction, device)
    trace(tree, rays, CLOSEST).check_same(brute(entries, rays, tree, False))


def test_nothing_to_hit(device):
    flat = np.zeros((3, 3), np.float32)
    tree = make_tree([Entry(flat, np.array([[0, 1, 2]], np.int32))], device, False)
    rays = make_rays(*random_rays(50, 15), device, t_max=5.0)
    for entry_count in (1, 0):
        tree.entry_count = entry_count
        found = trace(tree, rays, CLOSEST)
        assert (found.instance == -1).all() and (found.t == 5.0).all()
    rays = make_rays(np.zeros((10, 3)), np.zeros((10, 3)), device)  # a ray without direction
    tree = make_tree([Entry(*sphere(5))], device, False)
    assert (trace(tree, rays, CLOSEST).instance == -1).all()


@pytest.mark.parametrize("refill", (0, 8))
def test_counters(device, refill):
    entries = [Entry(*soup(600, 1))]
    tree = make_tree(entries, device, False)
    origin, direction = random_rays(500, 16)
    rays = make_rays(origin, direction, device)
    options = dataclasses.replace(CLOSEST, refill=refill)
    expected = trace(tree, rays, options)
    counts = TraceCounts()
    for name in ("node_steps", "box_tests", "triangle_tests"):
        setattr(counts, name, wp.zeros(500, dtype=int, device=device))
    counts.lanes = wp.zeros(6, dtype=wp.int64, device=device)
    expected.check_same(trace(tree, rays, dataclasses.replace(options, counters=True), counts=counts))
    nodes, boxes, tests = counts.node_steps.numpy(), counts.box_tests.numpy(), counts.triangle_tests.numpy()
    busy, there = counts.lanes.numpy().reshape(3, 2).T
    assert (nodes >= 1).all() and (boxes <= 8 * nodes).all() and (boxes >= nodes).all()
    assert (tests[expected.instance >= 0] >= 1).all()
    assert busy[1] == nodes.sum() and busy[2] == tests.sum()
    assert (busy <= there).all() and busy[0] >= busy[1]


@pytest.mark.parametrize(
    "options",
    [
        *VARIANTS,
        dataclasses.replace(CLOSEST, instancing=True, counters=True),
        dataclasses.replace(ANY, instancing=True),
    ],
    ids=str,
)
def test_the_text_for_cuda_compiles(options, tmp_path):
    """Also on machines without a device."""
    assert wp.compile_aot_module(trace_kernel(options).module, arch=90, module_dir=tmp_path, use_ptx=True)
