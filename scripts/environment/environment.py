"""Make the project's virtual environment: python scripts/environment/environment.py FOLDER [wait|all|later|start].

Run by the Python that the environment is for (`environment.sh` finds it). A stamp in the folder holds what was
installed; while it matches, nothing is installed again. Another stamp stands for the kernels that any scene can begin
with, and holds the code that they are of; a process of its own compiles them and writes it when they are there. Where
it is missing, they are compiled in the background after a minute (`wait`), or from the start (`start`), as where it
is of other code. With `all` a new environment waits until all are there: tests that ran beside it would compile many
of them too. `later` leaves them to a later call.
"""

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
import venv
from collections.abc import Iterator, Sequence
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

ROOT = Path(__file__).resolve().parents[2]
PROGRESS = re.compile(r"compiled (\d+) of \d+ modules")  # a line of `render.py --prewarm`
MODULES_A_LINE = 10
WAIT_SECONDS = 60.0  # for kernels, before they are left to the background: those of usual scenes are there by then
TICK_SECONDS = 0.1
NICENESS = 10  # renders, tests and checks come first
KERNELS = ("wait", "all", "later", "start")  # the first where nothing is said
GROUPS = ("scripts", "cluster", "blender", "test")
CORE = "raybatch_addon/core"  # whose code kernels are made of
SOURCES = (".py", ".h")
# They name the folder that keeps kernels, and say how much compilers optimise them, where that is not as for users
KERNEL_VARIABLES = ("RAYBATCH_KERNEL_CACHE", "RAYBATCH_OPTIMISATION")


def requirements(pyproject: Path) -> tuple[list[str], list[str]]:
    """Everything that pyproject.toml asks for, in its own words: what the core needs, by which kernels can be compiled,
    and the rest.
    """
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    rest = [line for group in GROUPS for line in project["optional-dependencies"][group]]
    # NumPy in the version that Blender's module wants, or another one would take its place while kernels are compiled
    core = project["dependencies"] + [line for line in rest if line.startswith("numpy")]
    return core, [line for line in rest if line not in core]


def main() -> int:
    kernels = sys.argv[2] if len(sys.argv) == 3 else KERNELS[0]
    if len(sys.argv) not in (2, 3) or sys.argv[1].startswith("-") or kernels not in KERNELS:
        print(f"usage: environment.py FOLDER [{'|'.join(KERNELS)}] (`make environment` calls it)", file=sys.stderr)
        return 2
    folder = Path(sys.argv[1]).absolute()
    base = Path(getattr(sys, "_base_executable", sys.executable)).resolve()
    core, rest = requirements(ROOT / "pyproject.toml")
    # An environment holds absolute paths, so one that was moved is made again.
    expected = digest([json.dumps([core, rest, "{}.{}".format(*sys.version_info), str(folder)]).encode()])
    installed = folder / "raybatch-environment"
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    job = KernelJob(folder, expected, python)
    if not is_stamped(installed, expected):
        if Path(sys.prefix).resolve() == folder.resolve():  # it cannot clear itself: the Python it came from does it
            return subprocess.call([str(base), __file__, *sys.argv[1:]])
        make(folder, base)
        if code := install(python, core):
            return code
        if kernels != "later":  # beside the installation, which leaves processors idle
            job.begin()
        code = 1
        try:
            code = install(python, rest)
        finally:
            if code:
                job.end()
        if code:
            return code
        installed.write_text(expected + "\n", encoding="ascii")
    if kernels != "later":
        job.finish({"wait": WAIT_SECONDS, "all": math.inf}.get(kernels, 0.0))
    return 0


class KernelJob:
    """The process that compiles what any scene can begin with; another call's may be at it already."""

    def __init__(self, folder: Path, environment: str, python: Path):
        """In the `folder` of an environment that `environment` stands for, whose Python is `python`."""
        # each folder that keeps kernels has a stamp of its own, and so have kernels that are optimised otherwise
        asked = [os.environ.get(each, "") for each in KERNEL_VARIABLES]
        name = f"raybatch-kernels-{digest([each.encode() for each in asked])[:8]}" if any(asked) else "raybatch-kernels"
        self._stamp, self._log = folder / name, folder / f"{name}.log"
        self._lock = folder / f"{name}.lock"  # held by the process that compiles, as long as there is one
        self._expected = digest([environment.encode(), *sources(ROOT / CORE)])
        self._command = [str(python), str(Path(__file__).with_name("stamped.py")), str(self._stamp), self._expected]
        self._process: subprocess.Popen | None = None

    def begin(self) -> None:
        """Begin to compile, unless another process does."""
        with held(self._lock) as lock:
            if lock is not None:
                self._process = begin_apart([*self._command, *prewarming()], self._log, [lock] if lock else [])

    def end(self) -> None:
        """End what was begun."""
        if self._process:
            self._process.terminate()

    def finish(self, seconds: float) -> None:
        """See that kernels are there, or being compiled, and wait for so many `seconds` in a new environment.

        After a change of the code nobody waits: whoever works on it calls this before each check and render, and tests
        compile beside it what they need.
        """
        if self._process is None:
            if is_stamped(self._stamp, self._expected):
                return
            if self._stamp.is_file():  # of other code
                seconds = 0.0
            self.begin()
        if self._process:
            watch(self._process, self._log, seconds)
            return
        print(
            f"RayBatch: kernels are being compiled already, by a process that writes to {self._log}",
            file=sys.stderr,
            flush=True,
        )
        while seconds == math.inf and not is_stamped(self._stamp, self._expected):
            with held(self._lock) as lock:
                if lock is not None:  # it has ended, and failed: tests compile what they need
                    return
            time.sleep(TICK_SECONDS)


def prewarming() -> list[str]:
    """The script that compiles what any scene can begin with, and its arguments."""
    return [str(ROOT / "scripts/render.py"), "--prewarm", "--device", "cpu"]


def digest(parts: Sequence[bytes]) -> str:
    """Of all `parts`, in this order."""
    found = hashlib.sha256()
    for part in parts:
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()


def sources(folder: Path) -> list[bytes]:
    """Names and contents of all sources below `folder`."""
    paths = sorted(each for each in folder.rglob("*") if each.suffix in SOURCES)
    return [part for each in paths for part in (each.relative_to(folder).as_posix().encode(), each.read_bytes())]


@contextlib.contextmanager
def held(lock: Path) -> Iterator[int | None]:
    """The file `lock`, open, and held by this process and those that inherit it until all have closed it; None where
    others hold it. 0 on Windows, where nobody holds it: two processes may compile the same then, which costs time and
    nothing else, as each puts whole files into the folder of kernels.
    """
    if fcntl is None:
        yield 0
        return
    with lock.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
        else:
            yield file.fileno()


def is_stamped(stamp: Path, expected: str) -> bool:
    """Whether the file `stamp` says that what is `expected` was made."""
    return stamp.is_file() and stamp.read_text(encoding="ascii").strip() == expected


def make(folder: Path, base: Path) -> None:
    """Make an empty environment in `folder`; `base` is the Python that runs."""
    print(
        f"RayBatch: making {folder.name} with Python {sys.version.split()[0]} ({base}); this takes a few minutes once",
        file=sys.stderr,
    )
    venv.EnvBuilder(clear=True, with_pip=True, symlinks=sys.platform != "win32").create(folder)


def install(python: Path, wanted: Sequence[str]) -> int:
    """Install what is `wanted` in the environment of `python`; pip's exit code."""
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
    if not sys.dont_write_bytecode:  # a module is compiled when it is first used; three of four never are
        pip.append("--no-compile")
    code = subprocess.call([*pip, *wanted], stdin=subprocess.DEVNULL, stdout=sys.stderr)
    if code:
        print(
            "RayBatch: the dependencies could not be installed (see above); run the command again when that is mended",
            file=sys.stderr,
        )
    return code


def watch(process: subprocess.Popen, log: Path, seconds: float) -> None:
    """Wait for `process`, which compiles kernels and writes to the file `log`, for so many `seconds`, and tell of it.

    After them it goes on in the background: renders compile what they need, and need not wait for the rest.
    """
    print("RayBatch: compiling the kernels that any scene can begin with", file=sys.stderr, flush=True)
    deadline = time.monotonic() + seconds
    said = reached = rest = ""  # last, beside how far it is; that; and a line that is not whole yet
    try:
        with log.open(encoding="utf-8", errors="replace") as lines:
            has_ended = False
            while not has_ended and time.monotonic() < deadline:
                has_ended = process.poll() is not None  # looked at before the last lines are read
                *whole, rest = (rest + lines.read()).split("\n")
                for line in whole:
                    if found := PROGRESS.fullmatch(line.strip()):
                        reached = found[0]
                        if int(found[1]) % MODULES_A_LINE == 0:
                            print(f"RayBatch: {reached}", file=sys.stderr, flush=True)
                    else:
                        said = line.strip() or said
                if not has_ended:
                    time.sleep(TICK_SECONDS)
    except KeyboardInterrupt:
        process.terminate()
        raise
    if process.poll() is None:
        so_far = f"{reached}; the rest" if reached else "they"
        verb = "is" if reached else "are"
        print(
            f"RayBatch: {so_far} {verb} compiled in the background, which writes to {log}; until they are there the "
            "first render of a file may compile its own, for up to a minute",
            file=sys.stderr,
        )
    elif code := process.returncode:  # renders compile what they need
        print(f"RayBatch: they could not be compiled: {said[-300:] or f'it ended with code {code}'}", file=sys.stderr)


def begin_apart(command: Sequence[str], log: Path, inherited: Sequence[int] = ()) -> subprocess.Popen:
    """Begin `command` at low priority; the end of this process, or of its terminal, does not end it.

    It inherits the open files `inherited`.
    """
    flags, before = 0, []
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
    elif shutil.which("nice"):
        before = ["nice", "-n", str(NICENESS)]
    with log.open("wb") as out:
        return subprocess.Popen(
            [*before, *command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            creationflags=flags,
            pass_fds=inherited,
            start_new_session=True,
        )


if __name__ == "__main__":
    sys.exit(main())
