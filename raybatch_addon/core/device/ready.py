"""Hashes of modules of kernels, kept by their identity, so that nobody has to hash their code again.

They are kept beside the compiled kernels, in a file for each state of the sources, and shipped with those that are. The
file is only ever a shorter way to a hash: where it is damaged, lacks a module or names one that is not there, the code
is hashed as if there were no such file.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
import time
import weakref
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files import sole_owner, whole_file
from .identity import sources_changed, sources_digest
from .kept_kernels import folders

if TYPE_CHECKING:
    import warp as wp

SHIPPED = Path(__file__).resolve().parents[2] / "kernels"  # kernels that came with the extension
_FILES_MOST = 12  # states of the sources that are remembered
_LOCK = ".known.lock"  # who holds this file may write
_lock = threading.Lock()
_read: dict[Path, tuple[tuple[int, ...] | None, dict[str, Any]]] = {}  # what files hold, with their times
_new: dict[str, dict[str, Any]] = {}  # not written yet


@dataclass
class KnownModule:
    """The result of hashing a module."""

    name: str
    # by block size: of it, and of its kernels by their identities
    hashes: dict[int, tuple[str, dict[str, str]]] = field(default_factory=dict)
    dimensions: dict[str, int] = field(default_factory=dict)  # of a launch, by kernel


class KnownHash:
    """Stands for what hashes the code of a module, with its hash and those of its kernels."""

    def __init__(self, own: str, kernel_hashes: dict[wp.Kernel, bytes]):
        self.hash = bytes.fromhex(own)
        self.kernel_hashes = weakref.WeakKeyDictionary(kernel_hashes)
        self.unique_kernels: dict[bytes, wp.Kernel] = {}

    def get_hash(self) -> bytes:
        """The hash of the module."""
        return self.hash


def known_module(identity: str) -> KnownModule | None:
    """What is known of the module."""
    with _lock:
        entries = [_new.get(identity)]
        entries += [_entries(path).get(identity) for path in (*_paths(), SHIPPED / file_name())]
    known = None
    try:
        for entry in filter(None, entries):
            known = known or KnownModule(entry["name"], {}, dict(entry["dimensions"]))
            for size, (own, kernels) in entry["hashes"].items():
                known.hashes.setdefault(int(size), (own, dict(kernels)))
    except (AttributeError, KeyError, TypeError, ValueError):  # from another program
        return None
    return known


def is_any_known(kernel_key: str) -> bool:
    """Whether any module of its own is known for a kernel called `kernel_key`, whatever it is specialised on."""
    with _lock:
        known = [_new, *(_entries(path) for path in (*_paths(), SHIPPED / file_name()))]
        entries = [entry for each in known for entry in each.values() if isinstance(entry, dict)]
        return any(str(entry.get("name")).rpartition("_")[0] == kernel_key for entry in entries)


def note_module(identity: str, known: KnownModule) -> None:
    """Remember what hashing found; `write_notes` keeps it."""
    with _lock:
        entry = _new.setdefault(identity, {"name": known.name, "dimensions": known.dimensions, "hashes": {}})
        entry["hashes"].update({str(size): [own, kernels] for size, (own, kernels) in known.hashes.items()})


def write_notes() -> None:
    """Keep what was noted since the last time; where that cannot be, it is hashed again by the next process."""
    with _lock:
        if not _new:
            return
        if sources_changed():  # what was hashed meanwhile may be of either state
            _new.clear()
            return
        path = _paths()[-1]
        # what another process writes between our reading and our writing would be lost
        with contextlib.suppress(OSError), sole_owner(path.parent / _LOCK):
            entries = dict(_entries(path))
            for identity, entry in _new.items():
                before = entries.get(identity, {}).get("hashes", {})
                entries[identity] = {**entry, "hashes": {**before, **entry["hashes"]}}
            _write(path, entries)
            _new.clear()
            _remove_old(path)


def _write(path: Path, entries: dict[str, Any]) -> None:
    """Write a whole file of entries; raises `OSError`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(entries, separators=(",", ":"), sort_keys=True)
    with whole_file(path) as half:
        half.write_text(f"{_sum(text)}\n{text}", encoding="ascii")


def write_for_shipping(folder: Path, identities: list[str]) -> None:
    """Write what is known of the modules to `folder`, which is to become that of shipped kernels."""
    known = {each: known_module(each) for each in identities if each}
    with _lock:
        _write(folder / file_name(), {identity: asdict(each) for identity, each in known.items() if each})


def forget_module(identity: str) -> None:
    """Drop what is known of a module, in this process, as it proved wrong."""
    with _lock:
        _new.pop(identity, None)
        for _, entries in _read.values():
            entries.pop(identity, None)


def file_name() -> str:
    """The name of the file for the sources as they are."""
    return f"known-{sources_digest()}.json"


def _paths() -> list[Path]:
    return [folder / file_name() for folder in folders()]


def _entries(path: Path) -> dict[str, Any]:
    """What the file holds; nothing where it is not there or not as it was written."""
    try:
        status = path.stat()
        times = status.st_ino, status.st_mtime_ns, status.st_size
    except OSError:
        times = None
    before = _read.get(path)
    if before is None or before[0] != times:
        before = _read[path] = times, _load(path) if times else {}
        if times:
            with contextlib.suppress(OSError):  # it was used; when it was written stays as it is
                os.utime(path, ns=(time.time_ns(), status.st_mtime_ns))
    return before[1]


def _load(path: Path) -> dict[str, Any]:
    try:
        total, _, text = path.read_text(encoding="ascii", errors="replace").partition("\n")
        entries = json.loads(text) if total == _sum(text) else {}
    except (OSError, ValueError):
        return {}
    return {name: each for name, each in entries.items() if isinstance(each, dict)} if isinstance(entries, dict) else {}


def _sum(text: str) -> str:
    return hashlib.blake2b(text.encode("ascii", errors="replace"), digest_size=16).hexdigest()


def _remove_old(path: Path) -> None:
    """Remove the files beside `path` that were not used for longest: other installations may share the folder."""
    with contextlib.suppress(OSError):
        found = sorted(path.parent.glob("known-*.json"), key=_last_used)
        for each in found[:-_FILES_MOST]:
            each.unlink()


def _last_used(path: Path) -> int:
    status = path.stat()
    return max(status.st_atime_ns, status.st_mtime_ns)
