"""Build the Blender extension, one zip a platform: python scripts/package.py [--platform linux-x64]

The add-on and its manifest are staged together, with Warp's wheel for the platform, and packed by Blender's own extension
builder, which checks the manifest. Wheels are downloaded once and kept in the user's cache folder. Standard output lists
the zips, one a line. Exit codes: 0; 1 for what is wrong with the project or its environment; 3 when a wheel cannot be downloaded.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSION_FILE = "raybatch_addon/core/report/statistics.py"
EXIT_FAILED, EXIT_NO_WHEEL = 1, 3

# Tags of the wheels, newest system first, that the oldest system can load on which Blender itself runs
WHEEL_TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64",),
}


class PackageError(Exception):
    """What keeps the extension from being built, as one line."""

    def __init__(self, message: str, exit_code: int = EXIT_FAILED) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def project_version(root: Path = ROOT) -> str:
    """The version that the manifest, pyproject.toml and the statistics agree on; raises `PackageError` when they do not."""
    said = re.search(r'^VERSION = "([^"]+)"', (root / VERSION_FILE).read_text(encoding="utf-8"), re.MULTILINE)
    versions = {
        "blender_manifest.toml": tomllib.loads((root / "blender_manifest.toml").read_text(encoding="utf-8"))["version"],
        "pyproject.toml": _project(root)["version"],
        VERSION_FILE: said[1] if said else "none",
    }
    if len(set(versions.values())) > 1:
        raise PackageError("the versions differ: " + ", ".join(f"{name} says {version}" for name, version in versions.items()))
    return versions["blender_manifest.toml"]


def warp_requirement(root: Path = ROOT) -> tuple[str, str]:
    """What to ask pip for, and the version: the tested range of pyproject.toml, and in it the version that is installed here."""
    pin = next(line for line in _project(root)["dependencies"] if line.startswith("warp-lang"))
    try:
        version = importlib.metadata.version("warp-lang")
    except importlib.metadata.PackageNotFoundError:
        raise PackageError("Warp is not installed in this Python: use the one of .venv, which `make environment` fills") from None
    return f"{pin},=={version}", version


def _project(root: Path) -> dict:
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def extension_builder() -> Path:
    """Blender's extension builder, from the bpy of this Python."""
    spec = importlib.util.find_spec("bpy")
    folders = spec.submodule_search_locations or [] if spec else []
    for folder in folders:
        for path in sorted(Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")):
            return path
    raise PackageError("Blender's extension builder was not found: bpy is not installed in this Python; use the one of .venv")


def wheel_cache() -> Path:
    """The folder where downloaded wheels are kept, in the user's cache folder."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "raybatch" / "wheels"


def warp_wheel(platform: str) -> Path:
    """Warp's wheel for `platform`, downloaded unless it is in the cache; raises `PackageError`.

    It must suit every Python 3: Blender 4.5 and 5.2 bring different ones.
    """
    requirement, version = warp_requirement()
    cache = wheel_cache()
    for tag in WHEEL_TAGS[platform]:
        for wheel in cache.glob(f"warp_lang-{version}-py3-none-*{tag}.whl"):
            return wheel
    print(f"RayBatch: downloading Warp {version} for {platform} (once; it is kept in {cache})", file=sys.stderr)
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache) as folder:  # nothing half-written gets into the cache
        tags = [word for tag in WHEEL_TAGS[platform] for word in ("--platform", tag)]
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-input", "--no-deps"]
        done = subprocess.run([*pip, "--only-binary=:all:", *tags, "--dest", folder, requirement], capture_output=True, text=True)
        wheels = list(Path(folder).glob("*.whl"))
        if done.returncode or not wheels:
            said = [line for line in (done.stderr + done.stdout).splitlines() if "ERROR" in line]
            raise PackageError(f"Warp's wheel for {platform} could not be downloaded: {' '.join(said) or 'pip does not say why'}", EXIT_NO_WHEEL)
        if "-py3-none-" not in wheels[0].name:
            raise PackageError(f"{wheels[0].name} does not suit every Python 3, as Blender 4.5 and 5.2 need")
        return wheels[0].replace(cache / wheels[0].name)


def stage(folder: Path, wheels: dict[str, Path]) -> None:
    """Fill `folder` with what goes into the zips of the platforms of `wheels`."""
    shutil.copytree(ROOT / "raybatch_addon", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__", "*.pyc"))
    shutil.copy2(ROOT / "LICENSE", folder)
    (folder / "wheels").mkdir()
    for wheel in wheels.values():
        shutil.copy2(wheel, folder / "wheels")
    names = ", ".join(f'"./wheels/{wheel.name}"' for wheel in wheels.values())
    platforms = ", ".join(f'"{platform}"' for platform in wheels)
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    added = f"platforms = [{platforms}]\nwheels = [{names}]\n"  # first, because what follows a table's name belongs to it
    (folder / "blender_manifest.toml").write_text(added + manifest, encoding="utf-8")


def build(platforms: list[str], output: Path) -> list[Path]:
    """Build the zips of `platforms` in the folder `output`; raises `PackageError`."""
    version = project_version()
    builder = extension_builder()
    wheels = {platform: warp_wheel(platform) for platform in platforms}
    output.mkdir(parents=True, exist_ok=True)
    zips = [output / f"raybatch-{version}-{platform.replace('-', '_')}.zip" for platform in platforms]
    with tempfile.TemporaryDirectory(prefix="raybatch-") as folder:
        source, packed = Path(folder) / "source", Path(folder) / "packed"
        packed.mkdir()
        stage(source, wheels)
        command = [sys.executable, str(builder), "build", "--split-platforms", "--source-dir", str(source), "--output-dir", str(packed)]
        done = subprocess.run(command, capture_output=True, text=True)
        missing = [path.name for path in zips if not (packed / path.name).is_file()]
        if done.returncode or missing:
            raise PackageError("Blender's extension builder failed: " + (" ".join((done.stdout + done.stderr).split()) or f"no {missing[0]}"))
        for path in zips:
            shutil.move(packed / path.name, path)
    return zips


def main() -> int:
    parser = argparse.ArgumentParser(description="Build the Blender extension, one zip a platform.")
    parser.add_argument("--platform", choices=sorted(WHEEL_TAGS), action="append", help="build for this platform only; may be repeated (default: all)")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", metavar="FOLDER", help="where the zips go (default: dist/)")
    arguments = parser.parse_args()
    try:
        zips = build(arguments.platform or list(WHEEL_TAGS), arguments.output)
    except PackageError as error:
        print(f"RayBatch: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"RayBatch: the extension could not be built: {error}", file=sys.stderr)
        return EXIT_FAILED
    for path in zips:
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
