"""Notes about compiled kernels are reported by a render that goes on, whatever was cancelled before."""

import time

import pytest
import warp as wp

from raybatch_addon.core.ahead.prepare import Preparation
from raybatch_addon.core.device import devices, loading
from raybatch_addon.core.device.notes import note, take_notes
from raybatch_addon.core.measure.parts import Parts
from raybatch_addon.core.wavefront.scene.kept_scene import KeptScene
from tests.core.device.small_kernels import forget, keep_in, small_kernel

SECONDS_MOST = 60.0  # until a thread that has nothing to do has done it


@pytest.fixture(autouse=True)
def nothing_noted():
    """Other tests leave no notes here, and find none of these."""
    take_notes()
    yield
    take_notes()


def test_a_render_that_goes_on_reports_the_notes():
    note("the kernel of a test was damaged")
    preparation = Preparation([], wp.get_device("cpu"), None, lambda: False, Parts("check"))
    preparation.run(lambda: "the scene", lambda: False, lambda *progress: None, KeptScene(), ())
    assert preparation.warnings == ["the kernel of a test was damaged"]
    assert take_notes() == []


def test_a_render_that_is_cancelled_leaves_the_notes_to_the_next_one():
    note("the kernel of another test was damaged")
    parts = Parts("check")
    preparation = Preparation([], wp.get_device("cpu"), None, lambda: False, parts)

    def kernels_are_loaded():
        return parts.compile_seconds > 0

    def build():
        until = time.monotonic() + SECONDS_MOST
        while not preparation.is_given_up() and time.monotonic() < until:
            time.sleep(0.001)

    assert preparation.run(build, kernels_are_loaded, lambda *progress: None, KeptScene(), ()) == (None, [])
    assert preparation.warnings == []
    assert take_notes() == ["the kernel of another test was damaged"]


@pytest.mark.parametrize(("is_there", "message"), [(False, "Compiling kernels"), (True, "Loading kernels")])
def test_kernels_that_are_there_are_loaded_and_others_compiled(tmp_path, monkeypatch, is_there, message):
    """Status lines say which."""
    keep_in(tmp_path, monkeypatch)
    kernel, device, said = small_kernel(), wp.get_device("cpu"), []
    if is_there:
        devices.load_module(kernel, device)
        forget(kernel)
    within = loading.find_files

    def find_files(*which):
        """Looked for as long as a status line needs to be seen."""
        found = within(*which)
        until = time.monotonic() + SECONDS_MOST
        while found and not said and time.monotonic() < until:
            time.sleep(0.001)
        return found

    monkeypatch.setattr(loading, "find_files", find_files)
    parts = Parts("check")
    preparation = Preparation([kernel], device, None, lambda: False, parts)
    preparation.run(
        lambda: "the scene",
        lambda: False,
        lambda stage, _fraction, text: said.append(text) if stage == "compile" else None,
        KeptScene(),
        (),
    )
    assert f"{message} (0 of 1)" in said
    assert is_there == all("Compiling" not in text for text in said)
