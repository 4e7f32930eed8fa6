"""The C++ of a native function, put together from headers.

`wp.func_native` takes the body of one function as a string, and all native functions of a Warp module land in one C++
file. So each header holds statements: constants, structs and lambdas that the headers behind it use, or the work
itself. What a function is specialised on comes as macros, which end with it. Warp hashes the whole text, headers
included, so a kernel is compiled again when one of its headers changes.
"""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path

FOLDER = Path(__file__).parent
_MACRO = re.compile(r"^\s*#\s*define\s+(\w+)", re.MULTILINE)


def native_source(
    *headers: str, device: str = "", beside: Path | None = None, **defines: bool | int | float | str
) -> str:
    """The body of a native function: the files `headers` of this folder, one behind another, with `defines` as macros.

    Compilers name the header and its line in their messages. No macro is left behind, nor one that a header defines.

    Args:
        headers: names such as "math/vectors.h".
        device: "cpu" or "cuda" leaves the function empty on the other one; "" is for headers that know both.
        beside: a folder in which headers are looked for first, of code outside of the core.
        defines: values by name. A float becomes a float32 literal, a bool 1 or 0; a str stays as it is.
    """
    texts = [(header, _read(header, beside)) for header in headers]
    macros = [*defines, *(name for _, text in texts for name in _MACRO.findall(text) if name not in defines)]
    lines = [f"#define {name} {_literal(value)}" for name, value in defines.items()]
    for header, text in texts:
        lines += [f'#line 1 "raybatch native: {header}"', text.rstrip("\n")]
    lines += ['#line 1 "raybatch native: end"', *(f"#undef {name}" for name in dict.fromkeys(macros))]
    if device:
        lines = [f"#if {'!' if device == 'cpu' else ''}defined(__CUDA_ARCH__)", *lines, "#endif"]
    return "\n" + "\n".join(lines) + "\n"


@functools.cache
def _read(header: str, beside: Path | None) -> str:
    own = beside and beside / header
    return (own if own and own.is_file() else FOLDER / header).read_text(encoding="utf-8")


def _literal(value: bool | int | float | str) -> str:
    """`value` as C++ spells it."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} has no literal in C++")
        text = f"{value.hex()}f"
    else:
        text = str(int(value))
    return f"({text})" if value < 0 else text
