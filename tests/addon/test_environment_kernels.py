"""The environment compiles kernels ahead, says how far it is, and is made all the same where it cannot."""

import os
import sys

import pytest
from environment import environment

SCRIPT = """
import sys
print(*(f"compiled {done} of 12 modules" for done in range(13)), sep="\\n", file=sys.stderr)
print("12 modules are ready in a folder", file=sys.stderr)
if {fails}:
    print("render.py: error: the disk is full", file=sys.stderr)
    sys.exit(1)
"""


@pytest.mark.parametrize("fails", [False, True])
def test_how_far_it_is_is_said(tmp_path, monkeypatch, capfd, fails):
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts/render.py").write_text(SCRIPT.format(done="{done}", fails=fails), encoding="utf-8")
    monkeypatch.setattr(environment, "ROOT", tmp_path)
    environment.compile_kernels(sys.executable)
    first, *lines = capfd.readouterr().err.splitlines()
    assert "compiling the kernels that any scene can begin with" in first
    assert lines[:2] == ["RayBatch: compiled 0 of 12 modules", "RayBatch: compiled 10 of 12 modules"]
    assert lines[2:] == (["RayBatch: they could not be compiled: render.py: error: the disk is full"] * fails)


@pytest.mark.skipif(os.name != "posix", reason="signals end processes on POSIX")
def test_what_a_signal_ended_is_said(tmp_path, monkeypatch, capfd):
    """It has not said why: how far it was is no reason."""
    script = "import os, sys\nprint('compiled 7 of 12 modules', file=sys.stderr, flush=True)\nos.kill(os.getpid(), 9)\n"
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts/render.py").write_text(script, encoding="utf-8")
    monkeypatch.setattr(environment, "ROOT", tmp_path)
    environment.compile_kernels(sys.executable)
    assert capfd.readouterr().err.splitlines()[1:] == ["RayBatch: they could not be compiled: it ended with code -9"]
