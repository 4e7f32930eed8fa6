"""The kernels that go into the extension: all that any scene can begin with on a CPU, for each level of x86-64."""

from __future__ import annotations

import json
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.device.devices import find_device, start_warp
from raybatch_addon.core.device.kept_kernels import digest
from raybatch_addon.core.device.kernel import MODULE_OPTIONS
from raybatch_addon.core.device.shipped import FORMAT, INDEX, LEVELS, compiler_version
from raybatch_addon.core.files import whole_file

_NATIVE = "-march=native"
_PLATFORM = "linux-x64"
_AT_ONCE = 2  # compilers, each of a gigabyte for the largest module


def can_be_made(platform_name: str) -> bool:
    """Whether kernels for `platform_name` can be compiled on this machine."""
    return platform_name == _PLATFORM and sys.platform == "linux" and platform.machine() == "x86_64"


def flags_of(level: str) -> str:
    """The compiler's flags for processors of `level`; of the processor of this machine where it is "native"."""
    flags = MODULE_OPTIONS["cpu_compiler_flags"]
    assert _NATIVE in flags
    return flags if level == "native" else flags.replace(_NATIVE, f"-target-cpu {level}")


def source_of(module: wp.Module, block_size: int = 1) -> tuple[str, bytes]:
    """The C++ of `module` for a CPU, and what Warp wants to know of it when it is loaded."""
    module.get_module_hash(block_size)
    source, _, meta, _, _ = module._run_codegen(module.resolved_options[block_size] | {"output_arch": None}, True)
    return source, json.dumps(meta, sort_keys=True).encode()


def compile_source(source: str, level: str, target: Path, optimization_level: int = 2) -> None:
    """Compile C++ for processors of `level` into the file `target`; as Warp does, but for the processor."""
    with tempfile.TemporaryDirectory() as folder, whole_file(target) as half:
        path = Path(folder) / "module.cpp"
        path.write_text(source, encoding="utf-8")
        wp._src.build.build_cpu(
            str(half),
            str(path),
            fuse_fp=MODULE_OPTIONS["fuse_fp"],
            extra_flags=flags_of(level),
            optimization_level=optimization_level,
            use_precompiled_headers=False,
            block_dim=1,
        )


def make_kernels(
    out: Path,
    kept: Path,
    kernels: Iterable[wp.Kernel] | None = None,
    levels: Iterable[str] = tuple(LEVELS),
    on_progress: Callable[[str], None] = lambda line: None,
) -> None:
    """Write a folder of kernels with its index to `out`.

    Args:
        kept: folder for what was compiled before; it is found again by the hash of its code.
        kernels: which (default: those that any scene can begin with).
        levels: for which processors.
        on_progress: is told what is compiled.
    """
    start_warp()
    device = find_device("cpu")
    modules = {kernel.module.name: kernel.module for kernel in kernels or GeneralRequest().kernels(device)}
    levels, version, entries = list(levels), compiler_version(), {}
    for level in levels:
        (out / level).mkdir(parents=True)

    def make(module: wp.Module) -> None:
        identifier, full_hash = module.get_module_identifier(1), module.get_module_hash(1).hex()
        source, meta = source_of(module)
        meta_name = f"{identifier}.meta"
        (out / meta_name).write_bytes(meta)
        entry = entries[identifier] = {
            "hash": full_hash,
            "meta": {"file": meta_name, "sum": digest(meta)},
            "binaries": {},
        }
        for level in levels:
            name = f"{identifier}.o"
            known = kept / wp.config.version / f"llvm-{version['llvm']}" / level / f"{full_hash}.o"
            if not known.exists():
                known.parent.mkdir(parents=True, exist_ok=True)
                on_progress(f"compiling {module.name} for {level}")
                compile_source(source, level, known)
            shutil.copy(known, out / level / name)
            entry["binaries"][level] = {"file": name, "sum": digest(known.read_bytes())}

    ordered = sorted(modules.values(), key=lambda module: -len(module.kernels))  # the longest first
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        list(pool.map(make, ordered))
    index = {
        "format": FORMAT,
        "warp": wp.config.version,
        "targets": dict.fromkeys(levels, version),
        "modules": dict(sorted(entries.items())),
    }
    (out / INDEX).write_text(json.dumps(index, indent=1), encoding="utf-8")
