#!/usr/bin/env python3
"""Build the core as a wheel, `raybatch`, for programs and machines without Blender.

The wheel goes into dist/. It holds the core under the name `raybatch`, and asks for NumPy and Warp, as pyproject.toml
says; kernels are compiled where it is used. Exit codes: 0; 1 where something failed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.command import exit_code
from package import project_version

from raybatch_addon.core.errors import RayBatchError

NAME = "raybatch"


class WheelError(RayBatchError):
    """Why there is no wheel, in one line."""


def project_of_wheel() -> str:
    """Its pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    said = {
        "name": NAME,
        "version": project_version(),
        "description": "A path tracer that batches rays, in Python and NVIDIA Warp",
        "readme": "README.md",
        "license": project["license"]["text"],
        "license-files": ["LICENSE"],
        "requires-python": project["requires-python"],
        "dependencies": project["dependencies"],
    }
    # values of JSON are such of TOML
    lines = [f"{name} = {json.dumps(value)}" for name, value in said.items()]
    return "\n".join(
        (
            "[build-system]",
            'requires = ["setuptools>=77"]',
            'build-backend = "setuptools.build_meta"',
            "",
            "[project]",
            *lines,
            "",
            "[project.optional-dependencies]",
            f"cluster = {json.dumps(project['optional-dependencies']['cluster'])}",
            "",
            "[tool.setuptools.packages.find]",
            f'include = ["{NAME}*"]',
            "",
            "[tool.setuptools.package-data]",
            '"*" = ["**/*.h", "*.npz", "py.typed"]',
            "",
        )
    )


def build_wheel(folder: Path) -> Path:
    """Build the wheel into `folder`; raises `WheelError`."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        sources = Path(made)
        shutil.copytree(ROOT / "raybatch_addon/core", sources / NAME, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "LICENSE", sources)
        shutil.copy(ROOT / "docs/library.md", sources / "README.md")
        (sources / "pyproject.toml").write_text(project_of_wheel(), encoding="utf-8")
        pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command = [*pip, "--no-build-isolation", "--wheel-dir", str(folder), str(sources)]
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=sources)
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        raise WheelError("the wheel could not be built (see above); is this the environment of `make environment`?")
    return folder / f"{NAME}-{project_version()}-py3-none-any.whl"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="FOLDER", help="default: dist")
    options = parser.parse_args()
    return exit_code("wheel.py", lambda: run(options), errors=(RayBatchError, OSError))


def run(options: argparse.Namespace) -> int:
    """Build the wheel, and say where it is; the exit code."""
    print(build_wheel(options.out.absolute()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
