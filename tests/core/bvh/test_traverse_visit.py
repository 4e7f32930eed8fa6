"""Rays that visit quantised trees treelet by treelet find what they find in the uncut tree, to the bit, in whatever order."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import scenes
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from under_test import DEVICE
from wide_trees import soup, sphere

from raybatch_addon.core.bvh.build import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.trace_counts import TraceCounts
from raybatch_addon.core.bvh.traverse_cuda_visit import VisitOptions, visit_text
from raybatch_addon.core.bvh.tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Treelets
from raybatch_addon.core.bvh.treelet_tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.bvh.treelets import CutRule
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import Rays, allocate_rays
from raybatch_addon.core.wavefront.stages.trace import TraceFeatures, Traversal, trace_stage
from raybatch_addon.core.wavefront.stages.visit import NO_ANY_HIT, Batch, Launch, VisitFeatures, VisitTask, visit_stage
from raybatch_addon.core.wavefront.tracer import SlotList

TRAVERSALS = {Layout.BOXES: Traversal.BOXES, Layout.QUANTISED: Traversal.QUANTISED}
COUNTS = ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")
HITS = ("hit_t", "hit_instance", "hit_primitive", "hit_uv")
RULES = {
    "one": CutRule(),
    "root": CutRule(size=1, depth_max=0),
    "some levels": CutRule(size=1, depth_max=2),
    "nodes": CutRule(size=12),
    "each node": CutRule(size=1, depth_max=10**6),
    "area": CutRule(top_bytes_max=3000),
}


def random_rays(count: int, seed: int, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins in a cube, directions of any length, some along axes and planes."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction[: count // 8, rng.integers(3)] = 0.0
    direction[: count // 16] = np.eye(3)[rng.integers(3, size=count // 16)] * rng.choice([-1, 1], (count // 16, 1))
    return rng.uniform(-reach, reach, (count, 3)), direction * 10 ** rng.uniform(-2, 2, (count, 1))


def slivers(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Thin, flat and degenerate triangles."""
    rng = np.random.default_rng(12)
    along = rng.normal(size=(count, 1, 3)) * np.array([0.0, 1.0, 0.5])[None, :, None]
    positions = rng.uniform(-1, 1, (count, 1, 3)) + along + rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-8, -2, (count, 1, 1))
    positions[: count // 4, :, rng.integers(3)] = 0.25  # in a plane across an axis
    positions[count // 4 : count // 3, 1] = positions[count // 4 : count // 3, 0]  # no area
    return positions.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def turned(seed: int, count: int, reach: float) -> np.ndarray:
    """Matrices of places within `reach`, sizes and turns at random, float32, shape [count, 3, 4]."""
    rng = np.random.default_rng(seed)
    turns, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    places = rng.uniform(-reach, reach, (count, 3, 1))
    return np.concatenate([turns * rng.uniform(0.1, 1.5, (count, 1, 3)), places], 2).astype(np.float32)


def doubling(count: int, each: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """Triangles whose sizes and distances grow, so that each split leaves out few."""
    size = 2.0 ** (each * np.arange(count) - each * count / 2)
    corner = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    positions = (corner[None] * size[:, None, None]).reshape(-1, 3).astype(np.float32)
    return positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3)


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, and the rays that are sent into it."""

    built: BuiltTree
    origin: np.ndarray
    direction: np.ndarray

    @property
    def instancing(self) -> bool:
        return self.built.instancing


def of_objects(
    device: str, meshes: list[tuple[Mesh, list[np.ndarray]]], instancing: bool, rays, visibility: int | None = None,
    layout: Layout = Layout.QUANTISED,
) -> Case:  # fmt: skip
    """A scene of meshes in their places; with `visibility` (a seed) not every instance is seen by every ray."""
    scene = scenes.scene([(mesh, place, scenes.diffuse()) for mesh, places in meshes for place in places])
    instances = scene.instances
    if visibility is not None:
        bits = np.random.default_rng(visibility).integers(1, 4, len(instances)).astype(np.int32)
        instances = dataclasses.replace(instances, visibility=bits)
        scene = dataclasses.replace(scene, instances=instances)
    flat, where = flatten(scene), wp.get_device(device)
    geometry = upload_geometry(flat, scene, where)
    built = build_scene_tree(flat, geometry, scene.instances.visibility, instancing, where, layout)
    return Case(built, *(x.astype(np.float32) for x in rays))


def sliver_rays(positions: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at points of the triangles."""
    rng = np.random.default_rng(3)
    weights = rng.dirichlet([0.3] * 3, count)
    target = np.einsum("ri,rij->rj", weights, positions[triangles[rng.integers(len(triangles), size=count)]].astype(np.float64))
    origin = rng.uniform(-3, 3, (count, 3))
    return origin, target - origin.astype(np.float32)


def not_finite(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays with infinite, absent and tiny parts among others."""
    origin, direction = (x.astype(np.float32) for x in random_rays(count, seed))
    rng = np.random.default_rng(seed)
    odd = np.float32([np.nan, np.inf, -np.inf, 0.0, 3e38, 1e-42])
    for values in (origin, direction):
        rows = rng.random(count) < 0.4
        values[rows, rng.integers(3, size=rows.sum())] = rng.choice(odd, rows.sum())
    direction[: count // 20] = 0.0
    return origin, direction


@functools.cache
def case(name: str, device: str, layout: Layout = Layout.QUANTISED) -> Case:
    """The scenes; `deep top` has more levels above the meshes than one word of a trail has, `deep` more than two words in the mesh."""
    away = np.random.default_rng(9).uniform(0, 1, (400, 3)) + [0, 0, 0.5]
    if name == "soup":
        return of_objects(device, [(Mesh("soup", *soup(700, 1)), [scenes.IDENTITY])], False, random_rays(600, 2))
    if name == "slivers":
        mesh = slivers(400)
        return of_objects(device, [(Mesh("slivers", *mesh), [scenes.IDENTITY])], False, sliver_rays(*mesh, 600))
    if name == "odd rays":
        return of_objects(device, [(Mesh("ball", *sphere(14)), [scenes.IDENTITY])], False, not_finite(600, 5))
    if name == "deep":
        return of_objects(device, [(Mesh("deep", *doubling(240)), [scenes.IDENTITY])], False, (0 * away, away))
    if name == "instances":
        shared = [(Mesh("ball", *sphere(9, 0.4)), list(turned(1, 30, 2.0))), (Mesh("soup", *soup(150, 4, 0.2)), list(turned(2, 30, 2.0)))]
        baked = [(Mesh(f"baked {i}", *soup(40, 9 + i, 0.4)), [scenes.IDENTITY]) for i in range(3)]
        return of_objects(device, shared + baked, True, random_rays(800, 7, 3.0), visibility=5, layout=layout)
    if name == "odd rays, instances":
        return of_objects(device, [(Mesh("ball", *sphere(6, 0.4)), list(turned(3, 20, 1.0)))], True, not_finite(600, 8))
    assert name == "deep top"
    places = [scenes.translation(0, 0, 0, 2.0 ** (0.25 * i - 12)) for i in range(96)]
    return of_objects(device, [(Mesh("deep", *doubling(40)), places)], True, (0 * away, away))


CASES = ("soup", "slivers", "odd rays", "deep", "instances", "odd rays, instances", "deep top")


@functools.cache
def cut(name: str, rule: str, device: str) -> TreeletTree:
    return cut_scene_tree(case(name, device).built, RULES[rule], wp.get_device(device))


def t_max_of(count: int, seed: int) -> np.ndarray:
    """Far for most rays, and for some near, 0, negative or no number."""
    rng = np.random.default_rng(seed)
    t_max = np.full(count, np.inf, np.float32)
    some = rng.random(count) < 0.3
    t_max[some] = rng.choice(np.float32([0.5, 1.0, 1e-3, 0.0, -1.0, np.nan, 3e38]), some.sum())
    return t_max


def make_rays(made: Case, device: str, t_max: np.ndarray, shared_t: bool = False) -> Rays:
    """The case's rays; `shared_t`: `t_max` and `hit_t` are one array."""
    count = len(made.origin)
    rays = allocate_rays(count, wp.get_device(device))
    rays.origin = wp.array(made.origin, dtype=wp.vec3, device=device)
    rays.direction = wp.array(made.direction, dtype=wp.vec3, device=device)
    rays.t_max = wp.array(t_max, dtype=float, device=device)
    rays.visibility = wp.array(np.random.default_rng(1).integers(1, 4, count).astype(np.int32), dtype=int, device=device)
    for name in ("hit_instance", "hit_primitive"):
        getattr(rays, name).fill_(77)
    if shared_t:
        rays.hit_t = rays.t_max
    return rays


def uploaded(values, device: str) -> wp.array:
    return wp.array(np.array(values, np.int32), dtype=int, device=device)


@functools.cache
def stage_of(
    task: VisitTask, instancing: bool, counters: bool = False, interlocked: bool = False, launch: Launch = Launch(),
    traversal: Traversal = Traversal.QUANTISED,
):  # fmt: skip
    return visit_stage(VisitFeatures(traversal, task, instancing, counters, interlocked), launch)


@functools.cache
def whole_stage(
    any_hit: bool, instancing: bool, counters: bool = False, launch: Launch = Launch(), traversal: Traversal = Traversal.QUANTISED
):
    return trace_stage(TraceFeatures(traversal, any_hit, instancing, counters), launch)


def expected_hits(made: Case, device: str, t_max: np.ndarray, any_first: int) -> dict[str, np.ndarray]:
    """By the unbatched traversal of the uncut tree."""
    rays = make_rays(made, device, t_max)
    slots = np.arange(len(t_max))
    for any_hit, part in ((False, slots[slots < any_first]), (True, slots[slots >= any_first])):
        listed = SlotList(uploaded(part, device), uploaded([len(part)], device), len(part))
        whole_stage(any_hit, made.instancing, traversal=TRAVERSALS[made.built.layout]).launch(made.built.tree, rays, listed, None)
    return {name: getattr(rays, name).numpy() for name in HITS}


def check_same(rays: Rays, expected: dict[str, np.ndarray], any_first: int, t_max: np.ndarray) -> None:
    """All hits, to the bit; of any-hit rays whether there is one, and that their `t_max` is as it was."""
    for name in HITS:
        found = getattr(rays, name).numpy()[:any_first]
        assert np.array_equal(found.view(np.uint32), expected[name][:any_first].view(np.uint32)), name
    assert np.array_equal(rays.hit_instance.numpy()[any_first:], expected["hit_instance"][any_first:])
    assert np.array_equal(rays.t_max.numpy()[any_first:].view(np.uint32), t_max[any_first:].view(np.uint32))


class Journey:
    """Rays on their way through a cut tree: where each waits, on the host."""

    def __init__(self, made: TreeletTree, rays: Rays, any_first: int, counts=None, launch: Launch = Launch(), interlocked: bool = False):
        self.made, self.rays, self.any_first, self.counts = made, rays, any_first, counts
        self.launch, self.interlocked = launch, interlocked
        self.device, count = rays.origin.device, rays.origin.shape[0]
        self.progress = TopProgress()
        words = -(-made.levels // TRAIL_LEVELS)
        self.progress.trail = wp.full((words, count), 0xFFFFFFFF, dtype=wp.uint32, device=self.device)
        self.progress.entry = wp.full(count if made.instancing else 0, -5, dtype=int, device=self.device)
        self.progress.visits = wp.zeros(1, dtype=wp.int64, device=self.device)
        self.where = np.full(count, NEW, np.int32)

    def run(self, task: VisitTask, slots: np.ndarray, treelets: Treelets | None = None) -> None:
        """`task` for the rays in `slots`."""
        where = uploaded(self.where[slots], self.device)
        batch = Batch(uploaded(slots, self.device), where, uploaded([len(slots)], self.device), len(slots))
        stage = stage_of(task, self.made.instancing, self.counts is not None, self.interlocked, self.launch, TRAVERSALS[self.made.layout])
        stage.launch(self.made.tree, treelets or self.made.treelets, self.rays, self.progress, batch, self.any_first, self.counts)
        self.where[slots] = where.numpy()[: len(slots)]

    def visits(self) -> int:
        return int(self.progress.visits.numpy()[0])

    def alternate(self, rng: np.random.Generator) -> int:
        """Top level and treelets in turn, rays in batches at random, until all are done; how many visits there should have been."""
        inside = np.zeros(len(self.where), bool)  # the ray was in the treelet that it waits at
        visits = 0
        for _ in range(100_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return visits
            chosen = rng.permutation(alive)[: rng.integers(1, 2 * len(alive) + 2)]
            entering = chosen[(self.where[chosen] >= 0) & ~inside[chosen]]
            going_on = np.setdiff1d(chosen, entering)
            if len(entering):
                before = self.where[entering]
                self.run(VisitTask.TREELET, entering)
                assert ((self.where[entering] == DONE) | (self.where[entering] == before)).all()
                assert (self.where[entering[entering < self.any_first]] != DONE).all()
                inside[entering] = True
                visits += len(entering)
            if len(going_on):
                before = self.where[going_on]
                self.run(VisitTask.TOP, rng.permutation(going_on))
                assert (self.where[going_on] != NEW).all()
                assert (self.where[going_on] != before).all() or self.made.instancing
                inside[going_on] = False
        raise AssertionError("rays never end")

    def go_on(self, rng: np.random.Generator, there: float, nodes_there: float) -> None:
        """`GO_ON` with another choice of treelets there each time, until all rays are done."""
        total = self.made.treelet_count
        tables = {name: getattr(self.made.treelets, name).numpy() for name in ("nodes", "triangles")}
        for _ in range(100_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return
            whole = rng.random(total) < there
            waited = self.where[alive][self.where[alive] >= 0]
            if len(waited):
                whole[rng.choice(waited)] = True  # what the scheduler does: somebody gets on
            nodes = whole | (rng.random(total) < nodes_there)
            treelets = Treelets()
            treelets.of_node, treelets.root = self.made.treelets.of_node, self.made.treelets.root
            treelets.nodes = wp.array(np.where(nodes, tables["nodes"], 0).astype(np.uint64), dtype=wp.uint64, device=self.device)
            treelets.triangles = wp.array(np.where(whole, tables["triangles"], 0).astype(np.uint64), dtype=wp.uint64, device=self.device)
            before = self.where[alive].copy()
            self.run(VisitTask.GO_ON, rng.permutation(alive), treelets)
            after = self.where[alive]
            assert (after != NEW).all() and not whole[after[after >= 0]].any()
            absent = (before >= 0) & ~nodes[np.maximum(before, 0)]
            assert np.array_equal(after[absent], before[absent])
        raise AssertionError("rays never end")


def start(
    name: str, rule: str, device: str, any_first: int | None = None, shared_t: bool = True, **more
) -> tuple[Journey, dict[str, np.ndarray], np.ndarray]:
    """Rays of a case, a third of which ask for any hit by default, and the hits that they should find."""
    made = case(name, device)
    any_first = 2 * len(made.origin) // 3 if any_first is None else any_first
    t_max = t_max_of(len(made.origin), 4)
    rays = make_rays(made, device, t_max, shared_t)
    return Journey(cut(name, rule, device), rays, any_first, **more), expected_hits(made, device, t_max, any_first), t_max


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", CASES)
def test_top_level_and_treelets_in_turn(device, name, rule):
    journey, expected, t_max = start(name, rule, device)
    visits = journey.alternate(np.random.default_rng(1))
    check_same(journey.rays, expected, journey.any_first, t_max)
    assert journey.visits() == visits > 0


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", CASES)
def test_going_on_through_what_is_there(device, name, rule):
    journey, expected, t_max = start(name, rule, device)
    journey.go_on(np.random.default_rng(2), 0.4, 0.5)
    check_same(journey.rays, expected, journey.any_first, t_max)
    # all there: one launch, and no more visits than treelets that a ray meets
    whole, _, _ = start(name, rule, device)
    whole.run(VisitTask.GO_ON, np.arange(len(t_max)))
    assert (whole.where == DONE).all()
    check_same(whole.rays, expected, whole.any_first, t_max)
    assert 0 < whole.visits()


def test_the_cases_are_what_they_should_be(device):
    """Trails of more than one and more than two words; hits in each case; treelets that some rays come to and others do not."""
    if device == "cpu":  # builders of other devices make other trees
        assert cut("deep", "each node", device).levels > 2 * TRAIL_LEVELS
        assert cut("deep top", "each node", device).levels > cut("deep top", "one", device).levels > TRAIL_LEVELS
    for name in CASES:
        hits = expected_hits(case(name, device), device, t_max_of(len(case(name, device).origin), 4), NO_ANY_HIT)
        assert 0.02 < (hits["hit_instance"] >= 0).mean() < 0.98, name
    everywhere = expected_hits(case("instances", device), device, np.full(800, np.inf, np.float32), NO_ANY_HIT)
    assert len(np.unique(everywhere["hit_instance"])) > 20


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(CASES), rule=st.sampled_from(list(RULES)), seed=st.integers(0, 1000), any_share=st.floats(0, 1),
    there=st.floats(0, 1), nodes_there=st.floats(0, 1), shared_t=st.booleans(), in_turn=st.booleans(),
)  # fmt: skip
def test_the_order_of_visits_changes_nothing(name, rule, seed, any_share, there, nodes_there, shared_t, in_turn):
    count = len(case(name, DEVICE).origin)
    journey, expected, t_max = start(name, rule, DEVICE, int(any_share * count), shared_t)
    rng = np.random.default_rng(seed)
    if in_turn:
        journey.alternate(rng)
    else:
        journey.go_on(rng, there, nodes_there)
    check_same(journey.rays, expected, journey.any_first, t_max)


def test_only_listed_rays_are_touched(device):
    made = case("soup", device)
    t_max = np.full(len(made.origin), np.inf, np.float32)
    journey = Journey(cut("soup", "nodes", device), make_rays(made, device, t_max), NO_ANY_HIT)
    slots = np.arange(5, 400, 3)
    journey.where[slots[::2]] = DONE
    journey.run(VisitTask.GO_ON, slots)
    fresh = slots[1::2]
    assert (journey.where[slots] == DONE).all()
    others = np.setdiff1d(np.arange(len(t_max)), fresh)
    assert (journey.rays.hit_instance.numpy()[others] == 77).all() and (journey.rays.hit_instance.numpy()[fresh] != 77).all()
    journey.run(VisitTask.TOP, np.arange(0))


@pytest.mark.parametrize("name", ("soup", "instances"))
def test_empty_scenes(device, name):
    made = cut(name, "nodes", device)
    empty = dataclasses.replace(made, tree=type(made.tree)())
    for field in made.tree._cls.vars:
        setattr(empty.tree, field, getattr(made.tree, field))
    empty.tree.entry_count = 0
    t_max = np.full(len(case(name, device).origin), 5.0, np.float32)
    for task in (VisitTask.TOP, VisitTask.GO_ON):
        journey = Journey(empty, make_rays(case(name, device), device, t_max), 300)
        journey.run(task, np.arange(len(t_max)))
        assert (journey.where == DONE).all() and (journey.rays.hit_instance.numpy() == -1).all()
        assert (journey.rays.hit_t.numpy()[:300] == 5.0).all() and (journey.rays.hit_primitive.numpy()[:300] == -1).all()


@pytest.mark.parametrize("name", ("soup", "instances"))
def test_nodes_alone_let_rays_pass_that_need_no_triangle(device, name):
    """With all nodes and no triangles, rays end that meet no leaf; the others wait, and nothing counts as a visit."""
    journey, expected, _ = start(name, "nodes", device, NO_ANY_HIT, False)
    bare, _, _ = start(name, "nodes", device, NO_ANY_HIT, False)
    made, everyone = journey.made, np.arange(len(journey.where))
    treelets = Treelets()
    treelets.of_node, treelets.root, treelets.nodes = made.treelets.of_node, made.treelets.root, made.treelets.nodes
    treelets.triangles = wp.zeros_like(made.treelets.triangles)
    journey.run(VisitTask.GO_ON, everyone, treelets)
    treelets.nodes = wp.zeros_like(treelets.nodes)
    bare.run(VisitTask.GO_ON, everyone, treelets)
    done, done_bare = journey.where == DONE, bare.where == DONE
    assert journey.visits() == bare.visits() == 0
    assert (done_bare <= done).all() and done_bare.sum() < done.sum() < len(done)
    assert (expected["hit_instance"][done] == -1).all()
    again = journey.where.copy()
    journey.run(VisitTask.GO_ON, everyone, treelets)  # nothing there: all come out as they went in
    assert np.array_equal(journey.where, again)


def counted(count: int, device: str) -> TraceCounts:
    counts = TraceCounts()
    for name in COUNTS:
        setattr(counts, name, wp.full(count, -9, dtype=int, device=device))
    counts.lanes = wp.zeros(6, dtype=wp.int64, device=device)
    return counts


@pytest.mark.parametrize("name", ("soup", "instances"))
def test_counters(device, name):
    count = len(case(name, device).origin)
    journey, expected, t_max = start(name, "nodes", device, NO_ANY_HIT, counts=counted(count, device))
    journey.alternate(np.random.default_rng(3))
    check_same(journey.rays, expected, NO_ANY_HIT, t_max)
    made = {name: getattr(journey.counts, name).numpy() for name in COUNTS}
    assert made["treelet_visits"].sum() == journey.visits() > 0
    assert np.array_equal(made["queued"], 2 * made["treelet_visits"])  # before each treelet and behind it
    # with all there in one launch: the steps of the uncut tree, but where triangles of an earlier part are tested sooner
    whole, _, _ = start(name, "nodes", device, NO_ANY_HIT, counts=counted(count, device))
    whole.run(VisitTask.GO_ON, np.arange(count))
    uncut = counted(count, device)
    rays = make_rays(case(name, device), device, t_max)
    listed = SlotList(uploaded(np.arange(count), device), uploaded([count], device), count)
    whole_stage(False, journey.made.instancing, True).launch(case(name, device).built.tree, rays, listed, uncut)
    steps, steps_uncut = whole.counts.node_steps.numpy().sum(), uncut.node_steps.numpy().sum()
    assert 0.8 * steps_uncut < steps <= steps_uncut
    assert steps <= made["node_steps"].sum()
    assert whole.counts.queued.numpy().sum() == 0 and np.array_equal(whole.counts.treelet_visits.numpy() > 0, made["treelet_visits"] > 0)
    lanes = whole.counts.lanes.numpy()
    assert lanes[2] == steps and (lanes[::2] <= lanes[1::2]).all()


LAUNCHES = (Launch(single_lane=True), Launch(warp_count=3, block_size=64), Launch(register_cap=64, block_size=1024), Launch(warp_count=1))


@pytest.mark.parametrize("launch", LAUNCHES, ids=str)
@pytest.mark.parametrize("name", ("soup", "instances"))
def test_launch_settings_change_no_hit(device, name, launch):
    journey, expected, t_max = start(name, "nodes", device, launch=launch, interlocked=True)
    journey.alternate(np.random.default_rng(4))
    check_same(journey.rays, expected, journey.any_first, t_max)
    whole, _, _ = start(name, "nodes", device, launch=launch)
    whole.go_on(np.random.default_rng(4), 0.5, 0.5)
    check_same(whole.rays, expected, whole.any_first, t_max)
    made = case(name, device)
    rays = make_rays(made, device, t_max)
    count = len(t_max)
    listed = SlotList(uploaded(np.arange(count), device), uploaded([count], device), count)
    whole_stage(False, made.instancing, launch=launch).launch(made.built.tree, rays, listed, None)
    closest = expected_hits(made, device, t_max, NO_ANY_HIT)
    check_same(rays, closest, NO_ANY_HIT, t_max)


@pytest.mark.skipif(DEVICE != "cpu", reason="the layout of CPUs")
@pytest.mark.parametrize("launch", (Launch(single_lane=True), Launch(warp_count=7), Launch(warp_count=1000)), ids=str)
def test_launch_settings_on_the_cpu(device, launch):
    """BOXES: slices of the list, and one ray at a time."""
    made = case("instances", device, Layout.BOXES)
    count, any_first = len(made.origin), 500
    t_max = t_max_of(count, 4)
    expected = expected_hits(made, device, t_max, any_first)
    made_cut = cut_scene_tree(made.built, RULES["nodes"], wp.get_device(device))
    journey = Journey(made_cut, make_rays(made, device, t_max), any_first, launch=launch)
    journey.go_on(np.random.default_rng(5), 0.5, 0.5)
    check_same(journey.rays, expected, any_first, t_max)
    rays = make_rays(made, device, t_max)
    for any_hit, part in ((False, np.arange(any_first)), (True, np.arange(any_first, count))):
        listed = SlotList(uploaded(part, device), uploaded([len(part)], device), len(part))
        whole_stage(any_hit, True, launch=launch, traversal=Traversal.BOXES).launch(made.built.tree, rays, listed, None)
    check_same(rays, expected, any_first, t_max)


OUT_OF_RANGE = ({"block_size": 48}, {"block_size": 2048}, {"register_cap": 8}, {"register_cap": 256}, {"warp_count": -1})


@pytest.mark.parametrize("values", OUT_OF_RANGE)
def test_launch_settings_out_of_range(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Launch(**values)
    with pytest.raises(ValueError, match="lower block_size"):
        Launch(register_cap=128, block_size=1024)


def test_capped_kernels_are_kernels_of_their_own():
    plain, capped = (stage_of(VisitTask.TOP, False, launch=Launch(register_cap=cap)).kernels[0] for cap in (0, 72))
    assert capped is not plain and capped.options["cuda_max_registers"] == 72 and "cuda_max_registers" not in plain.options
    off, off_capped = (whole_stage(False, False, launch=Launch(register_cap=cap)).kernels[0] for cap in (0, 72))
    assert off_capped.options["cuda_max_registers"] == 72 and "cuda_max_registers" not in off.options


def test_tasks_are_compiled_apart():
    made = [VisitOptions(task, instancing, refill=refill) for task in VisitTask for instancing in (False, True) for refill in (8, 32)]
    assert len({visit_text(options) for options in made}) == 12
    with pytest.raises(ValueError, match="refill"):
        VisitOptions(VisitTask.TOP, False, refill=0)
