"""Devices, worker threads and memory."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import warp as wp

from ..errors import DeviceError
from ..host_memory import host_memory_free, host_memory_peak, host_memory_used
from .codegen.by_reference import pass_structs_by_reference
from .codegen.local_arrays import set_local_arrays_once
from .compiler import compile_apart
from .declared import is_known
from .failures import check_device
from .kept_kernels import folders, spare_folder
from .kernel import block_size_of, optimisation_level
from .loading import find_files, is_loaded, load, load_here_what_is_launched
from .precompiled_header import share_precompiled_header
from .ready import write_notes

_warp_lock = threading.Lock()
# Warp's native code prints lines that begin so where there is no CUDA driver, or a driver without a device that it may
# use, whatever its log level is. That is no fault: `find_device` says which devices there are.
_NO_CUDA = (
    b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver",
    b"Warp CUDA error 100: no CUDA-capable device is detected",
)


def start_warp(cache_folder: str | Path | None = None) -> None:
    """Initialise Warp once, without a word on standard output, nor on standard error that there is no CUDA
    device; kernels are cached in `cache_folder`.

    Where that folder cannot be made they are kept in a temporary one, and a note says so. Raises `DeviceError` where
    there is none either, and `SettingsError` for a level of optimisation that does not exist (`kernel.py`).
    """
    with _warp_lock:
        wp.config.log_level = wp.LOG_ERROR
        _initialize_warp()
        if cache_folder is not None:
            # after init, which would put the version behind whatever it finds
            folder = Path(cache_folder) / wp.config.version
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                folder = spare_folder(folder, error)
            wp.config.kernel_cache_dir = str(folder)


@functools.cache
def _initialize_warp() -> None:
    level = optimisation_level()
    if level is not None:
        wp.config.optimization_level = level
    with _without_lines(_NO_CUDA):
        wp.init()
    compile_apart()
    pass_structs_by_reference()
    set_local_arrays_once()
    share_precompiled_header()
    load_here_what_is_launched()


@contextlib.contextmanager
def _without_lines(starts: tuple[bytes, ...]) -> Iterator[None]:
    """Keep lines that begin with one of `starts` from standard error; all else that is written there meanwhile comes at
    the end.
    """
    with contextlib.ExitStack() as opened:
        written = None
        with contextlib.suppress(OSError):  # there is no standard error, or no room for a file
            real = os.dup(2)
            opened.callback(os.close, real)
            written = opened.enter_context(tempfile.TemporaryFile())
        if written is None:
            yield
            return
        _flush_standard_error()
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            _flush_standard_error()
            os.dup2(real, 2)
            written.seek(0)
            for line in written:
                if not line.startswith(starts):
                    os.write(2, line)


def _flush_standard_error() -> None:
    if sys.stderr is not None:  # as in a program that has no console
        sys.stderr.flush()


def warp_cache_folder() -> Path:
    """Where compiled kernels are kept, of every version of Warp."""
    return folders()[-1].parent


def find_device(name: str) -> wp.Device:
    """The device called `name`: AUTO, cpu or cuda:N; raises `DeviceError` that lists what there is."""
    return _find_device(name)


def _find_device(name: str, *others: str) -> wp.Device:
    """The same; `others` may be given besides."""
    start_warp()
    cuda = [device.alias for device in wp.get_cuda_devices()]
    text = name.strip().lower()
    if text == "auto":
        text = cuda[0] if cuda else "cpu"
    elif text == "cuda" and cuda:
        text = cuda[0]
    if text != "cpu" and text not in cuda:
        there = ", ".join(["AUTO", "cpu", *cuda, *others])
        is_asked = text.startswith("cuda") and not cuda
        why = "; no CUDA device was found (is the NVIDIA driver installed?)" if is_asked else ""
        raise DeviceError(f"there is no device {name!r}: choose one of {there}{why}")
    device = wp.get_device(text)
    if device.is_cuda:
        # the first thread that asks makes the context, then its stream; another would find one without the other
        _ = device.context
    return device


def find_devices(names: str) -> list[wp.Device]:
    """The devices called `names`, each as `find_device` knows it, with commas between; ALL: every CUDA device of the
    model of the first, or the CPU where there is none. Raises `DeviceError`.
    """
    if names.strip().upper() == "ALL":
        first = find_device("AUTO")
        names = ",".join(each.alias for each in wp.get_cuda_devices() if is_alike(each, first)) or first.alias
    found: list[wp.Device] = []
    for name in names.split(","):
        if not name.strip() and names.strip():
            raise DeviceError(f"{names!r} has a comma too many")
        if name.strip().upper() == "ALL":
            raise DeviceError(f"{names!r} names ALL and others; give ALL alone")
        device = _find_device(name, "ALL")
        if device in found:
            raise DeviceError(f"{names!r} names {device.alias} twice; name each device once")
        found.append(device)
    return found


def is_alike(device: wp.Device, other: wp.Device) -> bool:
    """Whether both are of one model, so that they render the same bits."""
    return device.is_cuda == other.is_cuda and (device.is_cpu or (device.name, device.arch) == (other.name, other.arch))


def one_of_each_kind() -> list[wp.Device]:
    """The CPU, and a CUDA device of each architecture: others of it run the same kernels."""
    first = {device.arch: device for device in reversed(wp.get_cuda_devices())}
    return [wp.get_device("cpu"), *first.values()]


def worker_count(device: wp.Device, thread_count: int) -> int:
    """Worker threads of a render: every core of the CPU by default; on a CUDA device one, or as
    `wavefront/render/workers.py` has it.
    """
    if device.is_cuda:
        return 1
    if thread_count:
        return thread_count
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def device_description(device: wp.Device) -> dict[str, str | int]:
    """Name and size of `device`, for reports."""
    return {"alias": device.alias, "name": device.name, "memory": total_memory(device), "cores": os.cpu_count() or 1}


def total_memory(device: wp.Device) -> int:
    """Memory of `device` [bytes]; 0 where the system does not say."""
    if device.is_cuda:
        return int(device.total_memory)
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 0


def free_memory(device: wp.Device) -> int:
    """Memory that a render may still take on `device` [bytes]; raises `DeviceError` for one that has stopped."""
    if not device.is_cuda:
        return host_memory_free()
    if (free := int(device.free_memory)) == 0:
        check_device(device)  # one that has stopped says 0 too
    return free


def device_memory_peak(device: wp.Device) -> int:
    """Largest device memory that Warp held so far [bytes]; 0 on the CPU, where the host's figure holds."""
    return int(wp.get_mempool_used_mem_high(device)) if device.is_cuda and wp.is_mempool_enabled(device) else 0


def memory_used(device: wp.Device) -> tuple[int, int]:
    """Memory held now, and at most so far [bytes]: that of Warp on `device`, on the CPU that of this process; 0 where
    nobody says.
    """
    if not device.is_cuda:
        return host_memory_used(), host_memory_peak()
    used = int(wp.get_mempool_used_mem_current(device)) if wp.is_mempool_enabled(device) else 0
    return used, device_memory_peak(device)


def _block_size(kernel: wp.Kernel, device: wp.Device) -> int:
    return block_size_of(kernel) if device.is_cuda else 1


def load_module(kernel: wp.Kernel, device: wp.Device, given_up: Callable[[], bool] | None = None) -> None:
    """Compile or load the module of `kernel`. Several threads may ask for one module: the first one loads it.

    Raises `DeviceError` where it cannot be compiled, and `CompileStoppedError` where `given_up` said so meanwhile.
    """
    load(kernel.module, device, _block_size(kernel, device), given_up)


def is_compiled(kernel: wp.Kernel, device: wp.Device, at_once: bool = False) -> bool:
    """Whether the module of `kernel` is loaded, was shipped, or is in the cache of compiled kernels.

    `at_once`: only if that can be known without its code, which takes a tenth of a second or more.
    """
    module, block_size = kernel.module, _block_size(kernel, device)
    if at_once and not is_known(module, block_size):
        return False
    return is_loaded(module, device, block_size) or find_files(module, device, block_size) is not None


def shipped_target(kernel: wp.Kernel, device: wp.Device) -> str:
    """The target that the module of `kernel` was shipped for; empty where it is not a shipped one that is found."""
    files = find_files(kernel.module, device, _block_size(kernel, device))
    return files.target if files else ""


def is_kernel_loaded(kernel: wp.Kernel, device: wp.Device) -> bool:
    """Whether the module of `kernel` is loaded."""
    return is_loaded(kernel.module, device, _block_size(kernel, device))


def loaded_modules(kernels: Iterable[wp.Kernel], device: wp.Device) -> list[str] | None:
    """The names of the modules of `kernels`, if all of them are loaded."""
    unique = {kernel.module.name: kernel for kernel in kernels}
    return sorted(unique) if all(is_kernel_loaded(each, device) for each in unique.values()) else None


def load_kernels(
    kernels: Iterable[wp.Kernel],
    device: wp.Device,
    on_module: Callable[[int, int], None],
    given_up: Callable[[], bool] | None = None,
) -> list[str]:
    """Compile or load the modules of `kernels`, several at a time; returns the modules' names.

    Done before worker threads start, because a launch must find its module loaded.
    `on_module(done, all)` is called with those that are there, and after each of the others. Raises as `load_module`
    does.
    """
    from concurrent.futures import ThreadPoolExecutor, as_completed

    unique = {kernel.module.name: kernel for kernel in kernels}
    lacking = [each for each in unique.values() if not is_kernel_loaded(each, device)]
    there = len(unique) - len(lacking)
    on_module(there, len(unique))
    if lacking:  # else no thread is begun: a second render has all
        with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
            tasks = [pool.submit(load_module, kernel, device, given_up) for kernel in lacking]
            for done, task in enumerate(as_completed(tasks), there + 1):
                task.result()
                on_module(done, len(unique))
    write_notes()
    return sorted(unique)


@functools.cache
def copy_stream(alias: str, what: str) -> wp.Stream:
    """The stream that copies `what` to the CUDA device `alias`, and does not wait for the device's default stream.

    Warp's own streams do: it frees memory on the default stream, and each such call would hold up tracing until all
    copies that were begun are over. Where the driver gives no such stream, one of Warp's stands for it.
    """
    non_blocking = 1  # CU_STREAM_NON_BLOCKING of the driver
    device = wp.get_device(alias)
    with contextlib.suppress(OSError, AttributeError), device.context_guard:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        handle = ctypes.c_void_p()
        if driver.cuStreamCreate(ctypes.byref(handle), ctypes.c_uint(non_blocking)) == 0 and handle.value:
            return wp.Stream(device, cuda_stream=handle.value)
    return wp.Stream(device)
