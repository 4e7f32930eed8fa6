"""What is compared: the choices of `top_level_traversal`, by scene, kind of rays, and who is served next."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal
from studies.hardware.cases import traced_scene
from studies.hardware.record import quantised_tree
from studies.study import Case, Options, Row
from studies.top_level import rates
from studies.top_level.warps import traced

if TYPE_CHECKING:
    from studies.bench import Bench

SCENES = ("sponza", "san_miguel")
KINDS = ("primary", "bounce1", "bounce4")
SELECTIONS = ("ALL", "MOST_FULL")
WAYS = tuple(TopLevelTraversal.__members__)
RAYS = (2_000, 60_000)  # of each kind: quick, full
TREELET_BYTES = 64 << 10


def cases(options: Options) -> list[Case]:
    """All of them: on a GPU those that are timed, else those whose warps are emulated."""
    if options.is_cuda:
        return rates.cases(options)
    found = []
    for scene in SCENES:
        for kind in KINDS:
            for selection in SELECTIONS:
                for way in WAYS:
                    what = {"scene": scene, "kind": kind, "selection": selection, "way": way}
                    found.append(Case(f"{scene} {kind} {selection} {way}", scene, what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Counts of a case, or on a GPU its time."""
    if bench.options.is_cuda:
        return rates.measure(case, turn, bench)
    what, options = case.what, bench.options
    built, rays = prepared(what["scene"], options, options.pick(*RAYS))
    way = TopLevelTraversal[what["way"]]
    return asdict(traced(built, rays[what["kind"]], way, what["selection"], TREELET_BYTES))


@functools.lru_cache(maxsize=1)
def prepared(name: str, options: Options, count: int) -> tuple[BuiltTree, dict[str, CapturedRays]]:
    """A scene's tree, and `count` rays of each kind."""
    scene = traced_scene(name, options, math.isqrt(count - 1) + 1)
    types = parse_ray_types(",".join(KINDS))
    rays = {each.type.name: each for each in capture_rays(scene, scene.settings, types, count, "cpu")}
    return quantised_tree(scene), rays
