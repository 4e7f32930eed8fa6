"""Quantised trees cut into treelets, and the rays that are sent into them."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import allocate_rays
from tests.support import scenes
from tests.support.wide_trees import soup, sphere

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
    positions = (
        rng.uniform(-1, 1, (count, 1, 3))
        + along
        + rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-8, -2, (count, 1, 1))
    )
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
    device: str,
    meshes: list[tuple[Mesh, list[np.ndarray]]],
    instancing: bool,
    rays,
    visibility: int | None = None,
    layout: Layout = Layout.QUANTISED,
) -> Case:
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
    target = np.einsum(
        "ri,rij->rj", weights, positions[triangles[rng.integers(len(triangles), size=count)]].astype(np.float64)
    )
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
    """The scenes; `deep top` has more levels above the meshes than one word of a trail has, `deep` more than two words
    in the mesh.
    """
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
        shared = [
            (Mesh("ball", *sphere(9, 0.4)), list(turned(1, 30, 2.0))),
            (Mesh("soup", *soup(150, 4, 0.2)), list(turned(2, 30, 2.0))),
        ]
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
    rays.visibility = wp.array(
        np.random.default_rng(1).integers(1, 4, count).astype(np.int32), dtype=int, device=device
    )
    for name in ("hit_instance", "hit_primitive"):
        getattr(rays, name).fill_(77)
    if shared_t:
        rays.hit_t = rays.t_max
    return rays


def uploaded(values, device: str) -> wp.array:
    return wp.array(np.array(values, np.int32), dtype=int, device=device)
