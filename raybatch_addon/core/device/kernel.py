"""How every kernel of the core is compiled."""

import os
import weakref
import zlib
from typing import Any

import warp as wp

from ..errors import SettingsError
from .declared import shared_module, unique_options

# The way in which Warp is made to write code (`codegen/`), by number: it is part of the flags, and so of the names by
# which compiled kernels are kept, so that none is found that was written in another way
CODE_VERSION = 1


def _cpu_flags(inline_threshold: int) -> str:
    """Flags of Clang, which inlines what it finds to cost no more than the threshold."""
    code = f"-DRAYBATCH_CODE={CODE_VERSION}"
    return f"-march=native -mllvm=-inline-threshold={inline_threshold} -Wno-constant-conversion {code}"


# Fused multiply-adds and fast math would make results depend on the compiler's choices, and adjoints
# are never needed. A kernel with `module="unique"` ignores its file's `set_module_options`, so each
# kernel is declared as `@wp.kernel(**KERNEL_OPTIONS)`; a test looks at every loaded module.
# On the CPU every function is inlined but those that are out of line by name, and in `OUT_OF_LINE_OPTIONS`: Warp passes
# structs of arrays by value, and each call that is left copies some thousand bytes.
MODULE_OPTIONS: dict[str, Any] = {
    "enable_backward": False,
    "fuse_fp": False,
    "fast_math": False,
    "cpu_compiler_flags": _cpu_flags(1_000_000),
}
KERNEL_OPTIONS: dict[str, Any] = unique_options(MODULE_OPTIONS)

# Large modules of the general tier: the compiler inlines what it finds worth it, and functions take structs by
# reference (`codegen/by_reference.py`). They compile in a third to two thirds of the time. Kernels of surfaces alone
# render as fast as inlined; where all stages are one kernel, surfaces are 5 to 8 % slower, and volumes a quarter.
OUT_OF_LINE_OPTIONS: dict[str, Any] = {**MODULE_OPTIONS, "cpu_compiler_flags": _cpu_flags(1000)}
OUT_OF_LINE_KERNEL_OPTIONS: dict[str, Any] = unique_options(OUT_OF_LINE_OPTIONS)
# By these modules of the core are known
OUR_FLAGS = {each["cpu_compiler_flags"] for each in (MODULE_OPTIONS, OUT_OF_LINE_OPTIONS)}

# Environment variables for who compiles much and renders little. On a CPU no bit of a film depends on them.
# OUT_OF_LINE says that specialised kernels of stages, volumes and estimates are compiled as large modules of the
# general tier are. By default they are INLINED, and most render faster so.
SPECIALISED_CODE = "RAYBATCH_SPECIALISED_CODE"
_CODES = ("INLINED", "OUT_OF_LINE")
# How much compilers optimise every kernel. By default it is 2 for CPUs and 3 for CUDA devices, as Warp has it.
OPTIMISATION = "RAYBATCH_OPTIMISATION"
_LEVELS = ("0", "1", "2", "3")

# Kernels of the general tier: each has a module, in which the interpreter of programs is one function and each op is
# another, out of line.
GENERAL_MODULE = "raybatch_general"

_BLOCK_SIZES: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()
DEFAULT_BLOCK_SIZE = 256  # threads of a CUDA block where a kernel does not ask for another


def general_options(name: str, of: tuple[str, ...]) -> dict[str, Any]:
    """Arguments of `wp.kernel` for the kernel `name` of the general tier.

    `of`: what sets it apart from others of that name, such as those for other devices: the ops of its programs. Each
    kernel has a module of its own, since a module's hash, by which it is found, is that of all kernels that it happens
    to have.
    """
    own = f"{GENERAL_MODULE}_{name}_{zlib.crc32(' '.join(of).encode()):08x}"
    return {"module": shared_module(own, OUT_OF_LINE_OPTIONS), "enable_backward": False}


def kernel_options(out_of_line: bool) -> dict[str, Any]:
    """Arguments of `wp.kernel` for a kernel of its own, inlined for a CPU or not."""
    return OUT_OF_LINE_KERNEL_OPTIONS if out_of_line else KERNEL_OPTIONS


def specialised_out_of_line() -> bool:
    """Whether the environment asks for specialised kernels that compile sooner. Raises `SettingsError`."""
    return _asked(SPECIALISED_CODE, _CODES) == "OUT_OF_LINE"


def optimisation_level() -> int | None:
    """How much the environment asks compilers to optimise, 0 to 3; None where it does not. Raises `SettingsError`."""
    asked = _asked(OPTIMISATION, _LEVELS)
    return int(asked) if asked else None


def _asked(variable: str, values: tuple[str, ...]) -> str:
    """One of `values`, or nothing."""
    asked = os.environ.get(variable, "")
    if asked and asked not in values:
        raise SettingsError(f"{variable} is {asked!r}; set it to one of {', '.join(values)}, or not at all")
    return asked


def is_general(module: wp.Module) -> bool:
    """Whether `module` belongs to the general tier."""
    return module.name.startswith(GENERAL_MODULE)


def with_block_size(kernel, threads: int):
    """`kernel`, which will be launched on CUDA with blocks of `threads`: it is compiled for that."""
    _BLOCK_SIZES[kernel] = threads
    return kernel


def block_size_of(kernel) -> int:
    """Threads of a CUDA block of `kernel`."""
    return _BLOCK_SIZES.get(kernel, DEFAULT_BLOCK_SIZE)
