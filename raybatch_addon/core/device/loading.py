"""Modules of kernels, loaded: as they were compiled before or shipped, else compiled now."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import warp as wp

from ..errors import DeviceError
from .compile_errors import complaint_of
from .compiler import CompileError, CompileStoppedError, given_up_now, given_up_when
from .declared import declare_all, has_entry_points
from .kept_kernels import (
    KernelFiles,
    cannot_be_kept,
    files_in,
    folders,
    is_as_written,
    kept_files,
    remove,
    remove_half_compiled,
    seal,
    spare_folder,
)
from .kernel import OUR_FLAGS
from .notes import compiling_noted
from .shipped import refuse, shipped_files

_TRIES = 3  # another process may take away what is damaged, just when it was found
_lock = threading.Lock()
_locks: dict[int, threading.Lock] = {}
_local = threading.local()
_failed: dict[tuple[str, str], str] = {}  # complaints by module and device: it is not compiled again


def find_files(module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles | None:
    """The compiled `module`, if it was compiled here or shipped."""
    return kept_files(module, device, block_size) or shipped_files(module, device, block_size)


def is_loaded(module: wp.Module, device: wp.Device, block_size: int) -> bool:
    """Whether `module` can be launched as it is."""
    loaded = module.execs.get((device.context if device.is_cuda else None, block_size))
    return loaded is not None and loaded.module_hash == module.get_module_hash(block_size)


def load(module: wp.Module, device: wp.Device, block_size: int, given_up: Callable[[], bool] | None = None) -> None:
    """Load `module`, and compile it first where it has to be. Several threads may ask for it: the first one loads it.

    Raises:
        DeviceError: it cannot be compiled, or not be kept.
        CompileStoppedError: `given_up` said so meanwhile.
    """
    with _lock:
        lock = _locks.setdefault(id(module), threading.Lock())  # modules live as long as the process
    if is_loaded(module, device, block_size):
        return
    note = getattr(_local, "note", lambda begins: None)
    note(True)
    try:
        with lock:
            if not is_loaded(module, device, block_size):
                _load(module, device, block_size, given_up)
    finally:
        note(False)


@contextlib.contextmanager
def loads_noted(note: Callable[[bool], None]) -> Iterator[None]:
    """Inside, `note` is called when this thread begins to wait for a module to be loaded (True), and when it has it
    (False).
    """
    _local.note = note
    try:
        yield
    finally:
        del _local.note


def load_here_what_is_launched() -> None:
    """Let Warp load modules of ours by `load` where they are launched before; called after `wp.init`."""
    within = wp.Module.load
    if getattr(within, "is_here", False):
        return

    @functools.wraps(within)
    def load_module(module, device, block_dim=None, binary_path=None, **options):
        device = wp.get_device(device)
        size = module.options["block_dim"] if block_dim is None else block_dim
        key = (device.context if device.is_cuda else None, size)
        if (
            key in module.execs  # first: each launch comes by here
            or binary_path is not None
            or options
            or module.options["cpu_compiler_flags"] not in OUR_FLAGS
        ):
            return within(module, device, block_dim, binary_path, **options)
        load(module, device, size)
        return module.execs[key]

    load_module.is_here = True
    wp.Module.load = load_module


def _load(module: wp.Module, device: wp.Device, block_size: int, given_up: Callable[[], bool] | None) -> None:
    failed: set[KernelFiles] = set()
    for left in reversed(range(_TRIES)):
        if given_up is not None and given_up():
            raise CompileStoppedError
        files = find_files(module, device, block_size)
        if files is None:
            with given_up_when(given_up or given_up_now()), compiling_noted():
                files = _compile(module, device, block_size)
        try:
            loaded = module.load(
                device,
                block_size,
                binary_path=files.binary,
                output_arch=module._get_compile_arch(device),
                meta_path=files.meta,
            )
            if has_entry_points(module, loaded):
                return
        except Exception as error:  # Warp raises nothing better where a file cannot be read
            if not left or (not files.target and is_as_written(files)):
                raise DeviceError(f"the compiled kernel {files.binary} cannot be loaded: {error}") from error
            if not files.target:
                remove(files)
            elif files in failed:
                refuse(files, str(error))
            failed.add(files)
    raise DeviceError(f"the compiled kernel {files.binary} does not hold what it should; remove it and render again")


def _compile(module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles:
    key = (module.get_module_identifier(block_size), device.alias)
    if complaint := _failed.get(key):
        raise DeviceError(complaint)
    folder = folders()[-1]
    try:
        return _compile_into(folder, module, device, block_size)
    except OSError as error:
        spare = spare_folder(folder, error)
        try:
            return _compile_into(spare, module, device, block_size)
        except OSError as again:
            raise cannot_be_kept(folder if spare == folder else spare, again) from error


def _compile_into(folder: Path, module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles:
    """Compile `module`; raises `OSError` where that cannot be kept in `folder`."""
    declare_all(module)
    identifier = module.get_module_identifier(block_size)
    files = files_in(folder, module, device, block_size)
    try:
        module._compile(
            device,
            files.binary.parent,
            files.binary.name,
            module._get_compile_arch(device),
            options=module.resolved_options[block_size],
        )
        if not files.binary.exists() or not files.meta.exists():  # not all that failed is said
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(files.binary))
        seal(files)
        return files
    except (OSError, CompileStoppedError):
        raise
    except Exception as error:
        if isinstance(error, CompileError) and (lack := error.lack_of_room):
            raise lack from error
        half = Path(f"{files.binary.parent}_p{os.getpid()}_t{threading.get_ident()}")
        if isinstance(error, CompileError) and error.code < 0:  # it may go well the next time
            raise DeviceError(
                f"the system ended a compiler of kernels (signal {-error.code}), probably for lack of memory; close "
                "other programs and render again"
            ) from error
        complaint = complaint_of(module, device, error, half / f"{identifier}.cpp", folder)
        _failed[identifier, device.alias] = complaint
        raise DeviceError(complaint) from error
    finally:
        module.failed_builds.pop((device.context if device.is_cuda else None, block_size), None)
        remove_half_compiled(files.binary.parent)
