"""How long each file of tests takes, so that long ones begin first and short ones can be run alone.

The seconds are those of one process with an empty kernel cache. They need not be right, only in proportion.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path

STORED = Path(__file__).with_suffix(".json")
UNKNOWN = 10.0  # seconds of a file that was never timed


@functools.cache
def stored_seconds() -> dict[str, float]:
    """Seconds by name of the file."""
    return json.loads(STORED.read_text(encoding="utf-8"))


def file_seconds(path: Path | str) -> float:
    """Seconds of a file of tests, by its name: files may move to another folder."""
    return stored_seconds().get(Path(path).name, UNKNOWN)


def store(seconds: dict[str, float]) -> None:
    """Write `seconds`, by name of the file, over those that are stored; files that are there no more are left out."""
    names = {path.name for path in Path(__file__).parents[2].rglob("test_*.py")}
    merged = {name: round(value, 1) for name, value in (stored_seconds() | seconds).items() if name in names}
    lines = [f'"{name}": {merged[name]}' for name in sorted(merged)]
    STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
