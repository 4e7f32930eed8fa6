"""Kernels that the making of the environment compiles: waited for a while, and then left to the background."""

import os
import re
import sys
import time

import pytest
from environment.environment import ROOT, begin_apart, requirements, watch

AT_MOST = 60.0  # seconds for a process to do what takes it one
COMPILER = """
import pathlib, sys, time
for done in range(1, 21):
    print(f"compiled {done} of 30 modules", file=sys.stderr, flush=True)
while not pathlib.Path(sys.argv[1]).exists():
    time.sleep(0.05)
pathlib.Path(sys.argv[2]).write_text("done")
"""


def compiler(tmp_path) -> list[str]:
    return [sys.executable, "-c", COMPILER, str(tmp_path / "go"), str(tmp_path / "done")]


def wait_for(condition) -> bool:
    deadline = time.monotonic() + AT_MOST
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)
    return condition()


def test_what_kernels_are_compiled_by_is_installed_first():
    core, rest = requirements(ROOT / "pyproject.toml")
    assert {re.match(r"[a-z-]+", line)[0] for line in core} == {"numpy", "warp-lang"}
    assert any(line.startswith("bpy") for line in rest)
    assert not any(line.startswith("numpy") for line in rest), "another one would be put in the place of the first"


def test_what_takes_longer_goes_on_in_the_background(tmp_path, capfd):
    log = tmp_path / "kernels.log"
    watch(begin_apart(compiler(tmp_path), log), log, 3.0)
    said = capfd.readouterr().err
    assert "compiled 10 of 30 modules\n" in said, "every tenth module is told"
    assert "compiled 20 of 30 modules; the rest is compiled in the background" in said
    assert str(log) in said
    assert not (tmp_path / "done").exists()
    (tmp_path / "go").touch()
    assert wait_for((tmp_path / "done").exists), "the process ended with the wait"


def test_nothing_is_waited_for_when_it_begins_in_the_background(tmp_path, capfd):
    watch(begin_apart(compiler(tmp_path), tmp_path / "kernels.log"), tmp_path / "kernels.log", 0.0)
    assert "they are compiled in the background" in capfd.readouterr().err
    (tmp_path / "go").touch()
    assert wait_for((tmp_path / "done").exists)


def test_a_compiler_that_ends_is_not_waited_for(tmp_path, capfd):
    (tmp_path / "go").touch()
    watch(begin_apart(compiler(tmp_path), tmp_path / "kernels.log"), tmp_path / "kernels.log", AT_MOST)
    assert (tmp_path / "done").exists()
    assert "background" not in capfd.readouterr().err


@pytest.mark.parametrize("last", ["the compiler is broken", ""])
def test_a_compiler_that_fails_is_told_with_its_last_words(tmp_path, capfd, last):
    command = [sys.executable, "-c", f"import sys; print({last!r}, file=sys.stderr); sys.exit(3)"]
    watch(begin_apart(command, tmp_path / "kernels.log"), tmp_path / "kernels.log", AT_MOST)
    assert f"could not be compiled: {last or 'it ended with code 3'}\n" in capfd.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="signals end processes on POSIX")
def test_a_compiler_that_a_signal_ended_has_not_said_why(tmp_path, capfd):
    """How far it was is no reason."""
    script = "import os, sys\nprint('compiled 7 of 12 modules', file=sys.stderr, flush=True)\nos.kill(os.getpid(), 9)\n"
    watch(begin_apart([sys.executable, "-c", script], tmp_path / "kernels.log"), tmp_path / "kernels.log", AT_MOST)
    assert capfd.readouterr().err.splitlines()[1:] == ["RayBatch: they could not be compiled: it ended with code -9"]


@pytest.mark.skipif(not hasattr(os, "nice"), reason="priorities are told by os.nice")
def test_it_runs_at_low_priority(tmp_path):
    log = tmp_path / "kernels.log"
    watch(begin_apart([sys.executable, "-c", "import os; print(os.nice(0))"], log), log, AT_MOST)
    assert int(log.read_text()) > os.nice(0)
