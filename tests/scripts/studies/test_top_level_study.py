"""The study of the top level: warps of lanes that take turns, in a whole batched trace."""

import numpy as np
import pytest
from benchmarking.rays import CapturedRays, parse_ray_types
from studies.registry import STUDIES
from studies.study import Options
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
