"""Records of files in a folder, each written whole as soon as it is there: a comparison that was stopped goes on."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lib.output import OutputError, json_text, write_text, write_whole

from real_files.code import code_of
from real_files.listing import RealFile
from real_files.measures import Pair
from real_files.process import DONE, ProcessOutcome
from real_files.worker import PICTURES, SEEDS, SOURCES

ENGINES = ("CYCLES", "RAYBATCH")


@dataclass
class Record:
    """The record of a file: of each engine its pictures, and those of its sources of light."""

    name: str
    about: dict[str, Any] = field(default_factory=dict)  # what the list says
    request: dict[str, Any] = field(default_factory=dict)  # width, samples and others; another one begins anew
    md5: str = ""
    complaint: str = ""  # why no process was started
    tasks: dict[str, dict[str, Any]] = field(default_factory=dict)  # `ProcessOutcome.data` by engine/kind
    pictures: dict[str, np.ndarray] = field(default_factory=dict)  # float32 [height, width, 4], by engine/step

    def is_done(self, engine: str, kind: str) -> bool:
        """Whether it was rendered, by whatever code."""
        return self.tasks.get(f"{engine}/{kind}", {}).get("status") == DONE

    def is_old(self, engine: str, kind: str) -> bool:
        """Whether it was rendered by other code than this."""
        return self.is_done(engine, kind) and self.code(engine, kind) != code_of(engine)

    def has_old(self) -> bool:
        """Whether anything was rendered by other code than this."""
        return any(self.is_old(*key.split("/")) for key in self.tasks)

    def code(self, engine: str, kind: str) -> dict[str, str] | None:
        """What it was rendered by, as `code_of`; None where that was not written down."""
        return self.tasks.get(f"{engine}/{kind}", {}).get("code")

    def take(self, engine: str, kind: str, outcome: ProcessOutcome) -> None:
        """Keep what came of a process of this code, in place of what there was."""
        self.tasks[f"{engine}/{kind}"] = {**outcome.data(), "code": code_of(engine)}
        begun = f"{engine}/source-"
        for key in [
            key for key in self.pictures if key.startswith(f"{engine}/") and key.startswith(begun) == (kind == SOURCES)
        ]:
            del self.pictures[key]
        self.pictures |= {f"{engine}/{name}": pixels for name, pixels in outcome.pictures.items()}

    def pair(self, engine: str, names: tuple[str, str] = ("all-1", "all-2")) -> Pair | None:
        """Two pictures of `engine`, in colours; None if one is not there."""
        first, second = (self.pictures.get(f"{engine}/{name}") for name in names)
        return None if first is None or second is None else Pair(_in_colors(first), _in_colors(second))

    def sources(self, engine: str) -> dict[str, Pair]:
        """Pictures of each source alone; none if they were not made."""
        names = self.tasks.get(f"{engine}/{SOURCES}", {}).get("sources", [])
        pairs = {}
        for number, name in enumerate(names):
            pair = self.pair(engine, (f"source-{number}-{SEEDS[0]}", f"source-{number}-{SEEDS[1]}"))
            if pair is None:
                return {}
            pairs[name] = pair
        return pairs

    def seconds(self, engine: str) -> dict[str, float]:
        """Seconds by step."""
        steps = self.tasks.get(f"{engine}/{PICTURES}", {}).get("steps", [])
        return {each["name"]: each["seconds"] for each in steps}


def _in_colors(pixels: np.ndarray) -> np.ndarray:
    return np.nan_to_num(pixels[..., :3].astype(np.float64), posinf=0.0, neginf=0.0)


class Records:
    """All records of a folder."""

    def __init__(self, folder: Path):
        self.folder = folder / "files"

    def prepare(self) -> None:
        """Make the folder; raises `OutputError`."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self.folder} cannot be made: {error.strerror or error}") from None

    def read(self, file: RealFile, request: dict[str, Any], md5: str) -> Record:
        """The record of `file`, or an empty one where there is none of this request and this version of the file."""
        new = Record(file.name, file.about, request, md5)
        found = self._load(self.folder / f"{file.slug}.json")
        if found is None or found.request != request or found.md5 != md5:
            return new
        found.about, found.complaint = file.about, ""
        return found

    def all(self) -> list[Record]:
        """Every record, by name."""
        found = [self._load(path) for path in sorted(self.folder.glob("*.json"))]
        return sorted((each for each in found if each is not None), key=lambda record: record.name.lower())

    def write(self, file: RealFile, record: Record) -> None:
        """Put `record` in its place."""
        path = self.folder / f"{file.slug}.json"

        pictures: dict[str, Any] = dict(record.pictures)

        def write_pictures(temporary: Path) -> None:
            with open(temporary, "wb") as opened:
                np.savez_compressed(opened, **pictures)

        write_whole(path.with_suffix(".npz"), write_pictures)
        kept = {name: value for name, value in vars(record).items() if name != "pictures"}
        write_text(path, json_text(kept) + "\n")

    def _load(self, path: Path) -> Record | None:
        """None for what is not there, or cannot be read: it is rendered anew."""
        try:
            record = Record(**json.loads(path.read_text(encoding="utf-8")))
            with np.load(path.with_suffix(".npz")) as stored:
                record.pictures = {name: stored[name] for name in stored.files}
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return record
