"""Rays of real paths in the scenes of studies that trace them: captured once, and traced by many ways."""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types
from benchmarking.scenes import BenchmarkScene, with_paths
from benchmarking.tracers.interface import Hits
from benchmarking.tracers.stages import SceneTrees
from made_scenes.forest import forest
from made_scenes.island import island

from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.study import Options

KINDS = ("primary", "bounce1", "bounce4")
# Of each kind, by whether on a GPU: quick, full. Fewer where fewer paths go on so far
RAYS = {False: (2_000, 60_000), True: (20_000, 4_000_000)}
KEPT = 3  # scenes


@dataclass(frozen=True)
class Made:
    """A scene of the study in a square frame."""

    make: Callable[[Options, int], Scene]
    up: str


def _forest(sizes: tuple[int, int], edge: int) -> Scene:
    return forest(*sizes, detail=2, seed=1, width=edge, height=edge)


def _island(sizes: tuple[int, int], edge: int) -> Scene:
    return island(*sizes, detail=2, seed=1, width=edge, height=edge)


# A mesh of small triangles, architecture of large ones, many instances, and open ground
SCENES = {
    "bunny": Made(lambda options, edge: scenes.grid("bunny", options, 8 if options.is_cuda else 4, edge), "y"),
    "sponza": Made(lambda options, edge: scenes.under_the_sky("sponza", options, edge), "y"),
    "san_miguel": Made(lambda options, edge: scenes.under_the_sky("san_miguel", options, edge), "z"),
    "forest": Made(lambda options, edge: _forest(options.pick((2_000, 65), (200_000, 1025)), edge), "z"),
    "island": Made(lambda options, edge: _island(options.pick((500, 129), (20_000, 1025)), edge), "z"),
}


@dataclass
class KeptTrees:
    """Trees of a scene, and its pages in a folder."""

    device: wp.Device
    folder: tempfile.TemporaryDirectory
    _made: dict[tuple[int, ...], SceneTrees] = field(default_factory=dict)

    def of(self, rule: tuple[int, ...]) -> SceneTrees:
        """Those whose pages are cut by `rule`."""
        return self._made.setdefault(rule, SceneTrees(self.device, RenderSettings()))


@functools.lru_cache(maxsize=KEPT)
def kept_trees(name: str, options: Options) -> KeptTrees:
    """Nothing is built yet."""
    folder = tempfile.TemporaryDirectory(prefix="raybatch-pages-", ignore_cleanup_errors=True)
    return KeptTrees(wp.get_device(options.device), folder)


@functools.lru_cache(maxsize=KEPT)
def captured(name: str, options: Options) -> tuple[BenchmarkScene, dict[str, CapturedRays]]:
    """A scene, and its rays by kind."""
    count = options.pick(*RAYS[options.is_cuda])
    made, settings = SCENES[name], RenderSettings()
    scene = made.make(options, math.isqrt(count - 1) + 1)
    for mesh in scene.meshes:  # as an export's are
        freeze(mesh.positions)
        freeze(mesh.triangles)
    scene = checked_scene(with_paths(scene, settings, made.up))
    whole = BenchmarkScene(name, scene, settings, flatten(scene), derive_features(scene, settings).instancing)
    found = capture_rays(whole, settings, parse_ray_types(",".join(KINDS)), count, options.device)
    return whole, {each.type.name: each for each in found}


def different(mine: Hits, expected: Hits) -> int:
    """Rays that met something else, bit for bit."""
    wrong = mine.hit != expected.hit
    for name in ("t", "instance", "primitive", "uv"):
        a, b = (getattr(each, name) for each in (mine, expected))
        if a is not None and b is not None:
            unequal = a.view(np.int32) != b.view(np.int32)
            wrong |= expected.hit & (unequal.any(1) if unequal.ndim > 1 else unequal)
    return int(np.count_nonzero(wrong))
