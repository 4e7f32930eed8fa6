"""Checkpoints of ranges of samples, rendered apart, as the checkpoint of one render of all of them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path

from ..film.host_samples import HostSamples
from ..wavefront.render.rounds import Round, RoundPolicy
from .file import CheckpointError, KeptFilm, load_kept, write_kept
from .samples import TileSamples, samples_as_arrays

# Settings with which a range of samples depends on those before it
_WHOLE = {"adaptive_sampling": "OFF", "error_target": 0.0}


def merged_films(paths: Sequence[str | Path]) -> KeptFilm:
    """The film of all samples of the checkpoints in `paths`, bit for bit that of one render.

    Raises `CheckpointError` where they are not of one film, or where their samples do not adjoin.
    """
    if len(paths) < 2:
        raise CheckpointError("there is nothing to merge: name two checkpoints or more")
    films = [(Path(path), load_kept(Path(path))) for path in paths]
    for path, film in films:
        _check(path, film)
        if reason := films[0][1].identity.why_not(film.identity):
            raise CheckpointError(f"{path} cannot be merged with {films[0][0]}: {reason}")
    films.sort(key=lambda each: range_of(each[1]).first)
    for (before, first), (path, film) in itertools.pairwise(films):
        end, begin, last = range_of(first).end, range_of(film).first, range_of(film).end - 1
        if begin < end:
            raise CheckpointError(
                f"{before} and {path} cannot be merged: both have samples {begin} to {min(end - 1, last)}, "
                "which would count twice; leave one out"
            )
        if begin > end:
            raise CheckpointError(
                f"{before} and {path} cannot be merged: samples {end} to {begin - 1} are in neither; render them with "
                f"--sample-first {end} --set sample_count={begin - end}, and name that checkpoint too"
            )
    return functools.reduce(joined, (film for _, film in films))


def range_of(film: KeptFilm) -> Round:
    """Which samples every pixel has."""
    first = film.progress.sample_first
    return Round(first, first + film.progress.done)


def save_merged(path: str | Path, film: KeptFilm) -> None:
    """Write `film` to `path`, whole or not at all; raises `CheckpointError`."""
    part = film.identity.part
    arrays = (samples_as_arrays(part, [TileSamples(part.rectangle, samples)]) for samples in film.halves)
    try:
        write_kept(Path(path), film.identity, film.progress, arrays)
    except OSError as error:
        raise CheckpointError(f"{path} cannot be written: {error.strerror or error}") from error


def _check(path: Path, film: KeptFilm) -> None:
    for name, off in _WHOLE.items():
        if film.identity.settings[name] != off:
            raise CheckpointError(
                f"{path} cannot be merged: it was rendered with {name} = {film.identity.settings[name]}, with which "
                "samples depend on all before them; render it in one piece"
            )
    if not film.progress.is_between_rounds:
        raise CheckpointError(
            f"{path} cannot be merged: its pixels do not have the same samples yet; go on with its render first, to "
            f"the end of its {film.identity.settings['sample_count']} samples"
        )


def joined(first: KeptFilm, second: KeptFilm) -> KeptFilm:
    """The film of both, of which `second` has the samples that follow."""
    count = first.progress.done + second.progress.done
    settings = {**first.identity.settings, "sample_count": count}
    progress = dataclasses.replace(
        first.progress,
        items_begun=tuple(tuple(0 for _ in halves) for halves in first.progress.items_begun),
        done=count,
        end=None,
        policy=RoundPolicy(count).record(),
        invalid_samples=first.progress.invalid_samples + second.progress.invalid_samples,
    )
    halves: tuple[HostSamples, ...] = tuple(a.add(b) for a, b in zip(first.halves, second.halves, strict=True))
    return KeptFilm(dataclasses.replace(first.identity, settings=settings), progress, halves)
