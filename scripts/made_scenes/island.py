"""An island in the manner of Disney's Moana: ground, sea, rocks, palms, shrubs and grass, placed by noise, height and
slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from lib.geometry_files import View

from made_scenes.assembled import Color, assembled
from made_scenes.noise import fractal_noise
from made_scenes.placing import PART, Placements, composed, standing
from made_scenes.plants import frond, rock, trunk, tuft
from made_scenes.terrain import Terrain
from raybatch_addon.core.scene.description import Mesh, Scene

SIZE = 2000.0  # edge of the square in which the island lies [m]
HEIGHT = 300.0  # of its mountains, about [m]
FRONDS = 24  # leaves of a palm
PALM_HEIGHT = 9.0  # [m]
# Tries to find a place, for each thing that is placed: where fewer places are good, fewer things are there
TRIES = 200

Density = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Of a kind of thing, 0..1: by height above the sea [m], upward part of the normal, and noise in -1..1."""


@dataclass(frozen=True)
class Growth:
    """A kind of thing that is placed."""

    meshes: tuple[int, ...]  # numbers of those that stand for it, each as often
    share: float  # of all instances
    density: Density
    scale: tuple[float, float]
    leans: float = 0.0  # how far it follows the ground's normal, 0..1
    parts: tuple[np.ndarray, np.ndarray] | None = None  # meshes and maps of what a thing is put together of


def island(count: int, terrain_edge: int, detail: int, seed: int, width: int, height: int) -> Scene:
    """About `count` instances on ground of `terrain_edge` x `terrain_edge` points."""
    random = np.random.default_rng(seed)
    terrain = Terrain.of(SIZE, terrain_edge, seed, island=True, height=HEIGHT)
    meshes: list[Mesh] = [terrain.mesh("Ground"), _sea()]
    colors: list[Color] = [(0.2, 0.16, 0.1), (0.02, 0.06, 0.09)]
    growths = _growths(meshes, colors, detail, seed, random)
    placements = Placements(count)
    one = standing(np.zeros((1, 3)), np.zeros(1), np.ones(1))
    placements.add(0, one)
    placements.add(1, one)
    for growth in growths:
        _grow(growth, int(growth.share * (count - 2)), terrain, placements, seed, random)
    eye = (-0.62 * SIZE, -0.5 * SIZE, 0.13 * SIZE)
    return assembled(meshes, colors, placements, View(eye, (0.0, 0.0, 0.15 * HEIGHT), math.radians(40)), width, height)


def _growths(
    meshes: list[Mesh], colors: list[Color], detail: int, seed: int, random: np.random.Generator
) -> list[Growth]:
    """What grows and lies there; its meshes are added to `meshes`."""

    def added(made: list[Mesh], color: Color) -> tuple[int, ...]:
        first = len(meshes)
        meshes.extend(made)
        colors.extend(tuple(float(c) for c in np.clip(color * random.uniform(0.8, 1.2, 3), 0, 0.8)) for _ in made)
        return tuple(range(first, len(meshes)))

    rocks = added([rock(f"Rock {i}", 1.5, detail, seed + i) for i in range(4)], (0.3, 0.28, 0.26))
    shrubs = added([tuft(f"Shrub {i}", 30 * detail, 1.4, detail, seed + 10 + i) for i in range(3)], (0.07, 0.2, 0.05))
    grass = added([tuft(f"Grass {i}", 10 * detail, 0.6, detail, seed + 20 + i) for i in range(3)], (0.18, 0.3, 0.06))
    ferns = added(
        [tuft(f"Fern {i}", 14 * detail, 0.9, 2 * detail, seed + 30 + i) for i in range(2)], (0.05, 0.24, 0.07)
    )
    stems = added([trunk(f"Palm {i}", PALM_HEIGHT, 0.16, 0.15 + 0.1 * i, detail) for i in range(2)], (0.3, 0.24, 0.17))
    leaves = added([frond(f"Palm Leaf {i}", 3.2 + 0.5 * i, detail) for i in range(2)], (0.1, 0.26, 0.05))
    growths = [
        Growth(rocks, 0.03, lambda z, up, noise: (z > -3) * (0.15 + 1.5 * (up < 0.75)) * 0.5, (0.4, 3.0), 0.8),
        Growth(ferns, 0.14, lambda z, up, noise: (z > 6) * (up > 0.6) * np.clip(noise + 0.4, 0, 1), (0.6, 1.6), 0.5),
        Growth(shrubs, 0.15, lambda z, up, noise: (z > 3) * (up > 0.65) * np.clip(noise + 0.3, 0, 1), (0.5, 1.6), 0.3),
    ]
    for stem, leaf, lean in zip(stems, leaves, (0.15, 0.25), strict=True):
        palm = _palm(stem, leaf, lean, random)
        growths.append(
            Growth(
                (stem,),
                0.16,
                lambda z, up, noise: (z > 1.5) * (z < 90) * (up > 0.8) * np.clip(0.25 - noise, 0, 1),
                (0.6, 1.5),
                parts=palm,
            )
        )
    rest = 1 - sum(each.share for each in growths)  # grass is last: it takes what room the others leave
    return [*growths, Growth(grass, rest, lambda z, up, noise: (z > 2) * (up > 0.7) * 1.0, (0.5, 1.5), 0.7)]


def _palm(stem: int, leaf: int, lean: float, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Meshes and maps of a palm's parts: the trunk, and leaves around its top."""
    maps = np.zeros((1 + FRONDS, 3, 4), np.float32)
    maps[0] = np.eye(3, 4)
    top = np.array([lean * PALM_HEIGHT, 0, PALM_HEIGHT])
    angles = 2.4 * np.arange(FRONDS)
    tilt = random.uniform(-0.5, 0.35, FRONDS)
    up = np.stack([-np.sin(tilt) * np.cos(angles), -np.sin(tilt) * np.sin(angles), np.cos(tilt)], 1)
    maps[1:] = standing(np.repeat(top[None], FRONDS, 0), angles, random.uniform(0.8, 1.1, FRONDS), up)
    return np.array([stem] + [leaf] * FRONDS, np.int32), maps


def _grow(
    growth: Growth, count: int, terrain: Terrain, placements: Placements, seed: int, random: np.random.Generator
) -> None:
    """Append about `count` instances of `growth`, where its density allows."""
    each = len(growth.parts[0]) if growth.parts else 1
    wanted, tries = max(0, min(count, placements.left) // each), TRIES * max(1, count // each)
    numbers = np.array(growth.meshes, np.int32)
    while wanted > 0 and tries > 0:
        tried = min(PART, tries, max(4096, 4 * wanted))
        tries -= tried
        points = random.uniform(-0.5, 0.5, (tried, 2)) * terrain.size
        chance = random.uniform(0, 1, tried)
        heights, normals = terrain.at(points)
        above = np.flatnonzero(heights > -4)  # most of the square is sea
        points, chance, heights, normals = points[above], chance[above], heights[above], normals[above]
        noise = fractal_noise(points[:, 0] / 60, points[:, 1] / 60, seed + 7 * growth.meshes[0], 4)
        found = np.flatnonzero(chance < growth.density(heights, normals[:, 2], noise))[: PART // each or 1][:wanted]
        up = growth.leans * normals[found] + (1 - growth.leans) * np.array([0.0, 0.0, 1.0])
        outer = standing(
            np.column_stack([points[found], heights[found]]),
            random.uniform(0, 2 * math.pi, len(found)),
            random.uniform(*growth.scale, len(found)),
            up / np.linalg.norm(up, axis=1, keepdims=True),
        )
        chosen = numbers[random.integers(0, len(numbers), len(found))]
        if growth.parts:
            placements.add(np.tile(growth.parts[0], len(found)), composed(outer, growth.parts[1]))
        else:
            placements.add(chosen, outer)
        wanted -= len(found)


def _sea() -> Mesh:
    """A square at height 0, wider than the island."""
    edge = 4 * SIZE
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(edge)
    return Mesh("Sea", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
