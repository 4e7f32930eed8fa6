"""The kernels that go into the extension: all that any scene can begin with, for levels of x86-64 and for CUDA."""

from __future__ import annotations

import json
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.device.declared import declare_all, module_identity
from raybatch_addon.core.device.devices import start_warp
from raybatch_addon.core.device.kept_kernels import digest
from raybatch_addon.core.device.kernel import MODULE_OPTIONS, block_size_of, is_general
from raybatch_addon.core.device.ready import write_for_shipping
from raybatch_addon.core.device.shipped import ARCHITECTURES, FORMAT, INDEX, LEVELS, compiler_version
from raybatch_addon.core.files import whole_file

TARGETS = (*LEVELS, *ARCHITECTURES)
_NATIVE = "-march=native"
_PLATFORM = "linux-x64"
_AT_ONCE = 2  # compilers, each of a gigabyte or two for the largest module


def can_be_made(platform_name: str) -> bool:
    """Whether kernels for `platform_name` can be compiled on this machine."""
    return platform_name == _PLATFORM and sys.platform == "linux" and platform.machine() == "x86_64"


def flags_of(level: str, flags: str) -> str:
    """`flags` of a module for processors of `level`; for the processor of this machine where it is "native"."""
    assert _NATIVE in flags
    return flags if level == "native" else flags.replace(_NATIVE, f"-target-cpu {level}")


def source_of(module: wp.Module, block_size: int = 1, architecture: int | None = None) -> tuple[str, bytes]:
    """The code of `module` for a CPU, or for CUDA where there is an `architecture`, and what Warp wants to know of it
    when it is loaded.
    """
    declare_all(module)
    module.get_module_hash(block_size)
    options = module.resolved_options[block_size] | {"output_arch": architecture}
    source, _, meta, _, _ = module._run_codegen(options, architecture is None)
    return source, json.dumps(meta, sort_keys=True).encode()


def compile_source(
    source: str,
    target: str,
    file: Path,
    block_size: int = 1,
    optimization_level: int = 2,
    flags: str | None = MODULE_OPTIONS["cpu_compiler_flags"],
) -> None:
    """Compile code for `target` into `file`, as Warp does but for its choice of the target.

    `target`: of `TARGETS`, or "native". `optimization_level`, `flags`: of code for a CPU; its module's.
    """
    build, architecture = wp._src.build, ARCHITECTURES.get(target)
    with tempfile.TemporaryDirectory() as folder, whole_file(file) as half:
        path = Path(folder) / ("module.cu" if architecture else "module.cpp")
        path.write_text(source, encoding="utf-8")
        common = {"fuse_fp": MODULE_OPTIONS["fuse_fp"], "use_precompiled_headers": False}
        if not architecture:
            assert flags is not None, "code for a CPU has flags"
            level = {"extra_flags": flags_of(target, flags), "optimization_level": optimization_level}
            build.build_cpu(str(half), str(path), block_dim=block_size, **common, **level)
            return
        binary = Path(folder) / "module.cubin"  # its name says what is made
        fast_math = MODULE_OPTIONS["fast_math"]
        build.build_cuda(str(path), architecture, str(binary), pch_dir=None, fast_math=fast_math, **common)
        shutil.copy(binary, half)


def kernels_for(target: str) -> list[wp.Kernel]:
    """What any scene can begin with on a device of `target`, which need not be there."""
    is_cuda = target in ARCHITECTURES
    stand_in: Any = SimpleNamespace(is_cuda=is_cuda, is_cpu=not is_cuda)  # nothing else of a device is asked for
    return GeneralRequest().kernels(stand_in)


def make_kernels(
    out: Path,
    kept: Path,
    kernels: Iterable[wp.Kernel] | None = None,
    targets: Iterable[str] = TARGETS,
    on_progress: Callable[[str], None] = lambda line: None,
) -> None:
    """Write a folder of kernels with its index to `out`.

    Args:
        kept: folder for what was compiled before; it is found again by the hash of its code.
        kernels: which (default: those that any scene can begin with).
        targets: of `TARGETS`, what they are compiled for.
        on_progress: is called with what is compiled.
    """
    start_warp()
    targets, tasks = list(targets), []
    entries: dict[str, Any] = {}
    for target in targets:
        (out / target).mkdir(parents=True)
        found = {kernel.module.name: kernel for kernel in kernels or kernels_for(target)}
        tasks += [(kernel, target) for kernel in found.values()]

    def make(kernel: wp.Kernel, target: str) -> None:
        module, architecture = kernel.module, ARCHITECTURES.get(target)
        block_size = block_size_of(kernel) if architecture else 1
        identifier, full_hash = module.get_module_identifier(block_size), module.get_module_hash(block_size).hex()
        version = "nvrtc" if architecture else f"llvm-{compiler_version(target)['llvm']}"
        name = f"{identifier}.{'cubin' if architecture else 'o'}"
        known = kept / wp.config.version / version / target / f"{full_hash}{Path(name).suffix}"
        known_meta = known.with_suffix(".meta")
        if not known.exists() or not known_meta.exists():
            known.parent.mkdir(parents=True, exist_ok=True)
            on_progress(f"compiling {module.name} for {target}")
            source, meta = source_of(module, block_size, architecture)
            with whole_file(known_meta) as half:
                half.write_bytes(meta)
            flags = module.options["cpu_compiler_flags"]
            assert flags is None or isinstance(flags, str)
            compile_source(source, target, known, block_size, flags=flags)
        meta_name = f"{identifier}.meta"
        shutil.copy(known_meta, out / target / meta_name)
        shutil.copy(known, out / target / name)
        entry = entries.setdefault(identifier, {"hash": full_hash, "binaries": {}})
        entry["binaries"][target] = {
            "file": name,
            "sum": digest(known.read_bytes()),
            "meta": meta_name,
            "meta_sum": digest(known_meta.read_bytes()),
        }

    tasks.sort(key=lambda task: not is_general(task[0].module))  # the longest first
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        list(pool.map(make, *zip(*tasks)))
    index = {
        "format": FORMAT,
        "warp": wp.config.version,
        "targets": {target: compiler_version(target) for target in targets},
        "modules": dict(sorted(entries.items())),
    }
    (out / INDEX).write_text(json.dumps(index, indent=1), encoding="utf-8")
    write_for_shipping(out, [module_identity(kernel.module) for kernel, _ in tasks])
