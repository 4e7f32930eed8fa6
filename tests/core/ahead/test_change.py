"""Specialised kernels compile in a process of their own where that pays, and who renders by general ones meanwhile can
read why.
"""

import os
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp

from raybatch_addon.core.ahead import change
from raybatch_addon.core.ahead.change import Decision, TierChange, TierChanges, weigh_compiling
from raybatch_addon.core.ahead.process import CompileProcess
from raybatch_addon.core.ahead.request import CompileRequest
from raybatch_addon.core.device.compiler import CompileStoppedError
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from tests.support import scenes
from tests.support.under_test import DEVICE

ROOT = Path(__file__).resolve().parents[3]
SETTINGS = RenderSettings(sample_count=4, bounce_max=5, roulette_bounce=2)


def test_when_compiling_pays():
    device = wp.get_device("cpu")
    features = derive_features(scenes.mixed(), SETTINGS)
    request = CompileRequest(features, SETTINGS.replace(thread_count=1), TracingPlan(Method.UNBATCHED))
    seconds = request.expected_seconds
    assert seconds > 0

    def pays(spent, left, device=device):
        return weigh_compiling(request, spent, left, device).pays

    assert not pays(0.0, None) and not pays(0.0, seconds)
    assert pays(0.0, 6 * seconds), "a long render"
    assert not pays(3 * seconds, 1.0) and pays(5 * seconds, 1.0), "many short ones"
    gpu = SimpleNamespace(is_cuda=True)
    assert not pays(0.0, seconds, gpu)
    assert pays(0.0, 2 * seconds, gpu) and not pays(0.0, 2 * seconds), "processors are idle"


def test_a_decision_says_why_in_numbers():
    device, gpu = wp.get_device("cpu"), SimpleNamespace(is_cuda=True)
    request = SimpleNamespace(expected_seconds=20.0, settings=SETTINGS.replace(thread_count=2))
    takes = "compiling takes about 20 s of a processor"

    def why(spent, left, device=device):
        return weigh_compiling(request, spent, left, device).why

    assert why(0.0, None) == f"{takes}, and it is not known how long the render takes"
    assert why(0.0, 3.0) == f"{takes} and 3 s are left, so general kernels render to the end"
    costs, costs_gpu = (f"{takes}, which costs {cost} s of rendering" for cost in ("10.0", "2.0"))
    then = "in the 20 s that are left then"
    assert why(0.0, 40.0) == f"{costs}, more than the 4.2 s that general kernels lose {then}"
    assert why(0.0, 40.0, gpu) == f"{costs_gpu}, and general kernels lose 7.2 s {then}"
    assert why(0.0, 120.0) == f"{costs}, and general kernels lose 21.0 s in the 100 s that are left then"
    spent = "in 100 s of rendering such scenes general kernels have lost 21.0 s"
    assert why(100.0, 1.0) == why(100.0, None) == f"{costs}, and {spent}"
    # on one processor: less than what is left is lost by both, and what is compared is said
    request = SimpleNamespace(expected_seconds=100.0, settings=SETTINGS.replace(thread_count=1))
    assert why(0.0, 500.0) == (
        "compiling takes about 100 s of a processor, which costs 100.0 s of rendering, "
        "more than the 84.0 s that general kernels lose in the 400 s that are left then"
    )


def test_a_render_reports_the_decision_that_counts(monkeypatch):
    """Not that of its last moment, when nothing is left to gain."""
    changes = TierChanges(wp.get_device(DEVICE))
    request = CompileRequest(derive_features(scenes.mixed(), SETTINGS), SETTINGS, TracingPlan(Method.UNBATCHED))
    monkeypatch.setattr(CompileRequest, "expected_seconds", 20.0)
    monkeypatch.setattr(change, "_POLL_SECONDS", 0.001)
    left, asked = iter([None, 15.0, 9.0, 0.0]), threading.Event()

    def still_left():
        known = next(left, 0.0)
        if known == 0.0:
            asked.set()
        return known

    watched = TierChange(changes, request, [], still_left, wp.get_device(DEVICE))
    time.sleep(0.002)
    watched.go_on()
    assert asked.wait(60)
    watched.close()
    assert (
        watched.why
        == "compiling takes about 20 s of a processor and 15 s are left, so general kernels render to the end"
    )
    short = TierChange(changes, request, [], still_left, wp.get_device(DEVICE))
    short.close()
    assert re.fullmatch(r"compiling takes about 20 s of a processor, and the render took \d\.\d s", short.why), (
        short.why
    )


class FakeProcess:
    """Compiles until it is told otherwise."""

    def __init__(self, *_):
        self.is_running = True

    def complaint(self):
        return ""

    def stop(self):
        self.is_running = False


@pytest.fixture
def request_of_one(monkeypatch):
    """A request that pays at once."""
    monkeypatch.setattr(change, "_POLL_SECONDS", 0.001)
    monkeypatch.setattr(change, "weigh_compiling", lambda *_: Decision(True, "it pays", None))
    return CompileRequest(derive_features(scenes.mixed(), SETTINGS), SETTINGS, TracingPlan(Method.UNBATCHED))


@pytest.mark.parametrize("end", ["the session is closed", "the process is too late", "the take-over is too late"])
def test_a_render_says_that_kernels_were_not_ready(monkeypatch, request_of_one, end):
    """However it came, and none is compiled again for the next render where they are there or nobody wants them."""
    changes, started = TierChanges(wp.get_device(DEVICE), between_renders=True), []
    reached, looks = threading.Event(), iter(range(10**9))

    def left():
        if next(looks) == 1:  # the first look began to compile
            if end == "the session is closed":
                changes.close()
                reached.set()
            else:
                started[0].is_running = False
            if end == "the process is too late":
                reached.set()
                raise CompileStoppedError
        return 0.0

    def load_kernels(_kernels, _device, _on_module, given_up):
        reached.set()
        while not given_up():
            time.sleep(0.001)
        raise CompileStoppedError

    monkeypatch.setattr(change, "CompileProcess", lambda *_: started.append(FakeProcess()) or started[-1])
    monkeypatch.setattr(change, "is_compiled", lambda *_: True)
    monkeypatch.setattr(change, "load_kernels", load_kernels)
    watched = TierChange(changes, request_of_one, [], left, wp.get_device(DEVICE))
    time.sleep(0.002)
    watched.go_on()
    assert reached.wait(60)
    watched.close()
    assert watched.why == "it pays; they were not ready before the end" and watched.changed_after is None
    assert len(started) == 1 and not started[0].is_running and not watched.compiled_for_next


def test_what_an_earlier_render_began_is_told(monkeypatch, request_of_one):
    changes = TierChanges(wp.get_device(DEVICE))
    started = []
    monkeypatch.setattr(change, "CompileProcess", lambda *how: started.append(how) or FakeProcess())
    assert changes.poll(request_of_one, None).decision.pays
    assert started[0][-1], "a render waits for it"
    watched = TierChange(changes, request_of_one, [], lambda: None, wp.get_device(DEVICE))
    watched.close()
    assert watched.why == "compiling began with an earlier render; they were not ready before the end"


@pytest.mark.parametrize("moment", ["begin", "complaint", "stop"])
def test_a_session_is_closed_while_a_render_is_watched(monkeypatch, request_of_one, moment):
    """What is ended is no failure, and nothing goes on: at each moment another thread may look or close."""
    changes, started, found = TierChanges(wp.get_device(DEVICE)), [], []

    class Process(FakeProcess):
        def __init__(self, *_):
            super().__init__()
            started.append(self)
            if moment == "begin":
                changes.close()

        def complaint(self):
            if moment == "complaint":
                changes.close()
                changes.open()  # by the next render
            return "it ended with code -9"

        def stop(self):
            super().stop()
            found.append(changes.poll(request_of_one, None))

    monkeypatch.setattr(change, "CompileProcess", Process)
    assert changes.poll(request_of_one, None).decision.pays
    assert started[0].is_running == (moment != "begin")
    if moment == "complaint":
        started[0].is_running = False
        assert not changes.poll(request_of_one, None).is_ready
    changes.close()
    assert all(each == (False, None) for each in found) and not started[0].is_running
    changes.fail(request_of_one.features, "too late")
    assert changes.complaint(request_of_one) == "" and len(started) == 1
    changes.open()
    moment = "afterwards"
    assert changes.poll(request_of_one, None).decision.pays and len(started) == 2


def test_a_render_that_is_over_waits_for_one_kernel_at_most(monkeypatch, request_of_one):
    """Whether all are there is asked of one after another; what was compiled is taken in by the next render."""
    changes, asked = TierChanges(wp.get_device(DEVICE), between_renders=True), []
    process = FakeProcess()
    monkeypatch.setattr(change, "CompileProcess", lambda *_: process)
    monkeypatch.setattr(change, "is_compiled", lambda kernel, _: asked.append(kernel) or True)
    changes.poll(request_of_one, None)
    process.is_running = False
    with pytest.raises(CompileStoppedError):
        changes.poll(request_of_one, None, lambda: len(asked) == 1)
    assert len(asked) == 1
    changes.rest(request_of_one)
    assert changes.poll(request_of_one, None) == (True, None)


def test_a_process_that_fails_says_why_in_a_line(tmp_path, monkeypatch):
    process = CompileProcess("cuda:77", tmp_path)
    process.wait()
    complaint = process.complaint()
    assert complaint.startswith("DeviceError: there is no device 'cuda:77'") and "\n" not in complaint
    # the render goes on, and does not try again
    changes = TierChanges(wp.get_device(DEVICE))
    request = CompileRequest(derive_features(scenes.mixed(), SETTINGS), SETTINGS, TracingPlan(Method.UNBATCHED))
    started = []
    monkeypatch.setattr(change, "weigh_compiling", lambda *_: Decision(True, "", None))
    monkeypatch.setattr(change, "CompileProcess", lambda *_: started.append(1) or process)
    assert not any(changes.poll(request, None).is_ready for _ in range(3))
    assert started == [1] and "cuda:77" in changes.complaint(request)


@pytest.mark.parametrize("between", [False, True])
def test_what_a_render_lacked_is_compiled_after_it_where_the_process_stays(monkeypatch, between):
    """Once, and for the last scene alone."""
    changes, started = TierChanges(wp.get_device(DEVICE), between_renders=between), []

    class Compiling:
        is_running = True

        def __init__(self, _device, _folder, request, hurried):
            assert not hurried  # no render waits for it
            started.append(request.features)

        def stop(self):
            started.append("stopped")

    monkeypatch.setattr(change, "CompileProcess", Compiling)
    plan = TracingPlan(Method.UNBATCHED)
    first, second = (
        CompileRequest(replace(derive_features(scenes.mixed(), SETTINGS), smooth_normals=smooth), SETTINGS, plan)
        for smooth in (False, True)
    )
    for request in (first, first, second):
        watched = TierChange(changes, request, [], lambda: 0.0, wp.get_device(DEVICE))
        watched.close()
        assert watched.is_compiling == watched.compiled_for_next == between
    assert started == ([first.features, "stopped", second.features] if between else [])
    changes.close()
    changes.rest(first)  # too late
    assert started[3:] == (["stopped"] if between else [])


# A render on a thread that nobody waits for, watched as it goes on; the process ends once it is as far as sys.argv[1]
ENDING = """
import sys, threading, time
if sys.argv[1] == "begin":  # behind what ends watching: the last one that is registered is called first
    threading._register_atexit(lambda: (watched.go_on(), print("ended", flush=True)))
import warp as wp
from types import SimpleNamespace
from raybatch_addon.core.ahead import change
from raybatch_addon.core.device.devices import start_warp
start_warp()
reached, loads = threading.Event(), sys.argv[1] == "take over"
def poll(request, left, given_up):
    reached.set()
    return change.Polled(loads)
def load_kernels(kernels, device, on_module, given_up):
    reached.set()
    while not given_up():
        time.sleep(0.001)
    time.sleep(0.2)
    print("loaded", flush=True)
    raise RuntimeError("nothing to take over")
change.load_kernels = load_kernels
changes = SimpleNamespace(poll=poll, is_compiling=lambda _: False, fail=lambda *_: None)
request = SimpleNamespace(kernels=lambda device: [], features=None)
watched = change.TierChange(changes, request, [], lambda: None, wp.get_device("cpu"))
def render():
    while True:
        time.sleep(0.01)
        watched.go_on()
if sys.argv[1] == "begin":
    time.sleep(0.2)
else:
    threading.Thread(target=render, daemon=True).start()
    reached.wait()
"""


@pytest.mark.parametrize(("stage", "said"), [("take over", "loaded\n"), ("watch", ""), ("begin", "ended\n")])
def test_a_process_ends_while_its_render_is_watched(stage, said):
    """Not under a module that is being loaded, and without waiting for a render that nobody ends."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, "-c", ENDING, stage], env=environment, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")
