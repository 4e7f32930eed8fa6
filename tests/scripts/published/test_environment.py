"""Kernels that the making of the environment compiles: waited for a while, and then left to the background."""

import json
import os
import re
import sys
import threading
import time
from pathlib import Path

import pytest
from environment import environment
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


# --- the stamp of the kernels, by a compiler that stands in

RUNNING = """
import json, os, sys, time
from pathlib import Path
here = Path({here!r})
def main(arguments):
    (here / f"began-{{os.getpid()}}").write_text(json.dumps(arguments))
    while not (here / "go").exists():
        time.sleep(0.02)
    return int((here / "go").read_text() or 0)
"""


class Made:
    """An environment of which nothing is installed, in a folder of the test; its compiler ends when it is let go."""

    def __init__(self, here: Path):
        self.here, self.folder, self.core = here, here / "venv", here / "core"
        self.stamp = self.folder / "raybatch-kernels"
        self.installs: list[int] = []  # codes of those to come
        self.installed = 0
        (self.core / "native").mkdir(parents=True)
        for name in ("a.py", "native/b.h"):
            (self.core / name).write_text("old")

    def make(self, kernels: str = "wait") -> int:
        """`environment.py` for this folder; its exit code."""
        sys.argv = ["environment.py", str(self.folder), kernels]
        return environment.main()

    def let_go(self, code: int = 0) -> None:
        """The compiler, and those to come, end with `code`."""
        (self.here / "go").write_text(str(code))

    def compilers(self) -> int:
        """How many were started and have begun so far."""
        return len(list(self.here.glob("began-*")))


@pytest.fixture
def made(tmp_path, monkeypatch):
    one = Made(tmp_path)
    script = tmp_path / "compile.py"
    script.write_text(RUNNING.format(here=str(tmp_path)))

    def install(_python, _wanted):
        one.installed += 1
        return one.installs.pop(0) if one.installs else 0

    def make(folder, _base):
        (folder / "bin").mkdir(parents=True, exist_ok=True)
        (folder / "bin/python").unlink(missing_ok=True)
        (folder / "bin/python").symlink_to(sys.executable)

    monkeypatch.setattr(sys, "argv", list(sys.argv))
    monkeypatch.setattr(environment, "make", make)
    monkeypatch.setattr(environment, "install", install)
    monkeypatch.setattr(environment, "prewarming", lambda: [str(script), "--some", "cpu"])
    monkeypatch.setattr(environment, "CORE", str(one.core))
    monkeypatch.setattr(environment, "WAIT_SECONDS", AT_MOST)
    for variable in environment.KERNEL_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    yield one
    one.let_go()


def test_kernels_that_are_there_are_not_compiled_again(made):
    made.let_go()
    assert made.make() == 0 and made.stamp.is_file()
    assert (made.installed, made.compilers()) == (2, 1)
    assert json.loads(next(made.here.glob("began-*")).read_text()) == ["--some", "cpu"]
    assert made.make() == 0 and (made.installed, made.compilers()) == (2, 1)


def test_a_compiler_that_fails_leaves_no_stamp_and_is_called_again(made, capfd):
    made.let_go(3)
    assert made.make() == 0 and not made.stamp.exists()
    assert "could not be compiled: it ended with code 3" in capfd.readouterr().err
    made.let_go()
    assert made.make() == 0 and made.stamp.is_file()
    assert (made.installed, made.compilers()) == (2, 2)


@pytest.mark.skipif(os.name != "posix", reason="signals end processes on POSIX")
def test_a_compiler_that_is_killed_in_the_background_is_called_again(made, monkeypatch):
    monkeypatch.setattr(environment, "WAIT_SECONDS", 0.0)
    assert made.make() == 0
    assert wait_for(made.compilers) and not made.stamp.exists()
    (began,) = made.here.glob("began-*")
    os.kill(int(began.name.removeprefix("began-")), 9)
    made.let_go()
    assert wait_for(lambda: made.make() == 0 and made.stamp.exists()), "the killed one counts as one that compiles"


def test_the_stamp_comes_with_the_end_of_the_background(made, monkeypatch):
    monkeypatch.setattr(environment, "WAIT_SECONDS", 0.0)
    assert made.make() == 0
    assert wait_for(made.compilers) and not made.stamp.exists()
    made.let_go()
    assert wait_for(made.stamp.exists)


def test_where_tests_follow_all_kernels_are_waited_for(made, monkeypatch):
    monkeypatch.setattr(environment, "WAIT_SECONDS", 0.0)
    later = threading.Timer(0.3, made.let_go)
    later.start()
    assert made.make("all") == 0 and made.stamp.is_file()
    later.join()


@pytest.mark.skipif(environment.fcntl is None, reason="on Windows both compile")
def test_they_are_waited_for_where_another_call_compiles_them(made, monkeypatch):
    monkeypatch.setattr(environment, "WAIT_SECONDS", 0.0)
    assert made.make() == 0 and wait_for(made.compilers)
    later = threading.Timer(0.3, made.let_go)
    later.start()
    assert made.make("all") == 0 and made.stamp.is_file() and made.compilers() == 1
    later.join()


@pytest.mark.skipif(environment.fcntl is None, reason="on Windows both compile")
def test_a_second_call_does_not_compile_beside_the_first(made, monkeypatch, capfd):
    monkeypatch.setattr(environment, "WAIT_SECONDS", 0.0)
    assert made.make() == 0 and wait_for(made.compilers)
    assert made.make() == 0
    assert "compiled already" in capfd.readouterr().err
    made.let_go()
    assert wait_for(made.stamp.exists) and made.compilers() == 1


@pytest.mark.parametrize("name", ["a.py", "native/b.h", "native/new.h"])
def test_kernels_of_other_code_are_compiled_and_not_waited_for(made, capfd, name):
    made.let_go()
    assert made.make() == 0
    (made.here / "go").unlink()
    before = made.stamp.read_text()
    (made.core / name).write_text("new")
    assert made.make() == 0, "it would wait for as long as for a new environment"
    assert "compiled in the background" in capfd.readouterr().err and made.installed == 2
    assert wait_for(lambda: made.compilers() == 2) and made.stamp.read_text() == before
    made.let_go()
    assert wait_for(lambda: made.stamp.read_text() != before)


def test_each_folder_of_kernels_and_each_optimisation_has_a_stamp(made, monkeypatch):
    made.let_go()
    assert made.make() == 0
    asked = ("RAYBATCH_KERNEL_CACHE", str(made.here / "kernels")), ("RAYBATCH_OPTIMISATION", "1")
    for compilers, variable in enumerate(asked, 2):
        monkeypatch.setenv(*variable)
        assert made.make() == 0 and made.compilers() == compilers
        assert made.make() == 0 and made.compilers() == compilers


def test_later_compiles_nothing(made):
    assert made.make("later") == 0 and made.installed == 2
    assert not list(made.folder.glob("raybatch-kernels*"))


@pytest.mark.skipif(os.name != "posix", reason="signals end processes on POSIX")
def test_a_failed_installation_ends_the_compiler(made):
    made.installs = [0, 5]
    assert made.make() == 5
    made.let_go()
    time.sleep(0.5)
    assert not made.stamp.exists() and not (made.folder / "raybatch-environment").exists()


@pytest.mark.parametrize("arguments", [[], ["-h"], ["venv", "never"]])
def test_bad_arguments_are_told(monkeypatch, capfd, arguments):
    monkeypatch.setattr(sys, "argv", ["environment.py", *arguments])
    assert environment.main() == 2 and "usage: environment.py" in capfd.readouterr().err
