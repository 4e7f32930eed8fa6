"""The process that compiles: it is asked, answers, and ends with the one that asked."""

import json
import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import warp as wp

from raybatch_addon.core.ahead import process as process_module
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


def test_a_request_reaches_another_process_whole():
    features = derive_features(schedule_scenes.SCENES["mixed"](), SETTINGS)
    for request in (GeneralRequest(), CompileRequest(features, SETTINGS, TracingPlan(Method.UNBATCHED))):
        data = encode_request(request)
        assert decode_request(data, CORE) == request
        elsewhere = data.replace(b"raybatch_addon.core", b"bl_ext.someone.core")
        assert decode_request(elsewhere, "bl_ext.someone.core.") == request


def test_a_process_compiles_what_is_found_here(tmp_path):
    """Kernels have the same names whatever the package is called that they are in."""
    scene = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], world=1.0)
    request = CompileRequest(derive_features(scene, SETTINGS), SETTINGS, TracingPlan(Method.UNBATCHED))
    put_header(tmp_path / wp.config.version)
    process = CompileProcess(DEVICE, tmp_path, request)
    process.wait()
    assert process.complaint() == "" and not process.is_running
    block_sizes = {
        kernel: block_size_of(kernel) if DEVICE != "cpu" else 1 for kernel in request.kernels(wp.get_device(DEVICE))
    }
    names = {kernel.module.get_module_identifier(size) for kernel, size in block_sizes.items()}
    assert names <= {path.name for path in (tmp_path / wp.config.version).iterdir()}


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


def test_a_process_whose_answer_nobody_can_read_is_none(tmp_path, monkeypatch):
    def start(_thread):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        with pytest.raises(OSError, match="can't start new thread"):
            CompileProcess(DEVICE, tmp_path)
    assert not process_module._running[-1].is_running


# The other process, where there are two kinds of devices
OF_TWO_KINDS = """
import os, sys
from types import SimpleNamespace
from raybatch_addon.core.ahead import process, request
from raybatch_addon.core.device import devices, kept_kernels
before = os.nice(0)
kinds = {"first": None, "second": [SimpleNamespace(module=SimpleNamespace(name=name)) for name in "ab"]}
def kernels(_request, device):
    if kinds[device] is None:
        raise ValueError("no kernels for it")
    return kinds[device]
def load_kernels(kernels, device, on_module):
    if os.nice(0) != before + 3:
        raise ValueError("it hurries")
    on_module(0, 2)
    on_module(2, 2)
    return ["a", "b"]
request.GeneralRequest.kernels = kernels
devices.load_kernels, devices.one_of_each_kind = load_kernels, lambda: list(kinds)
process.compile_as_asked()
"""


def test_a_device_that_fails_does_not_stop_another(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    order = json.dumps({"paths": [], "cache": str(tmp_path), "device": "ALL", "niceness": 3, "core": ""}).encode()
    command = [sys.executable, "-c", OF_TWO_KINDS]
    # the pipe must not end before the process does
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as other:
        other.stdin.write(struct.pack("<QQ", len(order), 0) + order)
        other.stdin.flush()
        said = other.stderr.read().decode().splitlines()
    assert (other.returncode, said) == (1, ["modules: 0 2", "modules: 2 2", "ValueError: no kernels for it"])
