#!/usr/bin/env python3
"""Build the site of the documents: python scripts/docs_site/build.py [FOLDER] (default build/docs/site; `make docs`).

Sphinx and its theme, the list `docs` of pyproject.toml, are installed into this Python's environment where they are not
there; after that nothing is fetched. A link or a picture that leads nowhere is an error: the exit code is 1 then.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.command import exit_code

from docs_site.checking import faults
from docs_site.staging import stage
from raybatch_addon.core.errors import RayBatchError

CONFIGURATION = ROOT / "scripts/docs_site"
INVENTORY = "objects.inv"  # of a site that Sphinx built


class SiteError(RayBatchError):
    """Why there is no site, in one line."""


def wanted() -> list[str]:
    """What the site is made with, as pyproject.toml says it: NAME==VERSION."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project["optional-dependencies"]["docs"]


def missing(requirements: list[str]) -> list[str]:
    """The `requirements` that are not installed here, or in another version."""

    def is_there(requirement: str) -> bool:
        name, _, version = requirement.partition("==")
        try:
            return importlib.metadata.version(name) == version
        except importlib.metadata.PackageNotFoundError:
            return False

    return [each for each in requirements if not is_there(each)]


def install(requirements: list[str]) -> int:
    """Exit code of pip."""
    print(f"RayBatch: installing {', '.join(requirements)}", file=sys.stderr)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
    return subprocess.call([*pip, *requirements], stdin=subprocess.DEVNULL, stdout=sys.stderr)


def build(sources: Path, site: Path) -> int:
    """Exit code of Sphinx, for which a warning is an error. A site of before goes, so that no page of it stays."""
    if (site / INVENTORY).is_file():
        shutil.rmtree(site)
    options = ["--builder", "html", "--fail-on-warning", "--keep-going", "--fresh-env", "--quiet"]
    command = [sys.executable, "-m", "sphinx", *options, "--conf-dir", str(CONFIGURATION), str(sources), str(site)]
    return subprocess.call(command, stdin=subprocess.DEVNULL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build/docs/site", metavar="FOLDER")
    site = parser.parse_args().folder.absolute()
    return exit_code("docs", lambda: run(site), errors=(SiteError, OSError, ValueError))


def run(site: Path) -> int:
    """Build the site and check it; the exit code."""
    if (needed := missing(wanted())) and install(needed):
        raise SiteError("the tools could not be installed (see above); run it again with a network")
    sources = ROOT / "build/docs/source"
    stage(sources)
    if build(sources, site):
        raise SiteError("the site was not built (see above)")
    found = faults(site)
    for fault in found:
        print(f"docs: error: {fault}", file=sys.stderr)
    if not found:
        print(f"The site is in {site}; open {site / 'index.html'}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
