"""Scenes in which things move far while the shutter is open, and rays through them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from raybatch_addon.core.scene.description import Mesh, Scene
from raybatch_addon.core.scene.motion import instance_maps, maps_at, motion_keys
from studies import scenes

STEPS = 5  # of maps and vertices


def _scene(meshes: Sequence[Mesh], placed: np.ndarray, ways: np.ndarray | None = None) -> Scene:
    """Meshes in a scene whose instances are of the meshes `placed`; `ways` are maps [n, steps, 3, 4]."""
    plain = [(mesh, scenes.diffuse(0.5)) for mesh in meshes]
    made = scenes.scene_of(plain, scenes.look_at(_VIEW, "z", 8, 8), 8, 8)
    count = len(placed)
    at = made.instances
    transform = np.repeat(np.eye(3, 4, dtype=np.float32)[None], count, 0)
    instances = replace(
        at,
        mesh=placed.astype(np.int32),
        transform=transform if ways is None else ways[:, STEPS // 2].astype(np.float32),
        slot_first=at.slot_first[placed],
        visibility=np.full(count, at.visibility[0], np.int32),
        object=at.object[placed],
        motion=None if ways is None else instance_maps(ways.astype(np.float32)),
    )
    return replace(made, instances=instances)


_VIEW = scenes.View((0.0, -3.0, 1.0), (0.0, 0.0, 0.0), 1.0)


def ball(rows: int, radius: float) -> Mesh:
    """A ball of 4 rows² triangles, but for those that would have no area at its poles."""
    columns = 2 * rows
    polar, around = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    first = i * (columns + 1) + j
    upper = np.stack([first, first + columns + 1, first + columns + 2], -1)[1:]
    lower = np.stack([first, first + columns + 2, first + 1], -1)[:-1]
    # the row at each pole has one triangle a column
    upper = np.concatenate([upper.reshape(-1, 3), np.stack([first, first + columns + 1, first + columns + 2], -1)[0]])
    return Mesh(
        "Ball",
        (radius * points.reshape(-1, 3)).astype(np.float32),
        np.concatenate([upper, lower.reshape(-1, 3)]).astype(np.int32),
    )


def _plate(half: float, height: float) -> Mesh:
    corners = [(-half, -half, height), (half, -half, height), (half, half, height), (-half, half, height)]
    return scenes.quad("Plate", corners)


def flying(count: int, rows: int) -> Scene:
    """Balls all over a cube of edge 2 m, each of which flies six times its size, in a direction of its own."""
    rng = np.random.default_rng(1)
    radius = 0.05
    middle = rng.uniform(-1, 1, (count, 3))
    way = rng.normal(size=(count, 3))
    way *= 12 * radius / np.linalg.norm(way, axis=1, keepdims=True)
    ways = np.zeros((count, STEPS, 3, 4))
    ways[..., :3] = np.eye(3)
    ways[..., 3] = middle[:, None] + np.linspace(-0.5, 0.5, STEPS)[None, :, None] * way[:, None]
    return _scene([ball(rows, radius)], np.zeros(count, int), ways)


def field(count: int) -> Scene:
    """A field of grass in a square of edge 4 m. Each blade has three triangles, 0.3 m high together, and sways by as
    much: every triangle moves many times its size, neighbours alike.
    """
    rng = np.random.default_rng(2)
    foot = np.stack([*rng.uniform(-2, 2, (2, count)), np.zeros(count)], -1)
    turn, height, wide = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.2, 0.4, count), 0.006
    across = wide / 2 * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], -1)
    lean = np.stack([*rng.normal(0, 0.15, (2, count)), np.zeros(count)], -1)

    def at(time: float) -> np.ndarray:
        gust = np.sin(2 * foot[:, 0] + 1.5 * foot[:, 1] + np.pi * (time - 0.5)) + 0.3 * rng_phase(time)
        swing = lean + gust[:, None] * np.array([0.8, 0.4, 0.0])
        points = []
        for share, width in ((0.0, 1.0), (0.5, 0.8), (1.0, 0.0)):
            angle = share**2 * swing
            centre = foot + height[:, None] * (share * np.array([0, 0, 1]) + share * angle - [0, 0, 0.3] * angle**2)
            points += [centre - width * across, centre + width * across] if width else [centre]
        return np.stack(points, 1).reshape(-1, 3).astype(np.float32)

    phase = rng.uniform(0, 2 * np.pi, count)

    def rng_phase(time: float) -> np.ndarray:
        return np.sin(phase + 2 * np.pi * time)

    corner = 5 * np.arange(count)[:, None, None]
    triangles = (corner + np.array([(0, 1, 2), (1, 3, 2), (2, 3, 4)])).reshape(-1, 3).astype(np.int32)
    steps = np.stack([at(time) for time in np.linspace(0, 1, STEPS)])
    grass = Mesh("Grass", steps[STEPS // 2], triangles, motion=steps)
    return _scene([grass], np.zeros(1, int))


def rotor(rows: int) -> Scene:
    """A wing 2 m long and a tenth as wide, which turns by 90 degrees, among balls that stand still."""
    rng = np.random.default_rng(3)
    count = 60
    wing = ball(rows, 1.0)
    wing = replace(wing, name="Wing", positions=wing.positions * np.array([1, 0.05, 0.02], np.float32))
    ways = np.zeros((count + 1, STEPS, 3, 4))
    ways[..., :3] = np.eye(3)
    ways[1:, :, :, 3] = rng.uniform(-1, 1, (count, 1, 3))
    for step, angle in enumerate(np.linspace(0, np.pi / 2, STEPS)):
        cos, sin = np.cos(angle), np.sin(angle)
        ways[0, step, :, :3] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
    return _scene([wing, ball(rows, 0.05)], np.append(0, np.ones(count, int)), ways)


def crossing(count: int, rows: int) -> Scene:
    """Balls that stand still in a layer of edge 40 m, and one that crosses a twentieth of it."""
    rng = np.random.default_rng(4)
    ways = np.zeros((count, STEPS, 3, 4))
    ways[..., :3] = np.eye(3)
    ways[..., 3] = (rng.uniform(-20, 20, (count, 3)) * [1, 1, 0.02])[:, None]
    ways[0, :, 0, 3] = np.linspace(-1, 1, STEPS)
    return _scene([ball(rows, 0.15)], np.zeros(count, int), ways)


SCENES: dict[str, Callable[[bool], Scene]] = {
    "balls that fly": lambda quick: flying(60 if quick else 400, 6 if quick else 16),
    "grass that sways": lambda quick: field(2000 if quick else 100_000),
    "a wing that turns": lambda quick: rotor(8 if quick else 40),
    "one ball among many": lambda quick: crossing(200 if quick else 20_000, 6 if quick else 16),
}


class AimedRays(NamedTuple):
    """Rays and their times: origin, direction, time."""

    origin: np.ndarray
    direction: np.ndarray
    time: np.ndarray

    def at(self, which: np.ndarray) -> AimedRays:
        """Some of them."""
        return AimedRays(self.origin[which], self.direction[which], self.time[which])


def aimed_rays(box: np.ndarray, count: int) -> AimedRays:
    """Rays from points in `box` [2, 3], and a little around it, to others, at times of all kinds."""
    rng = np.random.default_rng(5)
    low, high = box.astype(np.float64)
    origin, aim = low + rng.uniform(-0.1, 1.1, (count, 3)) * (high - low), low + rng.random((count, 3)) * (high - low)
    way = aim - origin
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return AimedRays(origin.astype(np.float32), way.astype(np.float32), rng.random(count, np.float32))


def part_of_time(scene: Scene, first: float, end: float) -> Scene:
    """What `scene` is from `first` to `end`, for a shutter that is open for that part of its time alone."""
    instances = scene.instances
    meshes = tuple(
        mesh if mesh.motion is None else replace(mesh, motion=_vertices_between(mesh.motion, first, end))
        for mesh in scene.meshes
    )
    if instances.motion is not None:
        maps = maps_at(motion_keys(instances.motion.maps), np.linspace(first, end, STEPS)).astype(np.float32)
        instances = replace(instances, motion=replace(instances.motion, maps=maps), transform=maps[:, STEPS // 2])
    meshes = tuple(
        mesh if mesh.motion is None else replace(mesh, positions=mesh.motion[len(mesh.motion) // 2]) for mesh in meshes
    )
    return replace(scene, meshes=meshes, instances=instances)


def _vertices_between(steps: np.ndarray, first: float, end: float) -> np.ndarray:
    """Vertices at evenly spaced times from `first` to `end`, the steps in between among them."""
    parts = max(round((end - first) * (len(steps) - 1)), 1)
    at = np.linspace(first, end, parts + 1) * (len(steps) - 1)
    before = np.minimum(at.astype(int), len(steps) - 2)
    share = (at - before)[:, None, None].astype(np.float32)
    return ((1 - share) * steps[before] + share * steps[before + 1]).astype(np.float32)


def still_at(scene: Scene, time: float) -> Scene:
    """`scene` as it is at one time, in the same trees."""
    return part_of_time(scene, time, time + 1e-7)
