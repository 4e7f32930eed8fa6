"""Make the project's virtual environment: python scripts/environment/environment.py FOLDER (called by environment.sh).

Run by the Python that the environment is for. A stamp in the folder holds what was installed; while it matches, nothing
is done.
"""

import hashlib
import json
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRESS = re.compile(r"compiled (\d+) of \d+ modules")  # a line of `render.py --prewarm`
MODULES_A_LINE = 10
GROUPS = ("scripts", "blender", "test")


def requirements(pyproject: Path) -> list[str]:
    """Everything that pyproject.toml asks for, in its own words."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    return project["dependencies"] + [line for group in GROUPS for line in project["optional-dependencies"][group]]


def main() -> int:
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print("usage: environment.py FOLDER (`make environment` calls it)", file=sys.stderr)
        return 2
    folder = Path(sys.argv[1]).absolute()
    base = Path(getattr(sys, "_base_executable", sys.executable)).resolve()
    wanted = requirements(ROOT / "pyproject.toml")
    # An environment holds absolute paths, so one that was moved is made again.
    identity = json.dumps([wanted, "{}.{}".format(*sys.version_info), str(folder)])
    stamp = folder / "raybatch-environment"
    expected = hashlib.sha256(identity.encode()).hexdigest()
    if stamp.is_file() and stamp.read_text(encoding="ascii").strip() == expected:
        return 0

    if Path(sys.prefix).resolve() == folder.resolve():  # it cannot clear itself: let the Python it came from do it
        return subprocess.call([str(base), __file__, str(folder)])
    print(
        f"RayBatch: making {folder.name} with Python {sys.version.split()[0]} ({base}); this takes a few minutes once",
        file=sys.stderr,
    )
    venv.EnvBuilder(clear=True, with_pip=True, symlinks=sys.platform != "win32").create(folder)
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input", *wanted]
    if code := subprocess.call(pip, stdin=subprocess.DEVNULL, stdout=sys.stderr):
        print(
            "RayBatch: the dependencies could not be installed (see above); run the command again when that is mended",
            file=sys.stderr,
        )
        return code
    stamp.write_text(expected + "\n", encoding="ascii")
    compile_kernels(python)
    return 0


def compile_kernels(python: Path) -> None:
    """Compile what any scene can begin with, so that the first render need not wait for it."""
    print("RayBatch: compiling the kernels that any scene can begin with; this takes a minute or two", file=sys.stderr)
    command = [str(python), str(ROOT / "scripts/render.py"), "--prewarm", "--device", "cpu"]
    said = ""  # last, beside how far it is
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        for line in process.stderr or ():
            if found := PROGRESS.fullmatch(line.strip()):
                if int(found[1]) % MODULES_A_LINE == 0:
                    print(f"RayBatch: {found[0]}", file=sys.stderr, flush=True)
            else:
                said = line.strip() or said
    if code := process.returncode:  # renders compile what they need
        print(f"RayBatch: they could not be compiled: {said[-300:] or f'it ended with code {code}'}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
