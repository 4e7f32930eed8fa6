"""The study of schedulers: what is measured, that hits are compared, and its tables."""

import numpy as np
from benchmarking.tracers.interface import Hits
from studies.rays.captured import KINDS, SCENES, different
from studies.registry import STUDIES
from studies.rows import spread
from studies.schedulers.cases import DEFAULT, ON_CUDA, PLACES, SCHEDULERS, UNBATCHED
from studies.schedulers.results import medians, ratio
from studies.study import Options, groups_of

from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.core.wavefront.tracers.buckets.policy import Selection


def test_every_schedule_is_measured_beside_rays_that_do_not_wait():
    for options, scenes in ((Options(), tuple(SCENES)), (Options(is_cuda=True), ON_CUDA)):
        groups = groups_of(STUDIES["schedulers"].cases(options))
        assert set(groups) == {f"{scene} {place} {kind}" for scene in scenes for place in PLACES for kind in KINDS}
        for group in groups.values():
            names = [case.what["schedule"] for case in group]
            assert names[:2] == [UNBATCHED, DEFAULT] and len(set(names)) == len(names)
    varied = {name for each in SCHEDULERS for name in each.settings}
    assert {each.settings.get("bucket_selection") for each in SCHEDULERS} >= set(Selection.__members__)
    assert varied >= {"queues_per_ray", "treelet_cache", "treelet_prefetch"} and varied <= set(SETTINGS)


def test_sizes_are_shares_of_those_that_are_chosen():
    made = {each.name: each.made(1 << 20) for place in PLACES.values() for each in place}
    assert made[DEFAULT].treelet_bytes == made[DEFAULT].treelet_tier_bytes == 0
    assert (made["tiers, 8 times as large"].treelet_bytes, made["tiers, 8 times as large"].treelet_tier_bytes) == (
        0,
        8 << 20,
    )
    sized = made["tiers, 1/16 in AUTO's"]
    assert (sized.treelet_bytes, sized.treelet_tier_bytes) == (1 << 16, 1 << 20)


def test_every_bit_of_a_hit_is_compared():
    def hits(**other):
        hit = np.array([True, False, True])
        values = {"t": [1, 9, 2], "instance": [0, -1, 0], "primitive": [3, -1, 4]} | other
        kinds = {"t": np.float32, "instance": np.int32, "primitive": np.int32}
        uv = other.get("uv", [[0, 1], [2, 3], [4, 5]])
        return Hits(
            other.get("hit", hit),
            **{name: np.array(values[name], kind) for name, kind in kinds.items()},
            uv=np.array(uv, np.float32),
        )

    assert different(hits(), hits()) == 0
    assert different(hits(t=[1, 5, 2]), hits()) == 0, "where nothing is hit"
    for other in ({"t": [1, 9, 3]}, {"primitive": [2, -1, 4]}, {"uv": [[0, 1], [2, 3], [4, 6]]}):
        assert different(hits(**other), hits()) == 1
    assert different(hits(hit=np.array([True, True, True])), hits()) == 1


def test_tables_and_medians():
    rows = [
        {"scene": "bunny", "place": "memory", "kind": "bounce1", "schedule": name, "seconds": seconds, "wrong": 0}
        for name, times in {UNBATCHED: (1, 1, 1), DEFAULT: (2, 4, 3), "LAZY": (6, 6, 6)}.items()
        for seconds in times
    ]
    rows = [{"case": row["schedule"], **row} for row in rows] + [{"case": "x", "seconds": None}]
    report = {"rows": rows, "device": {"alias": "cpu", "cores": 2}, "device_kind": "cpu", "quick": True, "versions": {}}
    found = medians(report)
    assert ratio(found, ("bunny", "memory", "bounce1", "LAZY"), DEFAULT) == 0.5
    assert ratio(found, ("bunny", "memory", "bounce4", "LAZY"), DEFAULT) is None
    assert spread(rows)[1] > 0.3
    text = STUDIES["schedulers"].fragment({"cpu": report})
    assert "| LAZY |  | 0.17 |  | 0.17 |" in text and "| LAZY |  | 0.50 |  | 0.50 |" in text
    assert "found the same hits" in text
    rows[0]["wrong"] = 3
    assert "**Hits differ**" in STUDIES["schedulers"].fragment({"cpu": report})
