"""Make the project's virtual environment: python scripts/environment/environment.py FOLDER [wait|later|start].

Run by the Python that the environment is for (`environment.sh` finds it). A stamp in the folder holds what was
installed; while it matches, nothing is installed again. Another stamp stands for the kernels that any scene can begin
with. Where it is missing, a process of its own compiles them, in the background after two minutes (`wait`), or
from the start (`start`); `later` leaves them to a later call.
"""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import time
import tomllib
import venv
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRESS = re.compile(r"compiled (\d+) of \d+ modules")  # a line of `render.py --prewarm`
MODULES_A_LINE = 10
WAIT_SECONDS = 120.0  # for kernels, before they are left to the background: a picture that comes sooner waits for them
TICK_SECONDS = 0.1
NICENESS = 10  # renders, tests and checks come first
KERNELS = ("wait", "later", "start")  # the first where nothing is said
GROUPS = ("scripts", "blender", "test")


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
    identity = json.dumps([core, rest, "{}.{}".format(*sys.version_info), str(folder)])
    installed, compiled = folder / "raybatch-environment", folder / "raybatch-kernels"
    expected = hashlib.sha256(identity.encode()).hexdigest()
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    command = [str(python), str(ROOT / "scripts/render.py"), "--prewarm", "--device", "cpu"]
    log = folder / "raybatch-kernels.log"
    compiler = None
    if not is_stamped(installed, expected):
        if Path(sys.prefix).resolve() == folder.resolve():  # it cannot clear itself: the Python it came from does it
            return subprocess.call([str(base), __file__, *sys.argv[1:]])
        make(folder, base)
        if code := install(python, core):
            return code
        if kernels != "later":  # beside the installation, which leaves processors idle
            compiler = begin_apart(command, log)
        code = 1
        try:
            code = install(python, rest)
        finally:
            if code and compiler:
                compiler.terminate()
        if code:
            return code
        installed.write_text(expected + "\n", encoding="ascii")
    if kernels != "later" and not is_stamped(compiled, expected):
        watch(compiler or begin_apart(command, log), log, WAIT_SECONDS if kernels == "wait" else 0.0)
        compiled.write_text(expected + "\n", encoding="ascii")
    return 0


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
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input", *wanted]
    code = subprocess.call(pip, stdin=subprocess.DEVNULL, stdout=sys.stderr)
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
        print(f"RayBatch: {so_far} {verb} compiled in the background, which writes to {log}", file=sys.stderr)
    elif code := process.returncode:  # renders compile what they need
        print(f"RayBatch: they could not be compiled: {said[-300:] or f'it ended with code {code}'}", file=sys.stderr)


def begin_apart(command: Sequence[str], log: Path) -> subprocess.Popen:
    """Begin `command` at low priority; the end of this process, or of its terminal, does not end it."""
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
            start_new_session=True,
        )


if __name__ == "__main__":
    sys.exit(main())
