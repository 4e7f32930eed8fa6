"""A forest: instances of trees, which are instances of twigs and leaves themselves."""

from __future__ import annotations

import math

import numpy as np
from lib.geometry_files import View

from made_scenes.assembled import Color, assembled
from made_scenes.placing import PART, Placements, composed, standing
from made_scenes.plants import trunk, twig
from made_scenes.terrain import Terrain
from raybatch_addon.core.scene.description import Mesh, Scene

KINDS = 4  # of trees
TWIGS = 200  # of each, with the trunk
TREE_HEIGHT = 14.0  # [m]
SPACING = 5.0  # mean distance of trees [m]


def forest(count: int, terrain_edge: int, detail: int, seed: int, width: int, height: int) -> Scene:
    """About `count` instances on ground of `terrain_edge` x `terrain_edge` points."""
    random = np.random.default_rng(seed)
    tree_count = max(1, count // TWIGS)
    size = max(SPACING * math.sqrt(tree_count), 4 * SPACING)
    terrain = Terrain.of(size, terrain_edge, seed, island=False, height=0.05 * size)
    meshes: list[Mesh] = [terrain.mesh("Ground")]
    colors: list[Color] = [(0.12, 0.09, 0.05)]
    trees: list[tuple[np.ndarray, np.ndarray]] = []  # of each kind: mesh and map of each part, in the tree
    for kind in range(KINDS):
        first = len(meshes)
        meshes += [
            trunk(f"Trunk {kind}", TREE_HEIGHT, 0.25, 0.05 * kind, detail),
            twig(f"Twig {kind}", 16 * detail, 2.2, detail, seed + kind),
        ]
        colors += [(0.16, 0.1, 0.06), (0.06 + 0.03 * kind, 0.22 - 0.02 * kind, 0.04)]
        trees.append(_tree(first, random))
    placements = Placements(1 + tree_count * TWIGS)
    placements.add(0, standing(np.zeros((1, 3)), np.zeros(1), np.ones(1)))
    step = max(1, PART // TWIGS)
    for start in range(0, tree_count, step):
        number = min(step, tree_count - start)
        points = random.uniform(-0.5, 0.5, (number, 2)) * size
        heights, _ = terrain.at(points)
        outer = standing(
            np.column_stack([points, heights]), random.uniform(0, 2 * math.pi, number), random.uniform(0.6, 1.3, number)
        )
        kinds = np.arange(start, start + number) % KINDS  # of all kinds as many
        for kind, (parts, inner) in enumerate(trees):
            chosen = outer[kinds == kind]
            placements.add(np.tile(parts, len(chosen)), composed(chosen, inner))
    high = max(2.5 * TREE_HEIGHT, 0.12 * size)
    view = View((-0.55 * size, -0.55 * size, high + float(terrain.heights.max())), (0.0, 0.0, 0.0), math.radians(45))
    return assembled(meshes, colors, placements, view, width, height)


def _tree(first: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Meshes and maps of a tree's parts: the trunk, number `first`, and twigs around its upper two thirds."""
    number = TWIGS - 1
    t = random.uniform(0.3, 1.0, number)
    angles = 2.4 * np.arange(number)
    reach = 0.22 * TREE_HEIGHT * (1.15 - t) * random.uniform(0, 1, number)
    points = np.stack([reach * np.cos(angles), reach * np.sin(angles), TREE_HEIGHT * t], 1)
    maps = np.zeros((TWIGS, 3, 4), np.float32)
    maps[0] = np.eye(3, 4)
    maps[1:] = standing(points, angles, random.uniform(0.6, 1.1, number))
    return np.array([first] + [first + 1] * number, np.int32), maps
