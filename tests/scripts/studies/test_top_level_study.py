"""The study of the top level: warps of lanes that take turns, in a whole batched trace."""

import numpy as np
import pytest
from benchmarking.rays import CapturedRays, parse_ray_types
from studies.rays import captured
from studies.registry import STUDIES
from studies.study import Options, groups_of
from studies.top_level import rates
from studies.top_level.cases import KINDS, SCENES, SELECTIONS, WAYS
from studies.top_level.warps import traced

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal
from raybatch_addon.core.scene.description import Mesh, Visibility
from tests.core.bvh.traverse.visit_scenes import of_objects, random_rays
from tests.support import scenes
from tests.support.wide_trees import soup


@pytest.fixture(scope="module")
def built():
    mesh = Mesh("soup", *soup(700, 1))
    return of_objects("cpu", [(mesh, [scenes.IDENTITY])], False, random_rays(1, 2), layout=Layout.QUANTISED).built


def rays_of(kind: str, count: int) -> CapturedRays:
    origin, direction = (each.astype(np.float32) for each in random_rays(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    far = np.full(count, 1e30, np.float32)
    return CapturedRays(parse_ray_types(kind)[0], origin, direction, far, np.full(count, int(Visibility.ALL), np.int32))


@pytest.mark.parametrize("kind", ("bounce1", "shadow1"))
def test_what_warps_read_is_counted(built, kind):
    """Lanes that go each their own way take few turns, and read more nodes in each; those that go together read one."""
    rays = rays_of(kind, 256)
    naive, short = (
        traced(built, rays, each, "ALL", 2048) for each in (TopLevelTraversal.NAIVE, TopLevelTraversal.SHORT_SEGMENT)
    )
    assert naive.rays == short.rays == 256 and naive.treelets == short.treelets > 8
    assert naive.treelet_visits == short.treelet_visits > 100
    assert naive.turns < naive.fetches < naive.visits
    assert 0.9 * short.turns < short.fetches <= short.turns < short.visits
    assert short.queued > naive.queued > 256 and short.visits > naive.visits


def test_tables_have_a_row_for_each_case():
    found = STUDIES["top-level"].cases(Options())
    assert len({case.key for case in found}) == len(found) == len(SCENES) * len(KINDS) * len(SELECTIONS) * len(WAYS)
    counts = {"rays": 10, "visits": 90, "turns": 5, "treelets": 7, "treelet_visits": 20, "queued": 30}
    rows = [case.what | counts | {"fetches": 30 if case.what["way"] == "NAIVE" else 15} for case in found]
    text = STUDIES["top-level"].fragment({"cpu": {"rows": rows}})
    assert text.count("| NAIVE | 3 | 1 | 3 | 9 | 16 | 3 |") == len(SCENES) * len(SELECTIONS) * len(KINDS)
    assert text.count("| LONG_HAUL | 1.5 | 0.5 | 6 | 9 | 16 | 3 |") == len(SCENES) * len(SELECTIONS) * len(KINDS)


def test_on_a_gpu_all_ways_take_turns_and_have_rates_over_naive():
    study = STUDIES["top-level"]
    groups = groups_of(study.cases(Options(is_cuda=True)))
    assert len(groups) == len(rates.SCENES) * len(rates.KINDS) * len(rates.SELECTIONS)
    for group in groups.values():
        ways = [case.what["way"] for case in group]
        assert ways[0] == "NAIVE" and set(WAYS) - set(ways) <= {"SHORT_SEGMENT"}
    rows = [
        {"case": case.key, "turn": turn, "seconds": seconds * (2 if case.what["way"] == "LONG_HAUL" else 1)}
        | {"rays": 3_000_000, "wrong": 0, **case.what}
        for case in study.cases(Options(is_cuda=True))
        for turn, seconds in enumerate((1, 1.5, 9))  # ratios are of one turn
    ]
    report = {"rows": rows, "device": {"alias": "cuda:0"}, "device_kind": "cuda", "quick": False, "versions": {}}
    text = study.fragment({"cuda": report})
    alike, half = "1.00 (1.00 to 1.00)", "0.50 (0.50 to 0.50)"
    assert text.count(f"| 2 | {alike} | {alike} | {half} |") == 9
    assert text.count(f"| 2 | {alike} | not measured | {half} |") == 3
    assert "All found the same hits" in text
    rows[0]["wrong"] = 1
    assert "**Hits differ**" in study.fragment({"cuda": report})


@pytest.fixture
def few_rays(monkeypatch):
    """Scenes are captured with few rays, and not kept for others."""
    monkeypatch.setattr(captured, "RAYS", {False: (500, 0)})
    yield
    for each in (captured.captured, captured.kept_trees, rates.prepared):
        each.cache_clear()


def test_rates_are_of_rays_that_wait_and_meet_what_they_meet_in_the_whole_tree(few_rays):
    """A scene of the study of schedulers, on a CPU, where all ways are one."""
    prepared = rates.prepared("island", "bounce1", Options("cpu", quick=True))
    found = prepared.of("ALL", "NAIVE")
    assert found.wrong == 0 and found.ray_count == 500 and found is prepared.of("ALL", "NAIVE")
    assert found.tracer.trace().seconds > 0
    assert found.tracer.done()["treelet_visits"] > 1, "rays wait at treelets"


def test_each_way_is_traced_by_its_settings(few_rays, monkeypatch):
    asked = []

    class Stood:
        def __init__(self, name, trees, device, settings, budget):
            asked.append(
                (settings.bucket_selection, settings.top_level_traversal, settings.treelet_bytes, budget.bytes)
            )

        def build(self, scene): ...
        def load(self, rays, threads): ...
        def trace(self): ...
        def hits(self):
            return prepared._expected

    prepared = rates.prepared("island", "bounce1", Options("cpu", quick=True))
    monkeypatch.setattr(rates, "WaitingTracer", Stood)
    for selection in rates.SELECTIONS:
        for way in rates.WAYS:
            assert prepared.of(selection, way).wrong == 0
    assert asked == [(each, way, 1 << 20, 0) for each in rates.SELECTIONS for way in rates.WAYS]
