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
from raybatch_addon.core.ahead.request import CORE, CompileRequest, GeneralRequest, decode_request, encode_request
from raybatch_addon.core.device.kernel import block_size_of
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from tests.core.device.small_kernels import put_header
from tests.support import scenes, schedule_scenes
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
    assert why(0.0, 40.0) == f"{takes}, more than general kernels lose in the 40 s that are left"
    assert why(0.0, 120.0) == f"{takes}, and of the 120 s that are left general kernels lose 21"
    assert why(0.0, 120.0, gpu) == f"{takes}, and of the 120 s that are left general kernels lose 36"
    assert why(100.0, 1.0) == f"{takes}, and of 100 s of rendering such scenes general kernels have lost 21"


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


def test_a_request_reaches_another_process_whole():
    features = derive_features(schedule_scenes.SCENES["mixed"](), SETTINGS)
    for request in (GeneralRequest(), CompileRequest(features, SETTINGS, TracingPlan(Method.UNBATCHED))):
        data = encode_request(request)
        assert decode_request(data, CORE) == request
        elsewhere = data.replace(b"raybatch_addon.core", b"bl_ext.someone.core")
        assert decode_request(elsewhere, "bl_ext.someone.core.") == request


def test_a_process_compiles_what_is_found_here(tmp_path):
    """Kernels have the same names whatever the package is called that they are in."""
    features = derive_features(scenes.mixed(), SETTINGS)
    features = replace(features, lights=(), mesh_lights=False, world=False, smooth_normals=False, instancing=False)
    request = CompileRequest(features, SETTINGS, TracingPlan(Method.UNBATCHED))
    put_header(tmp_path / wp.config.version)
    process = CompileProcess(DEVICE, tmp_path, request)
    process.wait()
    assert process.complaint() == "" and not process.is_running
    block_sizes = {
        kernel: block_size_of(kernel) if DEVICE != "cpu" else 1 for kernel in request.kernels(wp.get_device(DEVICE))
    }
    names = {kernel.module.get_module_identifier(size) for kernel, size in block_sizes.items()}
    assert names <= {path.name for path in (tmp_path / wp.config.version).iterdir()}


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
    assert not changes.poll(request, None) and not changes.poll(request, None) and not changes.poll(request, None)
    assert started == [1] and "cuda:77" in changes.complaint(request)


@pytest.mark.parametrize("between", [False, True])
def test_what_a_render_lacked_is_compiled_after_it_where_the_process_stays(monkeypatch, between):
    """Once, and for the last scene alone."""
    changes, started = TierChanges(wp.get_device(DEVICE), between_renders=between), []

    class Compiling:
        is_running = True

        def __init__(self, _device, _folder, request):
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


ABANDONED = """
import os, sys
from raybatch_addon.core.ahead.process import CompileProcess
print(CompileProcess("cpu", sys.argv[1])._process.pid, flush=True)
os._exit(0)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell which processes there are")
def test_a_process_ends_with_the_one_that_asked(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-c", ABANDONED, str(tmp_path)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 20
    while _is_alive(int(done.stdout)):
        assert time.monotonic() < end, "it goes on compiling for nobody"
        time.sleep(0.05)


def _is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_process_can_be_stopped(tmp_path):
    process = CompileProcess(DEVICE, tmp_path)
    assert process.is_running and process.complaint() == ""
    process.stop()
    assert not process.is_running


# A render on a thread that nobody waits for, watched as it goes on; the process ends once it is as far as sys.argv[1]
ENDING = """
import sys, threading, time
import warp as wp
from types import SimpleNamespace
from raybatch_addon.core.ahead import change
from raybatch_addon.core.device.devices import start_warp
start_warp()
reached, loads = threading.Event(), sys.argv[1] == "take over"
def poll(request, left):
    reached.set()
    return loads
def load_kernels(kernels, device, on_module, given_up):
    reached.set()
    while not given_up():
        time.sleep(0.001)
    time.sleep(0.2)
    print("loaded", flush=True)
    raise RuntimeError("nothing to take over")
change.load_kernels = load_kernels
changes = SimpleNamespace(poll=poll, decision=None, fail=lambda *_: None)
request = SimpleNamespace(kernels=lambda device: [], features=None)
watched = change.TierChange(changes, request, [], lambda: None, wp.get_device("cpu"))
def render():
    while True:
        time.sleep(0.01)
        watched.go_on()
threading.Thread(target=render, daemon=True).start()
reached.wait()
"""


@pytest.mark.parametrize(("stage", "said"), [("take over", "loaded\n"), ("watch", "")])
def test_a_process_ends_while_its_render_is_watched(stage, said):
    """Not under a module that is being loaded, and without waiting for a render that nobody ends."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, "-c", ENDING, stage], env=environment, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")
