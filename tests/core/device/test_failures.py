"""A device that fails at any launch or allocation: the error names it, and the session renders on."""

import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.devices import free_memory, start_warp
from raybatch_addon.core.device.failures import named_failures
from raybatch_addon.core.errors import DeviceError, OutOfMemoryError, SceneError
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.device.faults import KINDS, Faults
from tests.core.device.small_kernels import ROOT
from tests.renders.beyond_memory import least_budget
from tests.support import scenes
from tests.support.under_test import DEVICE

ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
ON_CUDA = pytest.mark.skipif(DEVICE == "cpu", reason="on a CUDA device alone")
SETTINGS = RenderSettings(sample_count=2, bounce_max=3, seed=5, thread_count=1)

start_warp()
CPU = wp.get_device("cpu")


@wp.kernel
def _count(out: wp.array(dtype=float)):
    out[0] = 1.0


pytestmark = pytest.mark.usefixtures("general_kernels")


@pytest.fixture
def faults(monkeypatch):
    return Faults(monkeypatch)


def render(session):
    return session.render(scenes.mixed(), SETTINGS).passes["Combined"]


def render_beyond_memory(session):
    """With a page or two of geometry on the device, and the others in a file."""
    return least_budget.render(session, thread_count=1).passes["Combined"]


@ON_CPU
@pytest.mark.parametrize("rendered, step", [(render, 1), (render_beyond_memory, 9)])
@pytest.mark.parametrize("kind, raised, said", KINDS)
def test_a_failure_anywhere_is_named_and_the_next_render_is_whole(
    rendered, step, kind, raised, said, faults, pytestconfig, tmp_path
):
    def opened():
        """A session without pages of an earlier one."""
        return Session("cpu", page_folder=Path(tempfile.mkdtemp(dir=tmp_path)))

    expected = rendered(opened())
    faults.begin(kind)
    rendered(opened())
    for at in faults.places(pytestconfig.option.thorough, step):
        session = opened()
        faults.begin(kind, at)
        try:  # what is allocated for speed alone may be done without
            np.testing.assert_array_equal(rendered(session), expected)
            # how many launches there are beyond memory depends on the order in which pages come
            assert kind == "allocation" or (rendered is render_beyond_memory and faults.seen < at)
        except raised as error:
            assert pytest.raises(raised, match=said).matches(error), error
        faults.begin("")
        np.testing.assert_array_equal(rendered(session), expected, err_msg=f"after {kind} {at}")
        session.close()


def test_what_warp_reports_of_memory_is_named():
    with pytest.raises(OutOfMemoryError, match="cpu ran out of memory: Failed to allocate"), named_failures(CPU):
        wp.empty((2**31 - 1, 2**20), dtype=wp.mat44d, device="cpu")


def test_what_warp_reports_of_a_wrong_call_passes():
    with pytest.raises(RuntimeError) as raised, named_failures(CPU):
        wp.launch(_count, 1, [wp.zeros(1, dtype=wp.vec3, device="cpu")], device="cpu")
    assert not isinstance(raised.value, DeviceError)


@pytest.mark.parametrize("text", ["", "Unable to allocate 3.00 TiB for an array"])
def test_a_lack_of_the_computers_memory_is_named(text):
    said = "^this computer ran out of memory.*; close other programs"
    with pytest.raises(OutOfMemoryError, match=said), named_failures(CPU):
        raise MemoryError(text)


@pytest.mark.parametrize(
    "error", [RuntimeError("CUDA error, says a script"), SceneError("named already"), ZeroDivisionError()]
)
def test_other_errors_pass(error):
    with pytest.raises(type(error)) as raised, named_failures(CPU):
        raise error
    assert raised.value is error


LOST = """
import sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/scripts"]
import warp as wp
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.session import Session
from tests.core.device.test_failures import SETTINGS
from tests.support import scenes

session = Session(sys.argv[2])

@wp.kernel
def stray(out: wp.array(dtype=float)):
    out[wp.tid()] = 1.0

wp.launch(stray, 1 << 20, [wp.array(ptr=8, shape=1 << 20, dtype=float, device=sys.argv[2])], device=sys.argv[2])
try:
    session.render(scenes.mixed(), SETTINGS)
    print("rendered")
except RayBatchError as error:
    print(error)
"""


def test_a_device_that_says_it_has_no_memory_may_be_lost(monkeypatch):
    """Warp gives 0 bytes where the driver gives an error."""
    device = SimpleNamespace(is_cuda=True, is_capturing=False, alias="cuda:7", free_memory=0)
    monkeypatch.setattr(wp, "synchronize_device", lambda asked: None)
    assert free_memory(device) == 0

    def lost(asked):
        raise RuntimeError("Warp CUDA error 700: an illegal memory access was encountered")

    monkeypatch.setattr(wp, "synchronize_device", lost)
    with pytest.raises(DeviceError, match="cuda:7 stopped: .*; restart the program"):
        free_memory(device)


@ON_CUDA
def test_a_device_that_is_lost_is_named(tmp_path):
    script = tmp_path / "lost.py"  # Warp reads the source of kernels from a file
    script.write_text(LOST, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script), str(ROOT), DEVICE], capture_output=True, text=True)
    assert f"{DEVICE} stopped: " in done.stdout and "restart the program, or render on another device" in done.stdout


@ON_CUDA
def test_a_device_without_memory_is_named(monkeypatch):
    """The driver itself is asked for more than there is: what is free changes while others use the device."""
    expected, other = render(Session(DEVICE)), Session(DEVICE)
    with monkeypatch.context() as patch:
        for owner in (wp._src.context.CudaMempoolAllocator, wp._src.context.CudaDefaultAllocator):
            within = owner.allocate
            patch.setattr(owner, "allocate", lambda self, size, within=within: within(self, size + (1 << 50)))
        with pytest.raises(OutOfMemoryError, match=DEVICE):
            render(other)
    np.testing.assert_array_equal(render(other), expected)
