"""The samples of a cluster's render that have come: kept here, and in a checkpoint as those of any render."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..checkpoint.checkpoint import why_not_gone_on
from ..checkpoint.file import CheckpointError, KeptFilm, load_kept
from ..checkpoint.identity import FilmIdentity
from ..checkpoint.merging import joined, save_merged
from ..film import Film
from ..scene.description import Scene
from ..settings.settings import RenderSettings
from . import films
from .connection import ClusterError
from .rounds import ClusterRounds


@dataclasses.dataclass(frozen=True)
class Received:
    """The samples of films that came, beside those that were here."""

    kept: KeptFilm
    shares: list[dict[str, Any]]  # of the films that came
    rounds: ClusterRounds
    film: Film | None  # of all, where it was looked at


class ClusterKeeper:
    """The film of all samples from the first one on that are here."""

    def __init__(self, first: int, path: Path | None = None, interval: float = 60.0):
        """`first`: the first sample. `path`: the file that keeps it, written at most once in `interval` seconds."""
        self.first, self._path, self._interval = first, path, interval
        self.film: KeptFilm | None = None
        self.shares: list[dict[str, Any]] = []  # who rendered which samples since
        self._device = ""  # whose bits they are
        self._due_at = time.monotonic() + interval
        self._unwritten: KeptFilm | None = None  # as the file is to have it
        self._writing: threading.Thread | None = None
        self._finishing = threading.Lock()
        self.warnings: list[str] = []

    def begin(self, scene: Scene, settings: RenderSettings, report: Callable[[str], None]) -> None:
        """Go on with what the file has; raises `CheckpointError` where it is of another render."""
        if self._path is None or not self._path.exists():
            return
        kept = load_kept(self._path)
        own = FilmIdentity.of_device(scene, settings, kept.identity.device)
        if reason := why_not_gone_on(kept, own, self.first):
            raise CheckpointError(f"{self._path} cannot be gone on with: {reason}; name another checkpoint")
        if not kept.progress.is_between_rounds:
            raise CheckpointError(
                f"{self._path} cannot be gone on with on a cluster: its pixels do not have the same samples; go on "
                "with it without --cluster, or name another checkpoint"
            )
        self.film, self._device = kept, kept.identity.device
        report(f"goes on from {self._path}: {kept.progress.done} of {settings.sample_count:,} samples are there")

    @property
    def end(self) -> int:
        """The first sample that is not here."""
        return self.first + (self.film.progress.done if self.film else 0)

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
        return self._path is not None and not self._is_writing and time.monotonic() >= self._due_at

    @property
    def _is_writing(self) -> bool:
        return self._writing is not None and self._writing.is_alive()

    def received(self, film: KeptFilm, shares: list[dict[str, Any]], rounds: ClusterRounds) -> Received:
        """What is here with the samples of `film`, which follow, and what comes next where `rounds`'s round ends. This
        one stays as it is.
        """
        kept = film if self.film is None else joined(self.film, film)
        if self.first + kept.progress.done < rounds.end:
            return Received(kept, shares, rounds, None)
        return Received(kept, shares, *rounds.after(kept))

    def keep(self, film: KeptFilm, shares: list[dict[str, Any]], rounds: ClusterRounds) -> None:
        """`film` is what is here from now on; `shares` of what is new in it, `rounds` what was decided by it. The file
        has it at the end of the render, or where it is time, written meanwhile.
        """
        self.film = film
        self.shares += shares
        if self._path is None:
            return
        settings = film.identity.settings
        if rounds.policy.error_target:  # by which a film that has all samples is told from others
            settings = {**settings, "sample_count": rounds.policy.sample_count}
        identity = dataclasses.replace(film.identity, settings=settings)
        self._unwritten = dataclasses.replace(film, identity=identity, progress=rounds.progress(film.progress))
        if rounds.is_over or time.monotonic() >= self._due_at:
            self._begin_writing()

    def finish(self) -> None:
        """Have all that is here in the file. Waits; any thread may, once nothing comes any more."""
        with self._finishing:
            self._begin_writing()
            while self._writing is not None:
                self._writing.join()
                self._writing = None
                self._begin_writing()

    def _begin_writing(self) -> None:
        """Unless another film is being written: then that which is not comes with the next one."""
        if self._unwritten is not None and not self._is_writing:
            film, self._unwritten = self._unwritten, None
            self._due_at = time.monotonic() + self._interval
            self._writing = threading.Thread(target=self._write, args=(film,))
            self._writing.start()

    def _write(self, film: KeptFilm) -> None:
        assert self._path is not None  # or nobody writes
        try:
            save_merged(self._path, film)
        except CheckpointError as error:
            if str(error) not in self.warnings:
                self.warnings.append(str(error))


def sound(sent: dict[str, Any]) -> dict[str, Any]:
    """What was sent, if it is no error; raises `ClusterError`, or `DamagedFilm`."""
    if sent.get("error") == films.DamagedFilm.__name__:
        raise films.DamagedFilm(sent["text"])
    if "error" in sent:
        raise ClusterError(sent["text"])
    return sent
