"""Renders whose workers fail at random: `scripts/testing/cluster_faults/fault_renders.py` tries it fifty times."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("distributed")
if not sys.platform.startswith("linux"):
    pytest.skip("stand-ins for machines need Linux", allow_module_level=True)

from testing.cluster_faults import worker_faults
from testing.cluster_faults.fault_renders import SIZE, main, table_of, why_not_all
from testing.cluster_faults.faults import FOR_GOOD, KINDS, STANDS, Fault, FaultsOfRender, drawn
from testing.cluster_faults.said import NOTICED_SECONDS, RenderReport

from tests.support.under_test import DEVICE

RENDERS, SEED = 5, 337  # in which each kind of fault is drawn


@pytest.mark.usefixtures("general_kernels")
@pytest.mark.skipif(DEVICE != "cpu", reason="workers are on the CPU")
def test_films_of_failing_workers_are_those_of_one_process(tmp_path):
    path = tmp_path / "faults.json"
    assert main(["--renders", str(RENDERS), "--variants", "plain", "--seed", str(SEED), "--json", str(path)]) == 0
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


def fault(kind, done_at, machine=0):
    return Fault(kind, machine, 0.0, 1.0, done_at)


def report(*events, ended=20.0):
    names = ("seconds", "kind", "who")
    return RenderReport([dict(zip(names, each, strict=True)) for each in events], 0.0, ended)


@pytest.mark.parametrize("kind", ["killed", "machine killed", "cut off"])
def test_a_worker_that_goes_has_to_be_in_the_report(kind):
    went, came = (5.0, "WORKER_GONE", "tcp://a:1"), (8.0, "WORKER_CAME", "tcp://a:2")
    silent = (3.0, "WORKER_SILENT", "tcp://a:1")
    assert report().misses(fault(kind, 4.9), [], "a")
    assert report((5.0, "WORKER_GONE", "tcp://b:1")).misses(fault(kind, 4.9), [], "a")
    assert not report(went).misses(fault(kind, 4.9), [], "a")
    assert not report(ended=4.9 + NOTICED_SECONDS).misses(fault(kind, 4.9), [], "a")
    # who was out does not go once more; who came again does
    assert not report(went, came).misses(fault(kind, 6.0), [], "a")
    assert not report(silent).misses(fault(kind, 4.9), [], "a")
    assert report(went, came).misses(fault(kind, 9.0), [], "a")
    assert report(silent, came).misses(fault(kind, 9.0), [], "a")


def test_a_full_disk_has_to_be_in_the_report_where_the_worker_is_asked():
    full, left_out = fault("disk full", 0.0), (1.0, "MACHINE_LEFT_OUT", "a")
    went, came = (0.5, "WORKER_GONE", "tcp://a:1"), (8.0, "WORKER_CAME", "tcp://a:2")
    assert report().misses(full, [fault("killed", 0.4)], "a")
    assert not report(left_out).misses(full, [], "a")
    assert not report(went).misses(full, [], "a")
    assert report(went, came).misses(full, [], "a")
    assert not report(went, came, ended=9.0).misses(full, [], "a")
    assert not report().misses(full, [fault("stopped", 0.0)], "a")


def test_a_film_that_was_damaged_has_to_be_in_the_report_where_it_was_sent():
    spoiled = fault("result damaged", 4.0)
    assert report().misses(spoiled, [], "a", [4.5])
    assert not report((5.0, "FILM_DAMAGED", "samples 0 to 3 of band 0")).misses(spoiled, [], "a", [4.5])
    assert not report().misses(spoiled, [], "a", [3.9])
    assert not report().misses(spoiled, [fault("killed", 4.6)], "a", [4.5])
    assert not report((5.0, "TASK_LATE", "samples 0 to 3 of band 0")).misses(spoiled, [], "a", [4.5])


def test_a_worker_that_stands_is_cut_off_once_it_goes_on():
    """Till then it does nothing, and nobody sees that it is."""
    machine = SimpleNamespace(stands=True, signal=lambda number: True, noted=lambda kind: [])
    cut = fault("cut off", None)
    befalling = FaultsOfRender([cut], [machine])
    befalling.come_to(0.5)
    assert not cut.is_done
    machine.stands = False
    befalling.come_to(0.5)
    assert cut.is_done
    done_at = cut.done_at
    machine.noted = lambda kind: [done_at - 1.0, done_at + 1.0]
    befalling.note_when(done_at + 2.0)
    assert cut.done_at == done_at + 1.0
    befalling.note_when(done_at)  # the render ended before
    assert not cut.is_done


def test_what_a_worker_does_to_itself_is_noted_where_its_disk_is_full(tmp_path, monkeypatch):
    monkeypatch.setenv(worker_faults.FAULTS, str(tmp_path))
    file = tmp_path / "file"
    worker_faults.fill_disk(0, is_full=True)
    try:
        with pytest.raises(OSError, match="File too large"), file.open("wb", buffering=0) as opened:
            opened.write(b"1")
        worker_faults.note(worker_faults.DAMAGED)
    finally:
        worker_faults.fill_disk(0, is_full=False)
    file.write_bytes(b"1")
    assert len(worker_faults.noted(tmp_path, worker_faults.DAMAGED)) == 1
    assert not worker_faults.noted(tmp_path, worker_faults.CUT)


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
    killed = {"kind": "killed", "machine": 0, "after": NOTICED_SECONDS, "seconds": 1.0, "said": True}
    outcome = {
        "variant": "plain",
        "machines": 2,
        "faults": [killed],
        "tasks_again": 4,
        "faulty": ["the pass B differs"],
    }
    quiet = {**outcome, "faults": [], "tasks_again": 0, "faulty": []}
    text = table_of(dict(date="today", commit="c", seed=1, seconds=2, samples=[7], outcomes=[quiet, outcome]))
    assert "| killed: its process is killed (SIGKILL) | 1 | 1 | 1 |" in text
    assert "| 2 | plain | 1 | 1 | 4 | 1 |" in text and "- 2 machines, plain, killed: the pass B differs" in text
