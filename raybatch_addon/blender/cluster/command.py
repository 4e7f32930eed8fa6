"""The command line that renders a file on a cluster: render.py, run by a Python of its own, which has bpy and Dask."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from ...core.errors import RayBatchError

SCRIPT = "render.py"
WHERE = "Preferences > Add-ons > RayBatch"
# Pythons of an environment in a checkout, as `make environment` makes it
_ENVIRONMENT = (".venv/bin/python", ".venv/Scripts/python.exe")
_LOCAL = re.compile(r"local:0*([1-9]\d*)")
_ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://\S+|(?!local:\d)\S+:\d+")


def local_workers(text: str) -> int:
    """N of local:N, which is that many workers on this computer; 0 for anything else."""
    found = _LOCAL.fullmatch(text)
    return int(found[1]) if found else 0


def names_cluster(text: str) -> bool:
    """Whether `text` is the address of a scheduler, or local:N."""
    return bool(local_workers(text) or _ADDRESS.fullmatch(text))


class CommandError(RayBatchError):
    """Why a file cannot be rendered on a cluster, and what to do."""


@dataclass(frozen=True)
class Environment:
    """What renders, and where, as the preferences have it."""

    script: str  # render.py of a checkout
    python: str  # empty: that of the checkout's environment
    address: str  # of a scheduler, or local:N

    def command(self) -> list[str]:
        """The beginning of the command line; raises `CommandError`."""
        script = Path(self.script)
        if not self.script:
            raise CommandError(
                f"no command line is chosen that renders on a cluster: choose scripts/{SCRIPT} of RayBatch's folder "
                f"in {WHERE}"
            )
        if script.is_dir():  # the checkout, or its scripts
            script = next((each for each in (script / "scripts" / SCRIPT, script / SCRIPT) if each.is_file()), script)
        if script.name != SCRIPT or not script.is_file():
            raise CommandError(f"{script} is no {SCRIPT}: choose scripts/{SCRIPT} of RayBatch's folder in {WHERE}")
        return [str(self._python(script)), str(script)]

    def where(self) -> list[str]:
        """The options that say where to render; raises `CommandError`."""
        address = self.address.strip()
        if not address:
            raise CommandError(
                f"no cluster is named: write the address of its scheduler, as tcp://host:8786, or local:2 for two "
                f"workers on this computer, in {WHERE}"
            )
        if not names_cluster(address):
            raise CommandError(
                f"“{address}” names no cluster: write the address of its scheduler, as tcp://host:8786, or local:2 "
                f"for two workers on this computer, in {WHERE}"
            )
        return ["--cluster", address]

    def _python(self, script: Path) -> Path:
        if self.python:
            if not Path(self.python).is_file():
                raise CommandError(f"there is no Python {self.python}: choose one that has bpy and Dask in {WHERE}")
            return Path(self.python)
        there = [script.parents[1] / each for each in _ENVIRONMENT]
        found = next((each for each in there if each.is_file()), None)
        if found is None:
            raise CommandError(
                f"{script.parents[1]} has no environment .venv: make it with `make environment`, or choose a Python "
                f"that has bpy and Dask in {WHERE}"
            )
        return found


def own_variables() -> dict[str, str]:
    """The environment of the process: this one's, but for what is meant for Blender's own Python."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONPATH")}
