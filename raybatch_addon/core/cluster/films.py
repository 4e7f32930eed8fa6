"""Films as they travel between processes: plain text and arrays, and a digest of both."""

from __future__ import annotations

import json
from typing import Any

from ..checkpoint.file import CheckpointError, KeptFilm
from ..checkpoint.identity import FilmIdentity
from ..checkpoint.merging import joined
from ..checkpoint.progress import KeptProgress
from ..checkpoint.samples import TileSamples, samples_as_arrays, samples_of_arrays
from ..device.bulk import digest_of
from ..errors import RayBatchError
from ..film import Film
from ..wavefront.render.rounds import RoundPolicy

# A film that travels: `header` (JSON), `halves` (arrays by name, of each half) and `digest`
Sent = dict[str, Any]


class DamagedFilm(RayBatchError):
    """A film that is not what was sent: the samples have to be rendered again."""


def kept_of(film: Film, identity: FilmIdentity, sample_first: int, sample_order: str) -> KeptFilm:
    """The complete `film` of samples from `sample_first` on, as checkpoints have films."""
    count = identity.settings["sample_count"]
    halves = film.halves or (film,)
    progress = KeptProgress(
        tiles=(identity.part.rectangle,),
        items_begun=((0,) * len(halves),),
        sample_first=sample_first,
        sample_order=sample_order,
        done=count,
        end=None,
        policy=RoundPolicy(count).record(),
        invalid_samples=film.statistics["invalid_samples"],
        threshold=0.0,
        looks=(),
        stopped=None,
    )
    return KeptFilm(identity, progress, tuple(half.fetched() for half in halves))


def packed(film: KeptFilm) -> list[dict[str, Any]]:
    """The arrays of `film`, by name, of each half."""
    part = film.identity.part
    return [samples_as_arrays(part, [TileSamples(part.rectangle, samples)]) for samples in film.halves]


def sent_film(film: KeptFilm, shares: list[dict[str, Any]], halves: list[dict[str, Any]] | None = None) -> Sent:
    """`film` as it travels; `shares` say who rendered which samples, and `halves` are its arrays if they are there."""
    progress, _ = film.progress.record()
    header = json.dumps({"film": film.identity.record(), "progress": progress, "shares": shares})
    halves = packed(film) if halves is None else halves
    return {"header": header, "halves": halves, "digest": _digest(header, halves)}


def received_film(sent: Sent) -> tuple[KeptFilm, list[dict[str, Any]]]:
    """The inverse of `sent_film`; raises `DamagedFilm`."""
    header = _header(sent)
    try:
        identity = FilmIdentity.of_record(header["film"])
        progress = KeptProgress.of_record(header["progress"], {}, identity.part)
        halves = tuple(samples_of_arrays(identity.part, arrays) for arrays in sent["halves"])
        return KeptFilm(identity, progress, halves), header["shares"]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise DamagedFilm(f"a film that was sent is none: {error}") from error


def merged(first: Sent, second: Sent) -> Sent:
    """The film of both, of which `second` has the samples that follow; raises `DamagedFilm`, and `CheckpointError`
    where they are of unlike devices or versions.
    """
    (film, shares), (other, others) = received_film(first), received_film(second)
    if reason := film.identity.why_not(other.identity):
        raise CheckpointError(f"films of two workers cannot be merged: {reason}")
    return sent_film(joined(film, other), shares + others)


def sent_shares(sent: Sent) -> list[dict[str, Any]]:
    """Who rendered which of its samples; raises `DamagedFilm`."""
    return _header(sent)["shares"]


def _header(sent: Sent) -> dict[str, Any]:
    """What is said of a film, if that and its arrays are what was sent; raises `DamagedFilm`."""
    try:
        if _digest(sent["header"], sent["halves"]) != sent["digest"]:
            raise DamagedFilm("a film was damaged on its way")
        return json.loads(sent["header"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamagedFilm(f"a film that was sent is none: {error}") from error


def _digest(header: str, halves: list[dict[str, Any]]) -> str:
    arrays = [arrays[name] for arrays in halves for name in sorted(arrays)]
    return digest_of(arrays, header).hex()
