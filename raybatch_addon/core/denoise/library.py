"""Open Image Denoise, a shared library that is loaded by its path: its C interface, version 2, as far as it is used.

The interface is that of `oidn.h` (Intel, Apache License 2.0). Blender brings the library; nothing is linked to it.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from collections.abc import Callable, Iterable
from ctypes import POINTER, c_bool, c_char_p, c_int, c_size_t, c_void_p, cdll
from pathlib import Path

import numpy as np

from ..errors import RayBatchError
from ..settings.settings import SETTINGS

VARIABLE = "RAYBATCH_OPEN_IMAGE_DENOISE"
# What the library is called in its folder, where the loader of the system looks for it too
FILE_NAMES = {
    "win32": ("OpenImageDenoise.dll",),
    "darwin": ("libOpenImageDenoise.2.dylib", "libOpenImageDenoise.dylib"),
}.get(sys.platform, ("libOpenImageDenoise.so.2", "libOpenImageDenoise.so"))

# Numbers of oidn.h
_DEVICE_CPU, _FORMAT_FLOAT3 = 1, 3
QUALITIES = {"FAST": 4, "BALANCED": 5, "HIGH": 6}
_VERSION_MAJOR = 2

_CANCELLED = 6  # the error of a filter that its monitor ended
# bool (*OIDNProgressMonitorFunction)(void* userPtr, double n): false ends the filter
_MONITOR = ctypes.CFUNCTYPE(c_bool, c_void_p, ctypes.c_double)

_DECLARED = {
    "oidnNewDevice": (c_void_p, [c_int]),
    "oidnCommitDevice": (None, [c_void_p]),
    "oidnGetDeviceError": (c_int, [c_void_p, POINTER(c_char_p)]),
    "oidnGetDeviceInt": (c_int, [c_void_p, c_char_p]),
    "oidnNewFilter": (c_void_p, [c_void_p, c_char_p]),
    "oidnSetSharedFilterImage": (None, [c_void_p, c_char_p, c_void_p, c_int, *[c_size_t] * 5]),
    "oidnSetFilterBool": (None, [c_void_p, c_char_p, c_bool]),
    "oidnSetFilterInt": (None, [c_void_p, c_char_p, c_int]),
    "oidnSetFilterProgressMonitorFunction": (None, [c_void_p, _MONITOR, c_void_p]),
    "oidnCommitFilter": (None, [c_void_p]),
    "oidnExecuteFilter": (None, [c_void_p]),
    "oidnReleaseFilter": (None, [c_void_p]),
}


class DenoiseStoppedError(RayBatchError):
    """A filter that ended before its picture was done, because who asked for it gave it up."""


class DenoiseLibrary:
    """The loaded library with a device on the CPU, whose results repeat bit for bit.

    One filter at a time may run on it: of two renders in one process the later one waits for the library itself.
    """

    def __init__(self, path: str):
        """Load `path`; raises `RayBatchError`."""
        self.path = path
        try:
            self._functions = cdll.LoadLibrary(path)
            for name, (result, arguments) in _DECLARED.items():
                function = getattr(self._functions, name)
                function.restype, function.argtypes = result, arguments
        except (OSError, AttributeError) as error:
            raise RayBatchError(f"{path} is not Open Image Denoise 2: {error}") from None
        self._device = self._functions.oidnNewDevice(_DEVICE_CPU)
        if not self._device:
            raise RayBatchError(f"Open Image Denoise at {path} has no device for this CPU: {self._error(None)[1]}")
        self._functions.oidnCommitDevice(self._device)
        self.check()
        numbers = [self._functions.oidnGetDeviceInt(self._device, f"version{part}".encode()) for part in _VERSION_PARTS]
        self.version = ".".join(map(str, numbers))
        if numbers[0] != _VERSION_MAJOR:
            raise RayBatchError(
                f"Open Image Denoise at {path} has version {self.version}, and {_VERSION_MAJOR} is needed"
            )

    def check(self) -> None:
        """Raise what went wrong since the last call as `RayBatchError`."""
        code, complaint = self._error(self._device)
        if code == _CANCELLED:
            raise DenoiseStoppedError("denoising was stopped")
        if code:
            raise RayBatchError(f"denoising failed: {complaint}")

    def filtered(
        self,
        images: dict[str, np.ndarray],
        flags: dict[str, bool],
        quality: str,
        given_up: Callable[[], bool] | None = None,
    ) -> np.ndarray:
        """What the filter "RT" makes of `images`, float32, shape [height, width, 3].

        Args:
            images: by the names of the filter's inputs ("color", "albedo", "normal"), float32, shape [height, width,
                3].
            flags: the filter's parameters by name: `hdr`, `cleanAux`.
            quality: one of `QUALITIES`.
            given_up: asked between the steps of the filter, on this thread or on another one while this one waits;
                True ends it soon.

        Raises:
            DenoiseStoppedError: `given_up` said so.
            RayBatchError: the library's own message, such as that there is no memory.
        """
        inputs = {name: np.ascontiguousarray(pixels, np.float32) for name, pixels in images.items()}
        height, width, _ = next(iter(inputs.values())).shape
        output = np.empty((height, width, 3), np.float32)
        library = self._functions
        monitor = _MONITOR(lambda _user, _share: given_up is None or not given_up())
        found = library.oidnNewFilter(self._device, b"RT")
        try:
            for name, pixels in (inputs | {"output": output}).items():
                place = pixels.ctypes.data
                library.oidnSetSharedFilterImage(found, name.encode(), place, _FORMAT_FLOAT3, width, height, 0, 0, 0)
            for name, value in flags.items():
                library.oidnSetFilterBool(found, name.encode(), value)
            library.oidnSetFilterInt(found, b"quality", QUALITIES[quality])
            library.oidnSetFilterProgressMonitorFunction(found, monitor, None)
            library.oidnCommitFilter(found)
            library.oidnExecuteFilter(found)
            self.check()
        finally:
            library.oidnReleaseFilter(found)
        return output

    def _error(self, device: int | None) -> tuple[int, str]:
        """Number and message of what went wrong since the last call; 0 where nothing did."""
        message = c_char_p()
        code = self._functions.oidnGetDeviceError(device, ctypes.byref(message))
        return code, (message.value or b"").decode(errors="replace")


_VERSION_PARTS = ("Major", "Minor", "Patch")
_loaded = functools.cache(DenoiseLibrary)


def open_library(given: str = "", places: Iterable[Path] = ()) -> DenoiseLibrary:
    """The library, loaded once in a process.

    Args:
        given: path of the file, or of its folder. If it is not empty nothing else is tried.
        places: folders in which it may be. Before them comes what the environment variable
            `RAYBATCH_OPEN_IMAGE_DENOISE` names, behind them what the system finds by its name.

    Raises:
        RayBatchError: it is not there, or cannot be loaded; the message says what to do.
    """
    cure = (
        f"set {SETTINGS['denoise_library'].label} (denoise_library) to the path of libOpenImageDenoise, which Blender "
        f"has in its folder lib, or turn {SETTINGS['denoise'].label} (denoise) off"
    )
    if named := given or os.environ.get(VARIABLE, ""):
        path = Path(named).expanduser()
        found = next((path / name for name in FILE_NAMES if (path / name).is_file()), path)
        if not found.is_file():
            whose = "denoise_library" if given else VARIABLE
            raise RayBatchError(f"for denoising there is no file {found} ({whose}); {cure}")
        return _loaded(str(found))
    for path in (place / name for place in places for name in FILE_NAMES):
        if path.is_file():
            return _loaded(str(path))
    for name in FILE_NAMES:
        try:
            return _loaded(name)
        except RayBatchError:
            continue
    raise RayBatchError(f"for denoising Open Image Denoise is not found; {cure}")
