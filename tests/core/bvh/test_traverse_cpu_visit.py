"""Rays that visit trees of BOXES treelet by treelet find what they find in the uncut tree, to the bit, in whatever order."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import scenes
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from wide_trees import soup, sphere

from raybatch_addon.core.bvh.build import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.trace_counts import TraceCounts
from raybatch_addon.core.bvh.traverse_cpu import INTERLEAVE, traversal_text
from raybatch_addon.core.bvh.traverse_cpu_visit import visit_function, visit_text
from raybatch_addon.core.bvh.tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Tree, Treelets
from raybatch_addon.core.bvh.treelet_tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.bvh.treelets import CutRule
from raybatch_addon.core.bvh.visit_task import VisitTask
from raybatch_addon.core.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import Rays, allocate_rays
from raybatch_addon.core.wavefront.stages.trace import boxes_kernel

CPU = wp.get_device("cpu")
HITS = ("hit_t", "hit_instance", "hit_primitive", "hit_uv")
COUNTED = ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")
NO_ANY_HIT = 2**31 - 1
RULES = {
    "one": CutRule(),
    "root": CutRule(size=1, depth_max=0),
    "two levels": CutRule(size=1, depth_max=2),
    "nodes": CutRule(size=12),
    "each node": CutRule(size=1, depth_max=10**6),
    "area": CutRule(top_bytes_max=6000),
}


# --- scenes and rays


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, and the rays that are sent into it."""

    built: BuiltTree
    origin: np.ndarray
    direction: np.ndarray


def random_rays(count: int, seed: int, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins in a cube, directions of any length, some along axes and planes."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction[: count // 6, rng.integers(3)] = -0.0
    direction[: count // 12] = np.eye(3)[rng.integers(3, size=count // 12)] * rng.choice([-1, 1], (count // 12, 1))
    return rng.uniform(-reach, reach, (count, 3)), direction * 10 ** rng.uniform(-2, 2, (count, 1))


def odd_rays(count: int, seed: int, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Rays with infinite, absent and tiny parts among others."""
    origin, direction = (x.astype(np.float32) for x in random_rays(count, seed, reach))
    rng = np.random.default_rng(seed)
    for values in (origin, direction):
        rows = rng.random(count) < 0.4
        values[rows, rng.integers(3, size=rows.sum())] = rng.choice(np.float32([np.nan, np.inf, -np.inf, 0.0, 3e38, 1e-42]), rows.sum())
    direction[: count // 20] = 0.0
    return origin, direction


def aimed_rays(mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, edges and points of triangles."""
    rng = np.random.default_rng(3)
    weights = rng.dirichlet([0.3] * 3, count)
    weights[: count // 3] = np.eye(3)[rng.integers(3, size=count // 3)]
    target = np.einsum("ri,rij->rj", weights, mesh[0][mesh[1][rng.integers(len(mesh[1]), size=count)]].astype(np.float64))
    origin = rng.uniform(-3, 3, (count, 3))
    return origin, target - origin.astype(np.float32)


def slivers(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles a million times as long as they are wide, and some without an area."""
    rng = np.random.default_rng(5)
    start, along, aside = rng.uniform(-1, 1, (count, 3)), rng.normal(size=(count, 3)), 1e-6 * rng.normal(size=(count, 3))
    corners = np.stack([start, start + along, start + 0.5 * along + aside], 1)
    corners[: count // 10, 1] = corners[: count // 10, 0]
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def doubling(count: int, each: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, one behind the other, whose sizes and distances grow by 2^each, so that each split leaves out few."""
    size = 2.0 ** (each * np.arange(count) - each * count / 2)
    corner = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    return (corner[None] * size[:, None, None]).reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def turned(seed: int, count: int, reach: float) -> list[np.ndarray]:
    """Matrices of places within `reach`, with sizes and turns at random."""
    rng = np.random.default_rng(seed)
    turns, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return list(np.concatenate([turns * rng.uniform(0.1, 1.5, (count, 1, 3)), rng.uniform(-reach, reach, (count, 3, 1))], 2).astype(np.float32))


def of_meshes(meshes, instancing: bool, rays, visibility: int | None = None) -> Case:
    """A scene of (vertices, triangles) in their places; with `visibility` (a seed) not every instance is seen by every ray."""
    listed = [(Mesh(f"mesh {i}", *mesh), places) for i, (mesh, places) in enumerate(meshes)]
    scene = scenes.scene([(mesh, place, scenes.diffuse()) for mesh, places in listed for place in places])
    if visibility is not None:
        bits = np.random.default_rng(visibility).integers(1, 4, len(scene.instances)).astype(np.int32)
        scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=bits))
    flat = flatten(scene)
    built = build_scene_tree(flat, upload_geometry(flat, scene, CPU), scene.instances.visibility, instancing, CPU, Layout.BOXES)
    return Case(built, *(x.astype(np.float32) for x in rays))


@functools.cache
def case(name: str) -> Case:
    here = [scenes.IDENTITY]
    away = np.random.default_rng(9).uniform(0, 1, (400, 3)) + [0, 0, 0.5]
    if name == "soup":
        return of_meshes([(soup(2000, 1), here)], False, random_rays(600, 2))
    if name == "slivers":
        return of_meshes([(slivers(500), here)], False, aimed_rays(slivers(500), 600))
    if name == "equal hits":  # the lowest triangle of many in the same place
        positions, triangles = soup(60, 3, 0.4)
        return of_meshes([((positions, np.tile(triangles, (25, 1))), here)], False, aimed_rays((positions, triangles), 500))
    if name == "odd rays":
        return of_meshes([(sphere(20), here)], False, odd_rays(600, 5))
    if name == "deep":
        return of_meshes([(doubling(2200, 0.1), here)], False, (0 * away, away))
    if name == "instances":
        balls, places = turned(1, 30, 2.0), turned(2, 30, 2.0)
        shared = [(sphere(12, 0.4), balls + balls[:8]), (soup(400, 4, 0.2), places)]  # some twice in the same place
        return of_meshes(shared + [(soup(90, 9 + i, 0.4), here) for i in range(3)], True, random_rays(800, 7, 3.0), visibility=5)
    if name == "odd rays, instances":
        return of_meshes([(sphere(8, 0.4), turned(3, 20, 1.0))], True, odd_rays(600, 8))
    assert name == "deep top"
    places = [scenes.translation(0, 0, 0, 2.0 ** (0.25 * i - 20)) for i in range(160)]
    return of_meshes([(doubling(300, 0.1), places)], True, (0 * away, away))


CASES = ("soup", "slivers", "equal hits", "odd rays", "deep", "instances", "odd rays, instances", "deep top")


@functools.cache
def cut(name: str, rule: str) -> TreeletTree:
    return cut_scene_tree(case(name).built, RULES[rule], CPU)


def t_max_of(name: str) -> np.ndarray:
    """Far for most rays, and for some near, 0, negative or no number."""
    count, rng = len(case(name).origin), np.random.default_rng(4)
    t_max = np.full(count, np.inf, np.float32)
    some = rng.random(count) < 0.3
    t_max[some] = rng.choice(np.float32([0.5, 1.0, 1e-3, 0.0, -1.0, np.nan, 3e38]), some.sum())
    return t_max


def make_rays(name: str, shared_t: bool = False, any_first: int = NO_ANY_HIT) -> Rays:
    """The case's rays; with `shared_t` `t_max` and `hit_t` are one array, and any-hit rays have no primitive and weights."""
    made, count = case(name), len(case(name).origin)
    rays = allocate_rays(count, CPU)
    rays.origin.assign(made.origin)
    rays.direction.assign(made.direction)
    rays.t_max.assign(t_max_of(name))
    rays.visibility = uploaded(np.random.default_rng(1).integers(1, 4, count))
    rays.hit_instance.fill_(-77)
    rays.hit_primitive.fill_(-77)
    if shared_t:
        rays.hit_t = rays.t_max
        rays.hit_primitive, rays.hit_uv = rays.hit_primitive[: min(any_first, count)], rays.hit_uv[: min(any_first, count)]
    return rays


def uploaded(values) -> wp.array:
    return wp.array(np.array(values, np.int32), dtype=int, device="cpu")


@functools.cache
def expected_hits(name: str, any_first: int) -> dict[str, np.ndarray]:
    """By the traversal of the uncut tree."""
    rays, slots = make_rays(name), np.arange(len(case(name).origin))
    for any_hit, part in ((False, slots[slots < any_first]), (True, slots[slots >= any_first])):
        kernel = boxes_kernel(any_hit, case(name).built.instancing, False, INTERLEAVE)
        wp.launch(kernel, 1, [case(name).built.tree, rays, uploaded(part), uploaded([len(part)])], device="cpu")
    return {field: getattr(rays, field).numpy() for field in HITS}


# --- the traversal


@functools.cache
def visit_kernel(task: VisitTask, instancing: bool, interleave: int = INTERLEAVE, counters: bool = False, interlocked: bool = False) -> wp.Kernel:
    """Kernel (tree, treelets, progress, rays, slots, where, first, end, any_first), with counters also (counts)."""
    visit = visit_function(task, instancing, interleave, counters, interlocked)
    if counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def counted(
            tree: Tree, treelets: Treelets, progress: TopProgress, rays: Rays, slots: wp.array(dtype=int), where: wp.array(dtype=int),
            first: int, end: int, any_first: int, counts: TraceCounts,
        ):  # fmt: skip
            visit(
                tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
                rays.hit_primitive, rays.hit_uv, slots, where, first, end, any_first, counts,
            )  # fmt: skip

        return counted

    @wp.kernel(**KERNEL_OPTIONS)
    def plain(
        tree: Tree, treelets: Treelets, progress: TopProgress, rays: Rays, slots: wp.array(dtype=int), where: wp.array(dtype=int),
        first: int, end: int, any_first: int,
    ):  # fmt: skip
        visit(
            tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
            rays.hit_primitive, rays.hit_uv, slots, where, first, end, any_first,
        )  # fmt: skip

    return plain


class Journey:
    """Rays on their way through a cut tree: where each waits, on the host. A third of them ask for any hit by default."""

    def __init__(self, name: str, rule: str, any_first: int | None = None, shared_t=True, interleave=INTERLEAVE, interlocked=False, counted=False):
        self.name, self.made, count = name, cut(name, rule), len(case(name).origin)
        self.any_first = 2 * count // 3 if any_first is None else any_first
        self.rays = make_rays(name, shared_t, self.any_first)
        self.interleave, self.interlocked = interleave, interlocked
        self.progress = TopProgress()
        self.progress.trail = wp.full((-(-self.made.levels // TRAIL_LEVELS), count), 0xFFFFFFFF, dtype=wp.uint32, device="cpu")
        self.progress.entry = wp.full(count if self.made.instancing else 0, -5, dtype=int, device="cpu")
        self.progress.visits = wp.zeros(1, dtype=wp.int64, device="cpu")
        self.where = np.full(count, NEW, np.int32)
        self.counts = None
        if counted:
            self.counts = TraceCounts()
            for field in COUNTED:
                setattr(self.counts, field, wp.full(count, -9, dtype=int, device="cpu"))

    def run(self, task: VisitTask, slots: np.ndarray, treelets: Treelets | None = None) -> None:
        """`task` for the rays in `slots`, between others of the batch that are not the launch's."""
        where, listed = (np.concatenate([[NEW], x, [NEW]]) for x in (self.where[slots], slots))
        where = uploaded(where)
        kernel = visit_kernel(task, self.made.instancing, self.interleave, self.counts is not None, self.interlocked)
        inputs = [self.made.tree, treelets or self.made.treelets, self.progress, self.rays, uploaded(listed), where, 1, len(slots) + 1, self.any_first]
        wp.launch(kernel, 1, inputs + ([self.counts] if self.counts else []), device="cpu")
        assert where.numpy()[0] == where.numpy()[-1] == NEW
        self.where[slots] = where.numpy()[1:-1]

    def visits(self) -> int:
        return int(self.progress.visits.numpy()[0])

    def treelets(self, nodes: np.ndarray, triangles: np.ndarray) -> Treelets:
        """The tables with those treelets there."""
        tables, made = Treelets(), self.made.treelets
        tables.of_node, tables.root = made.of_node, made.root
        tables.nodes = wp.array(np.where(nodes, made.nodes.numpy(), 0).astype(np.uint64), dtype=wp.uint64, device="cpu")
        tables.triangles = wp.array(np.where(triangles, made.triangles.numpy(), 0).astype(np.uint64), dtype=wp.uint64, device="cpu")
        return tables

    def alternate(self, rng: np.random.Generator) -> int:
        """Top level and treelets in turn, rays in batches at random, until all are done; how many visits there should have been."""
        inside, visits = np.zeros(len(self.where), bool), 0  # the ray was in the treelet that it waits at
        for _ in range(10_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return visits
            chosen = rng.permutation(alive)[: rng.integers(1, 2 * len(alive) + 2)]
            enters = (self.where[chosen] >= 0) & ~inside[chosen]
            for task, slots in ((VisitTask.TREELET, chosen[enters]), (VisitTask.TOP, chosen[~enters])):
                before = self.where[slots]
                self.run(task, slots)
                after = self.where[slots]
                inside[slots] = task is VisitTask.TREELET
                if task is VisitTask.TREELET:
                    visits += len(slots)
                    assert ((after == before) | ((after == DONE) & (slots >= self.any_first))).all()
                else:
                    assert (after != NEW).all() and (self.made.instancing or (after != before).all())
        raise AssertionError("rays never end")

    def go_on(self, rng: np.random.Generator, there: float, nodes_there: float) -> None:
        """`GO_ON` with other treelets there each time, some of them without triangles, until all rays are done."""
        total = self.made.treelet_count
        for _ in range(10_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return
            whole = rng.random(total) < there
            waiting = self.where[alive][self.where[alive] >= 0]
            if len(waiting):
                whole[rng.choice(waiting)] = True
            nodes = whole | (rng.random(total) < nodes_there)
            before = self.where[alive]
            self.run(VisitTask.GO_ON, rng.permutation(alive), self.treelets(nodes, whole))
            after = self.where[alive]
            assert (after != NEW).all() and not whole[after[after >= 0]].any()
            absent = (before >= 0) & ~nodes[np.maximum(before, 0)]
            assert np.array_equal(after[absent], before[absent])
        raise AssertionError("rays never end")

    def check(self) -> None:
        """All hits are those of the uncut tree, to the bit; of any-hit rays whether there is one, and their `t_max` is as it was."""
        assert (self.where == DONE).all()
        first, expected = self.any_first, expected_hits(self.name, self.any_first)
        for field in HITS:
            found = getattr(self.rays, field).numpy()[:first]
            assert np.array_equal(found.view(np.uint32), expected[field][:first].view(np.uint32)), field
        assert np.array_equal(self.rays.hit_instance.numpy()[first:], expected["hit_instance"][first:])
        assert np.array_equal(self.rays.t_max.numpy()[first:].view(np.uint32), t_max_of(self.name)[first:].view(np.uint32))


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", CASES)
def test_top_level_and_treelets_in_turn(name, rule):
    journey = Journey(name, rule)
    assert journey.alternate(np.random.default_rng(1)) == journey.visits() > 0
    journey.check()


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", CASES)
def test_going_on_through_what_is_there(name, rule):
    journey = Journey(name, rule)
    journey.go_on(np.random.default_rng(2), 0.4, 0.5)
    journey.check()
    whole = Journey(name, rule)  # all there: one launch
    whole.run(VisitTask.GO_ON, np.arange(len(whole.where)))
    whole.check()
    assert 0 < whole.visits()


def test_the_cases_are_what_they_should_be():
    assert cut("deep", "each node").levels > 2 * TRAIL_LEVELS
    assert cut("deep top", "one").levels > TRAIL_LEVELS and cut("deep top", "each node").levels > 2 * TRAIL_LEVELS
    for name in CASES:
        hits = expected_hits(name, NO_ANY_HIT)
        assert 0.02 < (hits["hit_instance"] >= 0).mean() < 0.98, name
    assert len(np.unique(expected_hits("instances", NO_ANY_HIT)["hit_instance"])) > 20
    for name in ("soup", "deep", "instances"):
        assert cut(name, "each node").mesh_triangle[-1] > 0  # leaves above treelets


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(CASES), rule=st.sampled_from(list(RULES)), seed=st.integers(0, 1000), any_share=st.floats(0, 1),
    there=st.floats(0, 1), nodes_there=st.floats(0, 1), shared_t=st.booleans(), in_turn=st.booleans(), interlocked=st.booleans(),
)  # fmt: skip
def test_the_order_of_visits_changes_nothing(name, rule, seed, any_share, there, nodes_there, shared_t, in_turn, interlocked):
    journey = Journey(name, rule, int(any_share * len(case(name).origin)), shared_t, interlocked=interlocked and in_turn)
    rng = np.random.default_rng(seed)
    if in_turn:
        journey.alternate(rng)
    else:
        journey.go_on(rng, there, nodes_there)
    journey.check()


@pytest.mark.parametrize("interleave", [1, 3])
@pytest.mark.parametrize("name", ["soup", "instances"])
def test_how_many_rays_are_carried_changes_nothing(name, interleave):
    for in_turn in (True, False):
        journey, rng = Journey(name, "nodes", interleave=interleave), np.random.default_rng(3)
        journey.alternate(rng) if in_turn else journey.go_on(rng, 0.5, 0.5)
        journey.check()


def test_rays_that_are_not_in_the_batch_or_done_are_left_alone():
    journey = Journey("soup", "nodes", NO_ANY_HIT, False)
    slots = np.arange(5, 400, 3)
    journey.where[slots[::2]] = DONE
    journey.run(VisitTask.GO_ON, slots)
    assert (journey.where[slots] == DONE).all()
    primitive = journey.rays.hit_primitive.numpy()
    assert (np.delete(primitive, slots[1::2]) == -77).all() and (primitive[slots[1::2]] != -77).all()
    for task in VisitTask:
        journey.run(task, np.arange(0))
    journey.where[:50] = NEW
    journey.run(VisitTask.TREELET, np.arange(50))  # these wait at none
    assert (journey.where[:50] == NEW).all()


@pytest.mark.parametrize("task", [VisitTask.TOP, VisitTask.GO_ON])
@pytest.mark.parametrize("name", ["soup", "instances"])
def test_a_scene_without_entries_is_missed(name, task):
    journey = Journey(name, "nodes", 300, False)
    tree = Tree()
    journey.made = dataclasses.replace(journey.made, tree=tree, treelets=Treelets())
    journey.run(task, np.arange(len(journey.where)))
    assert (journey.where == DONE).all() and (journey.rays.hit_instance.numpy() == -1).all()
    limit = t_max_of(name)[:300]
    assert np.array_equal(journey.rays.hit_t.numpy()[:300], np.where(limit > 0, limit, 0)) and (journey.rays.hit_primitive.numpy()[:300] == -1).all()


@pytest.mark.parametrize("name", ["soup", "instances"])
def test_nodes_alone_let_rays_pass_that_need_no_triangle(name):
    """With all nodes and no triangles, rays end that meet no leaf; the others wait, and nothing counts as a visit."""
    journey, bare = Journey(name, "nodes", NO_ANY_HIT), Journey(name, "nodes", NO_ANY_HIT)
    everyone, total = np.arange(len(journey.where)), journey.made.treelet_count
    journey.run(VisitTask.GO_ON, everyone, journey.treelets(np.ones(total, bool), np.zeros(total, bool)))
    nothing = journey.treelets(np.zeros(total, bool), np.zeros(total, bool))
    bare.run(VisitTask.GO_ON, everyone, nothing)
    done, done_bare = journey.where == DONE, bare.where == DONE
    assert journey.visits() == bare.visits() == 0
    assert (done_bare <= done).all() and done_bare.sum() < done.sum() < len(done)
    again = journey.where.copy()
    journey.run(VisitTask.GO_ON, everyone, nothing)  # all come out as they went in
    assert np.array_equal(journey.where, again)
    journey.run(VisitTask.GO_ON, everyone)
    journey.check()


@pytest.mark.parametrize("name", ["soup", "instances"])
def test_counters(name):
    journey, whole = (Journey(name, "nodes", NO_ANY_HIT, counted=True) for _ in range(2))
    journey.alternate(np.random.default_rng(3))
    journey.check()
    whole.run(VisitTask.GO_ON, np.arange(len(whole.where)))
    whole.check()
    found, at_once = ({field: getattr(j.counts, field).numpy() for field in COUNTED} for j in (journey, whole))
    assert found["treelet_visits"].sum() == journey.visits() and at_once["treelet_visits"].sum() == whole.visits() > 0
    assert np.array_equal(found["queued"], 2 * found["treelet_visits"])  # before each treelet and behind it
    assert not at_once["queued"].any()
    # the same steps as in the uncut tree when all is there, since it is visited in the same order
    rays, uncut, count = make_rays(name), TraceCounts(), len(whole.where)
    for field in COUNTED[:3]:
        setattr(uncut, field, wp.zeros(count, dtype=int, device="cpu"))
    kernel = boxes_kernel(False, whole.made.instancing, True, INTERLEAVE)
    wp.launch(kernel, 1, [case(name).built.tree, rays, uploaded(np.arange(count)), uploaded([count]), uncut], device="cpu")
    for field in COUNTED[:3]:
        assert np.array_equal(at_once[field], getattr(uncut, field).numpy()), field
        assert (found[field] >= at_once[field]).all()


def test_texts():
    """Each task is compiled for itself, for CPUs alone, and whole trees have nothing of it."""
    texts = [visit_text(task, instancing, 16, False, together) for task in VisitTask for instancing in (False, True) for together in (False, True)]
    assert len(set(texts)) == 8  # rays are taken together in TOP alone
    for text in texts:
        assert text.strip().startswith("#if !defined(__CUDA_ARCH__)") and text.strip().endswith("#endif")
        assert not any(word in text for word in ("NODES_OF_RAY", "TRIANGLES_OF_RAY", "NODE_OF_CHILD", "KEEP_PLACES", "ASKS_ANY", "COUNT_", "INLINE"))
    for any_hit in (False, True):
        assert not any(word in traversal_text(any_hit, True, 16, False) for word in ("NODES_OF", "OF_CHILD", "KEEP_PLACES", "ASKS_ANY", "ray.place", "treelet"))
