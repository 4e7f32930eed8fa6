"""Renders whose workers fail at random: `scripts/testing/cluster_faults/fault_renders.py` tries it fifty times."""

import json
import sys

import numpy as np
import pytest

pytest.importorskip("distributed")
if not sys.platform.startswith("linux"):
    pytest.skip("stand-ins for machines need Linux", allow_module_level=True)

from testing.cluster_faults.fault_renders import NOTICED_SECONDS, SIZE, main, table_of, why_not_all
from testing.cluster_faults.faults import FOR_GOOD, KINDS, STANDS, drawn

from tests.support.under_test import DEVICE

RENDERS = 5


@pytest.mark.skipif(DEVICE != "cpu", reason="workers are on the CPU")
def test_films_of_failing_workers_are_those_of_one_process(tmp_path):
    path = tmp_path / "faults.json"
    assert main(["--renders", str(RENDERS), "--variants", "plain", "--seed", "3", "--json", str(path)]) == 0
    report = json.loads(path.read_text())
    outcomes = report["outcomes"][len(report["samples"]) :]
    assert len(outcomes) == RENDERS and not any(each["faulty"] for each in outcomes)
    assert {each["machines"] for each in outcomes} == {2, 3}
    assert sum(len(each["faults"]) for each in outcomes) >= RENDERS
    assert any(each["events"] for each in outcomes)


def test_faults_are_drawn_by_their_seed_and_leave_a_worker():
    assert drawn(np.random.default_rng(5), 3) == drawn(np.random.default_rng(5), 3)
    seen = set()
    for seed in range(300):
        machines = 2 + seed % 2
        faults = drawn(np.random.default_rng(seed), machines)
        seen |= {each.kind for each in faults}
        assert len({each.machine for each in faults if each.kind in FOR_GOOD}) < machines
        stands = [each.machine for each in faults if each.kind in STANDS]
        assert len(stands) == len(set(stands))
    assert seen == set(KINDS)


def test_samples_that_are_missing_or_there_twice_are_found():
    frame = [0, 0, *SIZE]

    def why(*ranges, count=8, region=frame):
        return why_not_all([{"region": region, "first": a, "end": b} for a, b in ranges], count)

    assert why((0, 3), (3, 8)) == []
    assert "3 to 3 of a band are not in the report once" in why((0, 3), (4, 8))[0]
    assert "2 to 2 of a band are not in the report once" in why((0, 3), (2, 8))[0]
    assert "the last of 8 samples" in why((0, 3))[0]
    assert "are not the frame" in why((0, 8), region=[0, 0, 1, 1])[0]


def test_a_report_shows_what_befell_workers_and_what_differs():
    fault = {"kind": "killed", "machine": 0, "after": NOTICED_SECONDS, "seconds": 1.0, "said": True}
    outcome = {"variant": "plain", "machines": 2, "faults": [fault], "tasks_again": 4, "faulty": ["the pass B differs"]}
    quiet = {**outcome, "faults": [], "tasks_again": 0, "faulty": []}
    text = table_of(dict(date="today", commit="c", seed=1, seconds=2, samples=[7], outcomes=[quiet, outcome]))
    assert "| killed: its process is killed (SIGKILL) | 1 | 1 | 1 |" in text
    assert "| 2 | plain | 1 | 1 | 4 | 1 |" in text and "- 2 machines, plain, killed: the pass B differs" in text
