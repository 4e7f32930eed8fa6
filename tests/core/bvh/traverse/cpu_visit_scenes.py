"""Trees of BOXES cut into treelets, and the rays that are sent into them."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.rays import DeviceRayList, RayList, Rays, fill_list
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import allocate_rays
from tests.support import scenes
from tests.support.wide_trees import soup, sphere

CPU = wp.get_device("cpu")
NO_ANY_HIT = 2**31 - 1
RULES = {
    "one": CutRule(),
    "root": CutRule(size=1, depth_max=0),
    "two levels": CutRule(size=1, depth_max=2),
    "nodes": CutRule(size=12),
    "each node": CutRule(size=1, depth_max=10**6),
    "area": CutRule(top_bytes_max=6000),
}


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
        values[rows, rng.integers(3, size=rows.sum())] = rng.choice(
            np.float32([np.nan, np.inf, -np.inf, 0.0, 3e38, 1e-42]), rows.sum()
        )
    direction[: count // 20] = 0.0
    return origin, direction


def aimed_rays(mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, edges and points of triangles."""
    rng = np.random.default_rng(3)
    weights = rng.dirichlet([0.3] * 3, count)
    weights[: count // 3] = np.eye(3)[rng.integers(3, size=count // 3)]
    target = np.einsum(
        "ri,rij->rj", weights, mesh[0][mesh[1][rng.integers(len(mesh[1]), size=count)]].astype(np.float64)
    )
    origin = rng.uniform(-3, 3, (count, 3))
    return origin, target - origin.astype(np.float32)


def slivers(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles a million times as long as they are wide, and some without an area."""
    rng = np.random.default_rng(5)
    start, along, aside = (
        rng.uniform(-1, 1, (count, 3)),
        rng.normal(size=(count, 3)),
        1e-6 * rng.normal(size=(count, 3)),
    )
    corners = np.stack([start, start + along, start + 0.5 * along + aside], 1)
    corners[: count // 10, 1] = corners[: count // 10, 0]
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def doubling(count: int, each: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, one behind the other, whose sizes and distances grow by 2^each, so that each split leaves out few."""
    size = 2.0 ** (each * np.arange(count) - each * count / 2)
    corner = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    return (corner[None] * size[:, None, None]).reshape(-1, 3).astype(np.float32), np.arange(
        3 * count, dtype=np.int32
    ).reshape(-1, 3)


def turned(seed: int, count: int, reach: float) -> list[np.ndarray]:
    """Matrices of places within `reach`, with sizes and turns at random."""
    rng = np.random.default_rng(seed)
    turns, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return list(
        np.concatenate(
            [turns * rng.uniform(0.1, 1.5, (count, 1, 3)), rng.uniform(-reach, reach, (count, 3, 1))], 2
        ).astype(np.float32)
    )


def of_meshes(meshes, instancing: bool, rays, visibility: int | None = None) -> Case:
    """A scene of (vertices, triangles) in their places; with `visibility` (a seed) not every instance is seen by every
    ray.
    """
    listed = [(Mesh(f"mesh {i}", *mesh), places) for i, (mesh, places) in enumerate(meshes)]
    scene = scenes.scene([(mesh, place, scenes.diffuse()) for mesh, places in listed for place in places])
    if visibility is not None:
        bits = np.random.default_rng(visibility).integers(1, 4, len(scene.instances)).astype(np.int32)
        scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=bits))
    flat = flatten(scene)
    built = build_scene_tree(
        flat, upload_geometry(flat, scene, CPU), scene.instances.visibility, instancing, CPU, Layout.BOXES
    )
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
        return of_meshes(
            [((positions, np.tile(triangles, (25, 1))), here)], False, aimed_rays((positions, triangles), 500)
        )
    if name == "odd rays":
        return of_meshes([(sphere(20), here)], False, odd_rays(600, 5))
    if name == "deep":
        return of_meshes([(doubling(2200, 0.1), here)], False, (0 * away, away))
    if name == "instances":
        balls, places = turned(1, 30, 2.0), turned(2, 30, 2.0)
        shared = [(sphere(12, 0.4), balls + balls[:8]), (soup(400, 4, 0.2), places)]  # some twice in the same place
        return of_meshes(
            shared + [(soup(90, 9 + i, 0.4), here) for i in range(3)], True, random_rays(800, 7, 3.0), visibility=5
        )
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
    """The case's rays; with `shared_t` `t_max` and `hit_t` are one array, and any-hit rays have no primitive and
    weights.
    """
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
        rays.hit_primitive, rays.hit_uv = (
            rays.hit_primitive[: min(any_first, count)],
            rays.hit_uv[: min(any_first, count)],
        )
    return rays


def uploaded(values) -> wp.array:
    return wp.array(np.array(values, np.int32), dtype=int, device="cpu")


def list_of(slots) -> DeviceRayList:
    listed = DeviceRayList()
    fill_list(listed, RayList(uploaded(slots), uploaded([len(slots)]), len(slots)))
    return listed
