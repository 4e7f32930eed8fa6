"""A scene with instances, made of one that has none."""

from __future__ import annotations

import dataclasses

import numpy as np
from benchmarking.scenes import BenchmarkScene

from raybatch_addon.core.scene.description import Instances, Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten

STRETCH_MAX = 3.0  # of an axis of an instance, or its inverse
SIZE_RANGE = (0.03, 30.0)  # of instances, relative to the mesh
SPREAD = 2.0  # instances lie in a box so many times as large as the mesh


def with_instances(scene: BenchmarkScene, count: int, seed: int, seen_by_all: bool = False) -> BenchmarkScene:
    """`scene` with its first mesh once where it was and `count` times more: turned, stretched, sheared, mirrored, of
    many sizes.

    Two are in the same place, so that equal distances happen; some are not seen by all rays, unless `seen_by_all`.
    """
    generator = np.random.default_rng(seed)
    mesh = scene.scene.meshes[0]
    low, high = mesh.positions.min(0).astype(np.float64), mesh.positions.max(0).astype(np.float64)
    middle, extent = (low + high) / 2, float((high - low).max())
    transforms = [np.eye(3, 4)]
    for _ in range(count):
        first, second = (np.linalg.qr(generator.normal(size=(3, 3)))[0] for _ in range(2))  # half of them mirror
        stretch = STRETCH_MAX ** generator.uniform(-1, 1, 3) * np.exp(generator.uniform(*np.log(SIZE_RANGE)))
        linear = first * stretch @ second
        place = middle + generator.uniform(-0.5, 0.5, 3) * extent * SPREAD - linear @ middle
        transforms.append(np.concatenate([linear, place[:, None]], axis=1))
    if count > 1:
        transforms[-1] = transforms[-2]
    transform = np.array(transforms, np.float32)
    visibility = np.full(count + 1, int(Visibility.ALL), np.int32)
    if not seen_by_all:
        visibility[3::4] = generator.integers(1, int(Visibility.ALL), len(visibility[3::4]))
    # mesh 0 is baked, its copy is shared
    index = np.array([0] + [1] * count, np.int32)
    none = np.zeros(count + 1, np.int32)
    instances = Instances(index, transform, none, visibility, none)
    placed = dataclasses.replace(scene.scene, meshes=(mesh, mesh), instances=instances)
    features = derive_features(placed, scene.settings)
    return BenchmarkScene(
        f"{scene.name} with {count} instances", placed, scene.settings, flatten(placed), features.instancing
    )
