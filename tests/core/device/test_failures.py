"""A device that fails at any launch or allocation: the error names it, and the session renders on."""

import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device import failures
from raybatch_addon.core.device.devices import start_warp
from raybatch_addon.core.device.failures import named_failures
from raybatch_addon.core.errors import DeviceError, OutOfMemoryError, SceneError
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.device.small_kernels import ROOT
from tests.support import scenes
from tests.support.under_test import DEVICE

ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
ON_CUDA = pytest.mark.skipif(DEVICE == "cpu", reason="on a CUDA device alone")
SETTINGS = RenderSettings(sample_count=2, bounce_max=3, seed=5, thread_count=1)
TRIED = 12  # places of each kind, where it is not thorough

start_warp()
CPU = wp.get_device("cpu")


@wp.kernel
def _count(out: wp.array(dtype=float)):
    out[0] = 1.0


pytestmark = pytest.mark.usefixtures("general_kernels")


class Faults:
    """Counts launches and allocations, and lets one of them fail as Warp does."""

    def __init__(self, monkeypatch):
        self.kind, self.at, self.seen = "", 0, 0
        context = wp._src.context
        self._watch(
            monkeypatch, wp, "launch", "launch", "Warp CUDA error 700: an illegal memory access was encountered"
        )
        self._watch(monkeypatch, context.Launch, "launch", "launch", "Warp CUDA error 719: unspecified launch failure")
        message = "Failed to allocate 640 bytes on device 'cpu'"
        self._watch(monkeypatch, context.CpuDefaultAllocator, "allocate", "allocation", message)

    def _watch(self, monkeypatch, owner, name, kind, message):
        within = getattr(owner, name)

        def watched(*arguments, **options):
            if kind == self.kind:
                self.seen += 1
                if self.seen == self.at:
                    raise RuntimeError(message)
            return within(*arguments, **options)

        monkeypatch.setattr(owner, name, watched)

    def begin(self, kind, at=0):
        self.kind, self.at, self.seen = kind, at, 0


@pytest.fixture
def faults(monkeypatch):
    monkeypatch.setattr(failures, "_is_of_warp", lambda _error: True)  # they are raised here
    return Faults(monkeypatch)


def render(session):
    return session.render(scenes.mixed(), SETTINGS).passes["Combined"]


@ON_CPU
@pytest.mark.parametrize(
    "kind, raised, said",
    [
        ("launch", DeviceError, "cpu stopped: Warp CUDA error 7.*; try again, or render on another device"),
        ("allocation", OutOfMemoryError, "close other programs|use few"),
    ],
)
def test_a_failure_anywhere_is_named_and_the_next_render_is_whole(kind, raised, said, faults, pytestconfig):
    expected = render(Session("cpu"))
    faults.begin(kind)
    render(Session("cpu"))
    count = faults.seen
    assert count > 50
    step = 1 if pytestconfig.option.thorough else count // TRIED
    for at in range(1, count + 1, step):
        session = Session("cpu")
        faults.begin(kind, at)
        try:  # what is allocated for speed alone may be done without
            np.testing.assert_array_equal(render(session), expected)
            assert kind == "allocation"
        except raised as error:
            assert pytest.raises(raised, match=said).matches(error), error
        faults.begin("")
        np.testing.assert_array_equal(render(session), expected, err_msg=f"after {kind} {at}")
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
sys.path.insert(0, sys.argv[1])
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
