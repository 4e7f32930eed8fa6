"""The version of RayBatch, which stands in the extension's manifest and nowhere else."""

from __future__ import annotations

import importlib.metadata
import re
from pathlib import Path

# Beside the add-on's files where it is an extension, above them in the repository
_MANIFESTS = tuple(Path(__file__).parents[up] / "blender_manifest.toml" for up in (1, 2))
_UNKNOWN = "0.0.0"  # of a copy of the code that came without either


def _version() -> str:
    for path in _MANIFESTS:
        if path.is_file():
            said = re.search(r'^version = "([^"]+)"', path.read_text(encoding="utf-8"), re.MULTILINE)
            if said is not None:
                return said[1]
    try:
        return importlib.metadata.version("raybatch")  # installed by pip, without the manifest
    except importlib.metadata.PackageNotFoundError:
        return _UNKNOWN


VERSION = _version()
