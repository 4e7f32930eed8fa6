"""Running the project's scripts as a person would, in a process of their own."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "scripts"

# Makes a Python in which bpy cannot be imported, as on a machine without Blender
HIDE_BPY = """
import sys
class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name == "bpy" or name.startswith("bpy."):
            raise ModuleNotFoundError("no module named bpy (hidden by a test)", name="bpy")
sys.meta_path.insert(0, NoBlender())
"""


def run_python(code: str, *arguments, **environment) -> subprocess.CompletedProcess:
    """Run `code` with `arguments` as sys.argv[1:]."""
    # without Blender's own way down, which can hang
    code += "\nimport os, sys\nsys.stdout.flush()\nsys.stderr.flush()\nos._exit(0)\n"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    variables = {**os.environ, **{name: str(value) for name, value in environment.items()}}
    return subprocess.run(
        command, capture_output=True, text=True, stdin=subprocess.DEVNULL, env=variables, cwd=ROOT, timeout=240
    )


def run_script(name: str, *arguments, before: str = "", **environment) -> subprocess.CompletedProcess:
    """Run scripts/`name`, after the code `before`."""
    path = str(SCRIPTS / name)
    code = (
        f"{before}\nimport runpy, sys\nsys.argv[0] = {path!r}\nsys.path.insert(0, "
        f"{str(SCRIPTS)!r})\nrunpy.run_path({path!r}, run_name='__main__')"
    )
    return run_python(code, *arguments, **environment)


def error_line(done: subprocess.CompletedProcess) -> str:
    """The one line that an unsuccessful script says."""
    assert done.returncode != 0, done.stderr
    assert done.stdout == ""
    lines = [line for line in done.stderr.splitlines() if line]
    assert len(lines) == 1, done.stderr
    return lines[0]
