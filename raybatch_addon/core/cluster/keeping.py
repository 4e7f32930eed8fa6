"""The samples of a cluster's render that have come: kept here, and in a checkpoint as those of any render."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..checkpoint.file import CheckpointError, KeptFilm, load_kept
from ..checkpoint.identity import FilmIdentity
from ..checkpoint.merging import joined, range_of, save_merged
from ..scene.description import Scene
from ..settings.settings import RenderSettings
from .connection import ClusterError


class ClusterKeeper:
    """The film of all samples from the first one on that are here."""

    def __init__(self, sample_first: int, path: Path | None = None, interval: float = 60.0):
        """`path`: the file that keeps it, written at most once in `interval` seconds."""
        self._first, self._path, self._interval = sample_first, path, interval
        self.film: KeptFilm | None = None
        self.shares: list[dict[str, Any]] = []  # who rendered which samples since
        self._device = ""  # whose bits they are
        self._due_at = time.monotonic() + interval
        self._writing: threading.Thread | None = None
        self.warnings: list[str] = []

    def begin(self, scene: Scene, settings: RenderSettings, report: Callable[[str], None]) -> None:
        """Go on with what the file has; raises `CheckpointError` where it is of another render."""
        if self._path is None or not self._path.exists():
            return
        kept = load_kept(self._path)
        own = FilmIdentity.of_device(scene, settings, kept.identity.device)
        if reason := own.why_not(kept.identity):
            raise CheckpointError(f"{self._path} cannot be gone on with: {reason}; name another checkpoint")
        if not kept.progress.is_between_rounds or kept.progress.sample_first != self._first:
            raise CheckpointError(
                f"{self._path} cannot be gone on with on a cluster: its pixels do not have the same samples, from "
                f"{self._first} on; go on with it without --cluster, or name another checkpoint"
            )
        if range_of(kept).end > self._first + settings.sample_count:
            raise CheckpointError(
                f"{self._path} has more samples than are asked for: set sample_count to {kept.progress.done} or more"
            )
        self.film, self._device = kept, kept.identity.device
        report(f"goes on from {self._path}: {kept.progress.done} of {settings.sample_count:,} samples are there")

    @property
    def end(self) -> int:
        """The first sample that is not here."""
        return self._first + (self.film.progress.done if self.film else 0)

    def check(self, share: dict[str, Any]) -> None:
        """Raise `ClusterError` for samples of an unlike device."""
        self._device = self._device or share["identity"]
        if share["identity"] != self._device:
            raise ClusterError(
                f"the cluster has unlike devices ({self._device}; {share['identity']}), whose bits differ; let workers "
                "of one model alone have the resource raybatch"
            )

    def is_due(self) -> bool:
        """Whether it is time to bring films here."""
        is_writing = self._writing is not None and self._writing.is_alive()
        return self._path is not None and not is_writing and time.monotonic() >= self._due_at

    def add(self, film: KeptFilm, shares: list[dict[str, Any]]) -> None:
        """The samples that follow have come."""
        self.film = film if self.film is None else joined(self.film, film)
        self.shares += shares
        self._due_at = time.monotonic() + self._interval
        if self._path is not None:
            self.wait()
            self._writing = threading.Thread(target=self._write, args=(self.film,))
            self._writing.start()

    def wait(self) -> None:
        """Until what is being written is there."""
        if self._writing is not None:
            self._writing.join()

    def _write(self, film: KeptFilm) -> None:
        assert self._path is not None  # or nobody writes
        try:
            save_merged(self._path, film)
        except CheckpointError as error:
            if str(error) not in self.warnings:
                self.warnings.append(str(error))
