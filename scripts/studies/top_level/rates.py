"""The ways through the top level on a GPU: rates of whole traces whose rays wait at treelets."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import warp as wp
from benchmarking.tracers.batching import Budget, WaitingTracer
from benchmarking.tracers.stages import StageTracer

from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal
from raybatch_addon.core.settings.settings import RenderSettings
from studies.rays.captured import captured, different, kept_trees
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

SCENES = ("san_miguel", "bunny")
KINDS = ("bounce1", "bounce4", "primary")
SELECTIONS = ("ALL", "MOST_FULL")
WAYS = tuple(TopLevelTraversal.__members__)
TREELET_BYTES = 1 << 20
# Not through in a minute: buckets of many treelets one by one, into which a segment brings few rays at a time
LEFT_OUT = {("bunny", "MOST_FULL", "SHORT_SEGMENT")}


def cases(_: Options) -> list[Case]:
    """All ways take turns within each scene, kind of rays, and selection of the next bucket."""
    found = []
    for scene in SCENES:
        for kind in KINDS:
            for selection in SELECTIONS:
                for way in WAYS:
                    if (scene, selection, way) not in LEFT_OUT:
                        what = {"scene": scene, "kind": kind, "selection": selection, "way": way}
                        found.append(Case(f"{scene} {kind} {selection} {way}", f"{scene} {kind} {selection}", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Trace all rays once [s]; the first time their hits are compared with those of the whole tree before. Raises
    `UsageError` where the scene's file is not found.
    """
    what = case.what
    traced = prepared(what["scene"], what["kind"], bench.options).of(what["selection"], what["way"])
    return {"seconds": traced.tracer.trace().seconds, "rays": traced.ray_count, "wrong": traced.wrong}


@dataclass(frozen=True)
class Traced:
    """A tracer that has traced its rays once."""

    tracer: WaitingTracer
    ray_count: int
    wrong: int  # rays that met something else than in the whole tree


class Prepared:
    """A scene and rays of one kind, and what traces them by selection and way."""

    def __init__(self, name: str, kind: str, options: Options):
        self._scene, rays = captured(name, options)
        self._rays, self._trees = rays[kind], kept_trees(name, options)
        self._device = wp.get_device(options.device)
        whole = StageTracer("unbatched", self._trees.of(()), self._device, "OFF")
        whole.build(self._scene)
        whole.load(self._rays, 1)
        whole.trace()
        self._expected = whole.hits()
        self._kept: dict[tuple[str, str], Traced] = {}

    def of(self, selection: str, way: str) -> Traced:
        """See `Traced`; made the first time."""
        key = selection, way
        if key not in self._kept:
            settings = RenderSettings(treelet_bytes=TREELET_BYTES, bucket_selection=selection, top_level_traversal=way)
            budget = Budget(0, Path(self._trees.folder.name))
            tracer = WaitingTracer(way, self._trees.of(()), self._device, settings, budget)
            tracer.build(self._scene)
            tracer.load(self._rays, 1)
            tracer.trace()
            self._kept[key] = Traced(tracer, len(self._rays), different(tracer.hits(), self._expected))
        return self._kept[key]


@functools.lru_cache(maxsize=1)
def prepared(name: str, kind: str, options: Options) -> Prepared:
    """Of the case at hand: its rays take gigabytes of a device."""
    return Prepared(name, kind, options)
