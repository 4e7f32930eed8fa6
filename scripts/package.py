#!/usr/bin/env python3
"""Build the Blender extension: one zip a platform, with the Warp wheel inside, through Blender's own extension builder.

`package.py` builds all platforms into dist/; `package.py linux-x64` only that one. Wheels are downloaded with pip
and kept in build/wheels. The zip for linux-x64 has compiled kernels in it if it is built on such a machine: about four
minutes for processors and four for each architecture of CUDA the first time, and kept in build/kernels; on other
machines, and in other zips, there are none, and they are compiled when the extension is enabled. Exit codes: 0; 3 when
a wheel could not be downloaded; 1 for anything else.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.command import RefusedError, exit_code

from raybatch_addon.core.errors import RayBatchError

MANIFEST = "blender_manifest.toml"
# the name of pip's platform, by Blender's. Warp's wheels are the same for every Python 3.
PIP_PLATFORMS = {"linux-x64": "manylinux_2_28_x86_64", "windows-x64": "win_amd64", "macos-arm64": "macosx_11_0_arm64"}


class PackageError(RayBatchError):
    """Why there is no package, in one line."""


class DownloadError(PackageError, RefusedError):
    """Why a wheel could not be had."""


def project_version() -> str:
    """The version, which stands in the manifest alone; raises `PackageError` where it does not."""
    version = tomllib.loads((ROOT / MANIFEST).read_text(encoding="utf-8")).get("version")
    if version is None:
        raise PackageError(f"{MANIFEST} says no version")
    return version


def warp_requirement() -> tuple[str, str]:
    """What to ask pip for, and the version in it: the one that is installed here, in the tested range of
    pyproject.toml.
    """
    tested = next(line for line in _project()["dependencies"] if line.startswith("warp-lang"))
    try:
        version = importlib.metadata.version("warp-lang")
    except importlib.metadata.PackageNotFoundError:
        raise PackageError(
            "Warp is not installed here: run this with the environment that `make environment` makes"
        ) from None
    return f"{tested},=={version}", version


def _project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def fetch_wheel(platform: str, folder: Path) -> Path:
    """The Warp wheel of `platform`, in `folder`; downloaded unless the version that is installed here is there
    already.
    """
    requirement, version = warp_requirement()
    folder = folder / platform
    for wheel in folder.glob(f"warp_lang-{version}-py3-none-*.whl"):
        return wheel
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        dir=folder, prefix="download-"
    ) as temporary:  # what is half there is never taken for a wheel
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--no-deps",
            "--only-binary=:all:",
            "--no-input",
            "--disable-pip-version-check",
            "--platform",
            PIP_PLATFORMS[platform],
            "--implementation",
            "py",
            "--abi",
            "none",
            "--dest",
            temporary,
            requirement,
        ]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        wheels = list(Path(temporary).glob("warp_lang-*.whl"))
        if done.returncode or len(wheels) != 1:
            lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or ["pip found none"]
            raise DownloadError(f"the Warp wheel for {platform} could not be downloaded: {lines[-1]}")
        return wheels[0].rename(folder / wheels[0].name)


def builder() -> Path:
    """Blender's own extension builder, a script that comes with bpy."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        raise PackageError(
            "Blender's module bpy is not installed here: run this with the environment that `make environment` makes"
        )
    found = list(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        raise PackageError("bpy has no extension builder (addons_core/bl_pkg/cli/blender_ext.py)")
    return found[0]


def stage(folder: Path, platform: str, wheel: Path) -> None:
    """Lay out the extension in `folder`: the add-on's files, the manifest with its wheel and platform, and the
    licence.
    """
    shutil.copytree(ROOT / "raybatch_addon", folder, ignore=shutil.ignore_patterns("__pycache__", "*.pyc"))
    shutil.copy(ROOT / "LICENSE", folder)
    (folder / "wheels").mkdir()
    try:
        (folder / "wheels" / wheel.name).hardlink_to(wheel)
    except OSError:
        shutil.copy(wheel, folder / "wheels")
    text = (ROOT / MANIFEST).read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith(("platforms", "# `wheels`"))]
    # top-level keys must come before the first table
    first_table = next(i for i, line in enumerate(kept) if line.startswith("["))
    kept[first_table:first_table] = [f'platforms = ["{platform}"]', f'wheels = ["./wheels/{wheel.name}"]', ""]
    (folder / MANIFEST).write_text("\n".join(kept) + "\n", encoding="utf-8")


def add_kernels(folder: Path, platform: str, kept: Path, targets: str) -> None:
    """Put kernels compiled for `targets` into the laid out extension; what was compiled before is in `kept`."""
    try:
        from lib.shipped_kernels import TARGETS, can_be_made, make_kernels

        from raybatch_addon.core.device.kernel import OPTIMISATION
    except ImportError as error:
        raise PackageError(
            f"kernels cannot be compiled ({error}): run this with the environment that `make environment` makes, or "
            "with --no-kernels"
        ) from None
    if not can_be_made(platform):
        print(f"{platform}: without compiled kernels", file=sys.stderr)
        return
    chosen = targets.split(",") if targets else list(TARGETS)
    if os.environ.get(OPTIMISATION):
        raise PackageError(f"{OPTIMISATION} is set: users would not find kernels that are optimised so; unset it")
    if unknown := set(chosen) - set(TARGETS):
        raise PackageError(f"unknown target {', '.join(sorted(unknown))}; choose from {', '.join(TARGETS)}")
    try:
        make_kernels(
            folder / "kernels", kept, targets=chosen, on_progress=lambda line: print(line, file=sys.stderr, flush=True)
        )
    except Exception as error:  # Warp raises whatever it likes
        raise PackageError(f"kernels could not be compiled: {type(error).__name__}: {error}") from error


def build(platform: str, out: Path, wheels: Path, kernels: Path | None = None, targets: str = "") -> Path:
    """The zip of `platform`, in the folder `out`; raises `PackageError`.

    `kernels`: where compiled kernels are kept between builds; None for a zip without any. `targets`: what they are
    compiled for, with commas; everything if it is empty.
    """
    version = project_version()
    wheel = fetch_wheel(platform, wheels)
    target = out / f"raybatch-{version}-{platform.replace('-', '_')}.zip"
    out.mkdir(parents=True, exist_ok=True)
    wheels.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=wheels.parent, prefix="stage-") as temporary:
        source = Path(temporary) / "raybatch"
        stage(source, platform, wheel)
        if kernels:
            add_kernels(source, platform, kernels, targets)
        half = Path(temporary) / target.name
        for command in (
            ["build", "--source-dir", str(source), "--output-filepath", str(half)],
            ["validate", str(half)],
        ):
            done = subprocess.run(
                [sys.executable, str(builder()), *command], stdin=subprocess.DEVNULL, capture_output=True, text=True
            )
            if done.returncode:
                raise PackageError(
                    f"Blender's extension builder refused {platform}: {' '.join((done.stdout + done.stderr).split())}"
                )
        shutil.move(half, target)  # may be another file system
    return target


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "platforms", nargs="*", metavar="PLATFORM", help=f"which to build: {', '.join(PIP_PLATFORMS)} (default: all)"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zips (default: dist)")
    parser.add_argument(
        "--wheels",
        type=Path,
        default=ROOT / "build" / "wheels",
        help="folder where wheels are kept (default: build/wheels)",
    )
    parser.add_argument(
        "--kernels",
        type=Path,
        default=ROOT / "build" / "kernels",
        help="folder where compiled kernels are kept (default: build/kernels)",
    )
    parser.add_argument(
        "--targets",
        default="",
        metavar="TARGET[,TARGET]",
        help="compile kernels for these levels of x86-64 and architectures of CUDA alone (default: all)",
    )
    parser.add_argument("--no-kernels", action="store_true", help="leave compiled kernels out of all zips")
    options = parser.parse_args()
    if unknown := set(options.platforms) - set(PIP_PLATFORMS):
        parser.error(f"unknown platform {', '.join(sorted(unknown))}; choose from {', '.join(PIP_PLATFORMS)}")
    return exit_code("package.py", lambda: run(options), errors=(PackageError, OSError))


def run(options: argparse.Namespace) -> int:
    """Build what was asked for; the exit code."""
    for platform in options.platforms or PIP_PLATFORMS:
        kernels = None if options.no_kernels else options.kernels.absolute()
        print(build(platform, options.out.absolute(), options.wheels.absolute(), kernels, options.targets), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
