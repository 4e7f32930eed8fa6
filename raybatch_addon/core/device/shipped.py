"""Kernels that were compiled when the extension was packed, for processors of several levels and for several GPUs.

`index.json` in their folder lists them by module. They are loaded from where they are installed, which may be a folder
that nobody can write. Without the folder, as in a clone, there are none.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import warp as wp

from . import ready
from .kept_kernels import KernelFiles, digest
from .kernel import is_general
from .notes import note

INDEX = "index.json"
FORMAT = 2
_refused: dict[KernelFiles, str] = {}  # shipped kernels that could not be loaded, and why
_CURE = "kernels are compiled here instead"

# The levels of x86-64 as compilers know them, best first, and what each adds. Blender itself needs the last one.
LEVELS = {
    "x86-64-v4": ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
    "x86-64-v3": ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
    "x86-64-v2": ("cx16", "sahf", "popcnt", "sse3", "sse4.1", "sse4.2", "ssse3"),
}
# Machine code for CUDA, and the compute capability that it is for, times ten. A device runs code of its own major
# number whose minor one is not above its own: these five serve all that Warp's compiler knows in machines of x86-64.
ARCHITECTURES = {"sm_120": 120, "sm_100": 100, "sm_90": 90, "sm_80": 80, "sm_75": 75}


def compiler_version(target: str) -> dict[str, str]:
    """What kernels compiled for `target` depend on beside it."""
    if target in ARCHITECTURES:
        return {}
    context = wp._src.context
    return {"llvm": context._get_cpu_toolchain_version(), "triple": context._get_cpu_target_triple()}


def fitting_targets(device: wp.Device) -> list[str]:
    """The targets whose kernels run on `device`, best first."""
    if device.is_cuda:
        fit = {each: arch for each, arch in ARCHITECTURES.items() if 0 <= device.arch - arch <= device.arch % 10}
        return sorted(fit, key=fit.get, reverse=True)
    has = wp._src.context._get_cpu_feature_set()
    levels = list(LEVELS)
    return [
        level for i, level in enumerate(levels) if all(each in has for below in levels[i:] for each in LEVELS[below])
    ]


def shipped_files(module: wp.Module, device: wp.Device, block_size: int) -> KernelFiles | None:
    """The shipped `module`, if it fits `device` and is sound; where there should be one, a note says why not."""
    index = _index(ready.SHIPPED)
    if not index or not any((target in ARCHITECTURES) == device.is_cuda for target in index["targets"]):
        return None
    identifier = module.get_module_identifier(block_size)
    entry = index["modules"].get(identifier)
    if entry is None or entry["hash"] != module.get_module_hash(block_size).hex():
        if is_general(module) and wp.config.optimization_level is None:  # else its name is another for that
            note(f"the shipped general kernels belong to other code than this RayBatch; {_CURE}")
        return None
    complaints, targets = [], fitting_targets(device)
    for target in targets:
        binary = entry["binaries"].get(target)
        if binary is None:
            continue
        files = KernelFiles(*(ready.SHIPPED / target / binary[each] for each in ("file", "meta")), target)
        if index["targets"][target] != compiler_version(target):
            complaints.append(f"the shipped kernels for {target} are for another compiler or system than this Warp has")
        elif not _is_sound(files, binary["sum"], binary["meta_sum"]):
            complaints.append(f"the shipped kernel {files.binary} is damaged (install the extension again)")
        elif files in _refused:
            complaints.append(f"the shipped kernel {files.binary} cannot be loaded: {_refused[files]}")
        else:
            for complaint in complaints:
                note(f"{complaint}; that for {target} takes its place")
            return files
    lacks = f"there are no shipped kernels for {device.name if device.is_cuda else 'this processor'}"
    if not targets and device.is_cpu:
        lacks = f"the shipped kernels need a processor of at least {list(LEVELS)[-1]}"
    for complaint in complaints or [lacks]:
        note(f"{complaint}; {_CURE}")
    return None


def refuse(files: KernelFiles, why: str) -> None:
    """Take no longer the shipped `files`, which could not be loaded."""
    _refused[files] = why


@functools.lru_cache(maxsize=4)
def _index(folder: Path) -> dict[str, Any]:
    """The list of what is in `folder`; nothing where that cannot be used."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        if index["format"] != FORMAT or index["warp"] != wp.config.version:
            note(f"the shipped kernels are for Warp {index['warp']}, and this is {wp.config.version}; {_CURE}")
            return {}
        for entry in index["modules"].values():
            _ = entry["hash"]
            for target, each in entry["binaries"].items():
                _ = (index["targets"][target], *(each[key] for key in ("file", "sum", "meta", "meta_sum")))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        note(f"the list of shipped kernels {path} is damaged ({type(error).__name__}); {_CURE}; install it again")
        return {}
    return index


@functools.lru_cache(maxsize=256)
def _is_sound(files: KernelFiles, binary_sum: str, meta_sum: str) -> bool:
    try:
        return digest(files.binary.read_bytes()) == binary_sum and digest(files.meta.read_bytes()) == meta_sum
    except OSError:
        return False
