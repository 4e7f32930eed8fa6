"""Local arrays of kernels, set to zero once or not at all.

Warp sets an array that a function declares with `wp.zeros` to zero where it is declared, makes another one where it is
assigned, and copies that. A GPU keeps such arrays in memory, and among a thousand threads a processor no cache holds
them: a hit with a few hundred bytes of closures waits for this longer than for its shading. In the kernels of the core
an array is declared without values, and is set to zero once, where it is assigned; an array of `Unset` is not. Where
Warp should write its code another way, arrays are set to zero as Warp does.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import warp as wp

from ..kernel import OUR_FLAGS

_codegen = wp._src.codegen
_DECLARED = re.compile(r"^([ \t]*)wp::fixedarray_t<(\d+), ([\w:]+)> (var_\w+);$", re.MULTILINE)
# What elements of `Unset` are filled with: nothing, or by tests a pattern that shows where one is read before it is
# written
fill_unset: str = ""


@wp.struct
class Unset:
    """Four bytes of a local array which hold whatever the memory held: each is written before it is read."""

    value: float


def set_local_arrays_once() -> None:
    """Let Warp write kernels of the core so from now on; called after `wp.init`."""
    for name in ("codegen_func", "codegen_kernel"):
        within = getattr(_codegen, name)
        if not getattr(within, "sets_once", False):
            setattr(_codegen, name, _wrapped(within))


def _wrapped(within: Callable[..., str]) -> Callable[..., str]:
    def codegen(*arguments: Any, **others: Any) -> str:
        source = within(*arguments, **others)
        options = others.get("options") or next((each for each in arguments if isinstance(each, dict)), {})
        return set_once(source, fill_unset) if options.get("cpu_compiler_flags") in OUR_FLAGS else source

    codegen.sets_once = True
    return codegen


def set_once(source: str, fill: str = "") -> str:
    """`source`, Warp's C++ of a function or kernel, with local arrays that are set to zero once, or hold `fill`, a
    float, where they are of `Unset` (default: what the memory held).
    """
    for indent, count, ctype, name in _DECLARED.findall(source):
        declared = f"{indent}wp::fixedarray_t<{count}, {ctype}> {name};\n"
        assigned = re.compile(rf"^([ \t]*){name} = wp::fixedarray_t<{count}, {re.escape(ctype)}>\(var_\w+\);\n", re.M)
        # an array that is assigned elsewhere, too, or chosen among several, stays one that can be copied
        copied = re.compile(rf"wp::(?:assign|copy|where)\([^;]*\b{name}\b|= {name};")
        if source.count(declared) != 1 or len(assigned.findall(source)) != 1 or copied.search(source):
            continue
        storage = f"{name}_storage"
        source = source.replace(
            declared,
            f"{indent}alignas(16) unsigned char {storage}[{count} * sizeof({ctype})];\n"
            f"{indent}wp::array_t<{ctype}> {name}(reinterpret_cast<{ctype}*>({storage}), {count});\n",
        )
        value = f"{ctype}()"
        if ctype.startswith(f"{Unset.key}_"):
            value = f"{ctype}({fill})" if fill else ""
        loop = rf"\1for (int k = 0; k < {count}; ++k) {name}.data[k] = {value};\n" if value else ""
        source = assigned.sub(loop, source)
    return source
