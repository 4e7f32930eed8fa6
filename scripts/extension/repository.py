#!/usr/bin/env python3
"""Make a static repository of extensions: python scripts/extension/repository.py [--blender BLENDER].

The zips that scripts/package.py built of this version are put into a folder, and Blender's own `extension
server-generate` writes the list (index.json) that Blender reads, and a page for people (index.html). Any web server can
serve the folder; a user adds the address of index.json in Blender's preferences, and gets updates from there. Exit
codes: 0; 1 where there is no Blender, or something failed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.command import exit_code
from package import project_version

from raybatch_addon.core.errors import RayBatchError


class RepositoryError(RayBatchError):
    """Why there is no repository, in one line."""


def find_blender(given: str) -> str:
    """The program that `given` names, or that is called blender; raises `RepositoryError`."""
    found = shutil.which(given or "blender")
    if found is None:
        whose = f"there is no program {given}" if given else "there is no program blender on PATH"
        raise RepositoryError(f"{whose}: name Blender's with BLENDER=/path/to/blender")
    return found


def build_packages(folder: Path) -> None:
    """Build the zips of all platforms into `folder`; what goes wrong is on standard error."""
    command = [sys.executable, str(ROOT / "scripts/package.py"), "--out", str(folder)]
    if code := subprocess.call(command, stdin=subprocess.DEVNULL, stdout=sys.stderr):
        raise RepositoryError(f"the zips could not be built (exit code {code}, see above)")


def put_packages(packages: Path, folder: Path) -> list[Path]:
    """Copy the zips of this version from `packages` in place of older ones; returns the copies."""
    if packages.resolve() == folder.resolve():
        raise RepositoryError(f"{folder} holds the zips themselves: choose another folder for the repository")
    version = project_version()
    zips = sorted(packages.glob(f"raybatch-{version}-*.zip"))
    if not zips:
        raise RepositoryError(f"{packages} has no zip of version {version}: run `make package` first")
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("raybatch-*.zip"):
        old.unlink()
    return [Path(shutil.copy(each, folder)) for each in zips]


def generate(blender: str, folder: Path) -> Path:
    """Have Blender write the list of `folder`; returns it."""
    index = folder / "index.json"
    index.unlink(missing_ok=True)
    command = [blender, "--command", "extension", "server-generate", "--repo-dir", str(folder), "--html"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode or not index.is_file():
        said = (done.stdout + done.stderr).strip().splitlines()[-3:]
        raise RepositoryError(f"{blender} did not write {index}: {' '.join(said) or f'exit code {done.returncode}'}")
    return index


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blender", default="", help="Blender's program (default: blender on PATH)")
    parser.add_argument("--build", action="store_true", help="build the zips first, by scripts/package.py")
    parser.add_argument("--packages", type=Path, default=ROOT / "dist", help="folder of the zips (default: dist)")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "dist/repository", help="the repository (default: dist/repository)"
    )
    options = parser.parse_args()
    errors = RayBatchError, OSError, ValueError, KeyError
    return exit_code("repository.py", lambda: run(options), errors=errors)


def run(options: argparse.Namespace) -> int:
    """Make the repository that was asked for; the exit code."""
    blender = find_blender(options.blender)  # before the zips, which take minutes
    if options.build:
        build_packages(options.packages.absolute())
    zips = put_packages(options.packages.absolute(), options.out.absolute())
    index = generate(blender, options.out.absolute())
    listed = [each.get("archive_url", "") for each in json.loads(index.read_text(encoding="utf-8"))["data"]]
    if unlisted := [each.name for each in zips if f"./{each.name}" not in listed]:
        raise RepositoryError(f"Blender left {', '.join(unlisted)} out of {index}")
    print(index)
    return 0


if __name__ == "__main__":
    sys.exit(main())
