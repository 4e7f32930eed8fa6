"""The file of a checkpoint: a NumPy archive (.npz, no pickled objects) with a header of JSON, written whole or not at
all. docs/checkpoints.md describes it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import RayBatchError
from ..files import whole_file
from ..film import Film
from ..film.host_samples import HostSamples
from .identity import FilmIdentity
from .progress import KeptProgress
from .samples import samples_of_arrays

FORMAT = "raybatch-checkpoint"
VERSION = 1
_HEADER = "header.json"
# Level of zlib: sums are numbers that look random beside zeros, and higher levels find little more in them
_COMPRESSION = 1
# What reading a file of another kind, or a damaged one, may raise
_DAMAGE = (
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    OverflowError,
    MemoryError,
    RuntimeError,
    RecursionError,
    zipfile.BadZipFile,
    zlib.error,
)


class CheckpointError(RayBatchError):
    """A checkpoint that cannot be read, written, gone on with or merged."""


@dataclass(frozen=True)
class KeptFilm:
    """The content of a checkpoint."""

    identity: FilmIdentity
    progress: KeptProgress
    halves: tuple[HostSamples, ...]  # one, or those of both halves

    def film(self) -> Film:
        """The film, made of its passes and sums."""
        film = Film.empty(self.identity.frame, len(self.halves))
        for half, samples in zip(film.halves or (film,), self.halves, strict=True):
            half.samples = samples
        return film


def write_kept(
    path: Path, identity: FilmIdentity, progress: KeptProgress, halves: Iterable[dict[str, np.ndarray]]
) -> int:
    """Write a checkpoint to `path`, whole or not at all, even where the machine fails; `halves` are arrays of
    `samples_as_arrays`. Returns its bytes; errors of the file system (`OSError`) are raised as they are.
    """
    header, progress_arrays = progress.record()
    record = {"format": FORMAT, "version": VERSION, "film": identity.record(), "progress": header}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        with open(temporary, "wb") as file:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=_COMPRESSION) as archive:
                archive.writestr(_HEADER, json.dumps(record))
                for number, arrays in enumerate(halves):
                    for name, values in arrays.items():
                        _write_array(archive, f"{number}/{name}", values)
                for name, values in progress_arrays.items():
                    _write_array(archive, name, values)
            file.flush()
            os.fsync(file.fileno())
        return temporary.stat().st_size


def load_kept(path: Path) -> KeptFilm:
    """The checkpoint in `path`; raises `CheckpointError` for a file that is not there, or is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            header = json.loads(archive.read(_HEADER))
            if header["format"] != FORMAT:
                raise ValueError("its header is of another kind")
            if header["version"] != VERSION:
                raise CheckpointError(
                    f"{path} is a checkpoint of format version {header['version']}, and this RayBatch reads version "
                    f"{VERSION}: go on with the RayBatch that wrote it, or name another file to begin anew"
                )
            identity = FilmIdentity.of_record(header["film"])
            names = [name for name in archive.namelist() if name != _HEADER]
            arrays = {name.removesuffix(".npy"): _read_array(archive, name) for name in names}
        progress = KeptProgress.of_record(header["progress"], arrays, identity.part)
        halves = []
        for number in range(progress.half_count):
            start = f"{number}/"
            own = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
            halves.append(samples_of_arrays(identity.part, own))
    except FileNotFoundError:
        raise CheckpointError(f"there is no file {path}") from None
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror or error}") from error
    except _DAMAGE as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(
            f"{path} cannot be read as a checkpoint; is it damaged, cut short or of another kind? Name another "
            f"file to begin anew ({error})"
        ) from error
    return KeptFilm(identity, progress, tuple(halves))


def remove_leftovers(path: Path) -> None:
    """Remove what a process that was killed while it wrote `path` left beside it (`whole_file`)."""
    left = re.compile(rf"\.\d+\.\d+\.{re.escape(path.name)}")
    with contextlib.suppress(OSError):
        for each in path.parent.iterdir():
            if left.fullmatch(each.name):
                with contextlib.suppress(OSError):
                    each.unlink()


def _write_array(archive: zipfile.ZipFile, name: str, values: np.ndarray) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array(member, np.ascontiguousarray(values), allow_pickle=False)


def _read_array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    with archive.open(name) as member:
        values = np.lib.format.read_array(member, allow_pickle=False)
        _require_end(member)
    return values


def _require_end(member: IO[bytes]) -> None:
    """Read to the end, where the archive compares check sums."""
    if member.read(io.DEFAULT_BUFFER_SIZE):
        raise ValueError("an array is longer than it says")
