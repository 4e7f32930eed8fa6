"""Renders beside the threads of other GPUs: these work, at their pace, and change nothing."""

import time

import pytest
import warp as wp
from studies.bench import Bench
from studies.many_workers import beside
from studies.many_workers.beside import OtherGpu, measured_beside
from studies.study import Options

from raybatch_addon.core.device.launches import RepeatedLaunches
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.session import Session
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.path_lists import Counts
from tests.support.under_test import DEVICE
from tests.support.watched_renders import assert_same_film


@pytest.fixture
def bench():
    made = Bench(Options(device=DEVICE, quick=True))
    yield made
    made.close()


def test_a_gpu_takes_one_turn_after_another():
    gpu, now = OtherGpu(0.5), time.perf_counter()
    ends = [gpu.take() for _ in range(3)]
    assert ends[0] >= now + 0.5 and ends[1:] == [ends[0] + 0.5, ends[0] + 1.0] and gpu.busy == 1.5


@pytest.mark.parametrize("scheme", beside.SCHEMES)
def test_a_render_beside_others_is_the_same(bench, monkeypatch, scheme):
    films, render = [], Session.render

    def rendered(self, *inputs, **options):
        films.append(render(self, *inputs, **options))
        return films[-1]

    monkeypatch.setattr(Session, "render", rendered)
    before = wp.Launch.launch, wp.utils.array_scan, Counts.send, Counts.arrived, RepeatedLaunches.launch
    cases = [each for each in beside.cases(bench.options) if each.group == f"room, {scheme}"]
    assert [each.what["others"] for each in cases] == list(beside.OTHERS)
    alone, two = (measured_beside(each, bench) for each in (cases[0], cases[2]))
    assert before == (wp.Launch.launch, wp.utils.array_scan, Counts.send, Counts.arrived, RepeatedLaunches.launch)
    # each behind a small one
    assert_same_film(films[3], films[1])
    assert alone["turns"] == two["turns"] > 0 and alone["workers"] >= 1 and "busy" not in alone
    assert two["host_ms"] > 0.0 and 0.0 < two["busy"] <= 1.0


def test_what_fails_in_a_thread_of_another_gpu_is_raised(bench, monkeypatch):
    made = TileIntegrator.__init__

    def failing(self, *inputs):
        if hasattr(beside._its, "worker"):
            raise OutOfMemoryError("no memory for this one")
        made(self, *inputs)

    monkeypatch.setattr(TileIntegrator, "__init__", failing)
    case = next(each for each in beside.cases(bench.options) if each.what["others"])
    with pytest.raises(OutOfMemoryError, match="no memory for this one"):
        measured_beside(case, bench)


def test_scenes_that_are_not_made_here_are_looked_for(bench):
    case = next(each for each in beside.cases(bench.options) if each.what["scene"] == "demo")
    with pytest.raises(Exception, match=r"demo.scene.npz") as found:
        measured_beside(case, bench)
    assert "--scenes" in str(found.value)
