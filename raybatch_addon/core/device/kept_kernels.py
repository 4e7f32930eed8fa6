"""Compiled kernels in folders: found and checked, and made anew where they are damaged.

They are looked for in the user's folder, in the spare one, and among those that were shipped. The spare folder is made
where the user's cannot be written, and goes with this process.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import os
import re
import shutil
import struct
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from ..errors import DeviceError
from ..files import KERNELS_PREFIX, give_up, owned_folder, whole_file
from .notes import note

_ABANDONED_SECONDS = 86400.0  # nothing compiles as long as that
_spare: Path | None = None
_may_be_spare = True
_spare_lock = threading.Lock()
_sound: dict[Path, tuple] = {}  # what was found sound, with the times of its files


@dataclass(frozen=True)
class KernelFiles:
    """A module that was compiled."""

    binary: Path
    meta: Path
    target: str = ""  # that it was shipped for; empty where it was compiled here

    @property
    def sum(self) -> Path:
        """The file with the sums of both."""
        return self.binary.with_name(f"{self.binary.name}.sum")


def folders() -> list[Path]:
    """Where kernels are kept that were compiled here; new ones go to the last."""
    found = [Path(wp.config.kernel_cache_dir)]
    return [*found, _spare] if _spare and _spare not in found else found


def keep_or_fail() -> None:
    """From now on, kernels that cannot be kept in the user's folder are errors: this process compiles for others."""
    global _may_be_spare
    _may_be_spare = False


def spare_folder(unusable: Path, error: OSError) -> Path:
    """The folder for kernels that cannot be kept in `unusable`; raises `DeviceError` where there can be none."""
    global _spare
    with _spare_lock:
        if not _may_be_spare:
            raise cannot_be_kept(unusable, error)
        if _spare is None:
            try:
                if owned := owned_folder(KERNELS_PREFIX):
                    atexit.register(give_up, *owned)
                    folder = owned[0]
                else:
                    folder = Path(tempfile.mkdtemp(prefix=KERNELS_PREFIX))
                    atexit.register(shutil.rmtree, folder, ignore_errors=True)
                (folder / wp.config.version).mkdir()
            except OSError as other:
                raise cannot_be_kept(unusable, error) from other
            _spare = folder / wp.config.version
            note(f"{cannot_be_kept(unusable, error)}; until then they are compiled again after each start")
        return _spare


def cannot_be_kept(folder: Path, error: OSError) -> DeviceError:
    """The error of a folder that cannot be written."""
    return DeviceError(
        f"compiled kernels cannot be kept in {folder} ({error.strerror or error}); make room in it and make it "
        "writable, or set RAYBATCH_KERNEL_CACHE to another folder"
    )


def kept_files(module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles | None:
    """The compiled `module`, if it is kept; a damaged one is removed."""
    for folder in folders():
        files = files_in(folder, module, device, block_size)
        if not files.binary.exists() or not files.meta.exists():
            continue
        if is_sound(files):
            return files
        note(f"the compiled kernel {files.binary} was damaged; it is compiled anew")
        remove(files)
    return None


def files_in(folder: Path, module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles:
    """Where `module` is kept in `folder`, whether it is there or not."""
    inside = folder / module.get_module_identifier(block_size)
    name = module._get_compile_output_name(device, block_dim=block_size)
    return KernelFiles(inside / name, inside / module._get_meta_name(block_dim=block_size))


def is_as_written(files: KernelFiles) -> bool:
    """Whether sums say so that were written with the files, which are read again."""
    try:
        return _agrees_with_sums(files, files.binary.read_bytes(), files.meta.read_bytes()) is True
    except OSError:
        return False


def is_sound(files: KernelFiles) -> bool:
    """Whether both files are as they were written. What has no sums, as from another program, has to be complete."""
    try:
        times = tuple((each.stat().st_mtime_ns, each.stat().st_size) for each in (files.binary, files.meta))
        if _sound.get(files.binary) == times:
            return True
        binary, meta = files.binary.read_bytes(), files.meta.read_bytes()
        sound = _agrees_with_sums(files, binary, meta)
        if sound is None:
            sound = _is_complete(files.binary.suffix, binary) and isinstance(json.loads(meta), dict)
    except (OSError, ValueError):
        return False
    if sound:
        _sound[files.binary] = times
    return sound


def seal(files: KernelFiles) -> None:
    """Write the sums of what was just compiled; it can do without."""
    with contextlib.suppress(OSError), whole_file(files.sum) as path:
        path.write_text(_sums(files.binary.read_bytes(), files.meta.read_bytes()), encoding="ascii")


def remove(files: KernelFiles) -> None:
    """Take away what is damaged. Another process may be about to do the same."""
    _sound.pop(files.binary, None)
    for each in (files.sum, files.binary, files.meta):
        with contextlib.suppress(OSError):
            each.unlink()


def remove_half_compiled(folder: Path) -> None:
    """Take away what this thread began to compile into `folder`."""
    shutil.rmtree(f"{folder}_p{os.getpid()}_t{threading.get_ident()}", ignore_errors=True)


def remove_abandoned() -> None:
    """Take away what processes began to compile that were ended."""
    for folder in folders():
        with contextlib.suppress(OSError):
            for path in folder.iterdir():
                old = re.search(r"_p\d+_t\d+$", path.name) and time.time() - path.stat().st_mtime > _ABANDONED_SECONDS
                if old:
                    shutil.rmtree(path, ignore_errors=True)


def digest(data: bytes) -> str:
    """The sum of `data`."""
    return hashlib.sha256(data).hexdigest()


def _agrees_with_sums(files: KernelFiles, binary: bytes, meta: bytes) -> bool | None:
    """Whether the sums that were written are those of `binary` and `meta`; None where there are none."""
    try:
        return files.sum.read_text(encoding="ascii", errors="replace") == _sums(binary, meta)
    except FileNotFoundError:
        return None


def _sums(binary: bytes, meta: bytes) -> str:
    return f"{digest(binary)}\n{digest(meta)}\n"


def _is_complete(suffix: str, data: bytes) -> bool:
    """Whether an object of ELF is as long as it says; other files, whether they have something in them."""
    if suffix != ".o" or os.name == "nt" or os.uname().sysname == "Darwin":
        return bool(data)
    if len(data) < 64 or data[:4] != b"\x7fELF":
        return False
    (sections,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    return sections + size * count <= len(data)
