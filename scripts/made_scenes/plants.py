"""Meshes of plants and rocks, made by rule: coarse each, because there are millions of instances."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import Mesh


def tube(path: np.ndarray, radii: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """A tube along `path` [n, 3], open at its ends: vertices and triangles."""
    angles = 2 * math.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], 1)
    vertices = (path[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    across, along = np.meshgrid(np.arange(sides), np.arange(len(path) - 1))
    a, b = along * sides + across, along * sides + (across + 1) % sides
    return vertices, _quads(a, b, b + sides, a + sides)


def blade(length: float, width: float, bend: float, steps: int, fold: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A leaf along X that bends down: two strips beside its middle line, which is `fold` lower [m]."""
    t = np.linspace(0, 1, steps + 1)
    x, z = length * t, bend * length * (t - t * t * 1.6)
    half = width * np.sin(math.pi * np.clip(0.08 + 0.92 * t, 0, 1)) * 0.5
    left, right = np.stack([x, half, z], 1), np.stack([x, -half, z], 1)
    middle = np.stack([x, 0 * x, z - fold], 1)
    a = np.arange(steps)
    triangles = [_quads(a, a + 1, a + steps + 2, a + steps + 1)]
    triangles += [_quads(a + steps + 1, a + steps + 2, a + 2 * steps + 3, a + 2 * steps + 2)]
    return np.concatenate([left, middle, right]), np.concatenate(triangles)


def trunk(name: str, height: float, radius: float, lean: float, detail: int) -> Mesh:
    """A trunk that stands on the origin, and leans towards +X."""
    t = np.linspace(0, 1, 3 * detail + 1)
    path = np.stack([lean * height * t * t, 0 * t, height * t], 1)
    radii = radius * (1 - 0.6 * t) * (1 + 0.06 * np.cos(40 * t))
    return _mesh(name, [tube(path, radii, 4 + 2 * detail)])


def frond(name: str, length: float, detail: int) -> Mesh:
    """A palm leaf along X: a rib, and leaflets on both of its sides."""
    count, parts = 6 * detail, []
    t = np.linspace(0.12, 1, count)
    along = np.stack([length * t, 0 * t, 0.5 * length * (t - 1.5 * t * t)], 1)
    parts.append(tube(along[:, [1, 2, 0]], 0.012 * length * (1.05 - t), 3))
    parts[0] = (parts[0][0][:, [2, 0, 1]], parts[0][1])
    for side in (-1, 1):
        for i in range(count):
            reach = 0.36 * length * math.sin(math.pi * (0.15 + 0.8 * t[i]))
            vertices, triangles = blade(reach, 0.035 * length, -0.35, 1 + detail // 2, 0.004 * length)
            angle = side * (1.25 - 0.7 * t[i])
            turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
            parts.append((vertices @ turn.T + along[i], triangles))
    return _mesh(name, parts)


def tuft(name: str, count: int, height: float, detail: int, seed: int) -> Mesh:
    """Blades of grass, or of a shrub, that spread from the origin."""
    random, parts = np.random.default_rng(seed), []
    for angle, steep, length in zip(
        random.uniform(0, 2 * math.pi, count), random.uniform(0.5, 1.35, count), random.uniform(0.6, 1.0, count)
    ):
        vertices, triangles = blade(length * height, 0.09 * height, 0.25, detail, 0.0)
        upright = np.array([[math.cos(steep), 0, -math.sin(steep)], [0, 1, 0], [math.sin(steep), 0, math.cos(steep)]])
        turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
        parts.append((vertices @ (turn @ upright).T, triangles))
    return _mesh(name, parts)


def twig(name: str, count: int, length: float, detail: int, seed: int) -> Mesh:
    """A twig along X with `count` leaves around it."""
    random, parts = np.random.default_rng(seed), []
    t = np.linspace(0, 1, 2 + detail)
    vertices, triangles = tube(np.stack([0 * t, 0.06 * length * t * t, length * t], 1), 0.02 * length * (1.1 - t), 4)
    parts.append((vertices[:, [2, 1, 0]], triangles[:, [0, 2, 1]]))
    for place in random.uniform(0.2, 1.0, count):
        vertices, triangles = blade(0.3 * length, 0.12 * length, 0.2, detail, 0.01 * length)
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        parts.append((vertices @ turn.T + [place * length, 0.06 * length * place**2, 0], triangles))
    return _mesh(name, parts)


def rock(name: str, radius: float, detail: int, seed: int) -> Mesh:
    """A bumpy stone, half of it below the origin."""
    random = np.random.default_rng(seed)
    rings, sides = 3 + 3 * detail, 4 + 4 * detail
    across, along = np.meshgrid(np.arange(sides), np.arange(rings + 1))
    u, v = 2 * math.pi * across / sides, math.pi * along / rings
    directions = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1)
    size = np.ones(directions.shape[:2])
    for _ in range(6):
        axis = random.normal(size=3)
        size += 0.13 * np.sin(3 * directions @ axis + random.uniform(0, 6))
    vertices = (radius * size[..., None] * directions * [1.0, 0.8, 0.6]).reshape(-1, 3)
    a = along[:-1] * sides + across[:-1]
    b = along[:-1] * sides + (across[:-1] + 1) % sides
    return _mesh(name, [(vertices, _quads(a, a + sides, b + sides, b))])


def _quads(*corners: np.ndarray) -> np.ndarray:
    """Two triangles for each quad."""
    a, b, c, d = (each.reshape(-1) for each in corners)
    return np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)


def _mesh(name: str, parts: list[tuple[np.ndarray, np.ndarray]]) -> Mesh:
    """All `parts` as one mesh."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return Mesh(
        name,
        np.concatenate([vertices for vertices, _ in parts]).astype(np.float32),
        np.concatenate([triangles + start for (_, triangles), start in zip(parts, first)]).astype(np.int32),
    )
