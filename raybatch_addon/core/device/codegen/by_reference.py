"""Structs that functions take by reference, where a compiler leaves these functions out of line.

Warp passes structs by value. The scene's are some thousand bytes of arrays, so that each call which is left copies as
many. In modules of `OUT_OF_LINE_OPTIONS` a function takes its structs by reference instead, but for those that it
writes to, which stay its own copies. Nothing else writes to them while it runs, and the compiler is informed of it.
"""

from __future__ import annotations

import re
from typing import Any

import warp as wp

from ..kernel import OUT_OF_LINE_OPTIONS

_codegen = wp._src.codegen
# A pointer into what a name stands for, as in `var_3 = &(var_point.frame);` and `var_4 = wp::indexref(var_3, var_2);`
_POINTER = re.compile(r"(var_\w+) = (?:&\(*|wp::indexref\()(var_\w+)\b")
# What a line writes to, as in `var_point.normal = var_5;` and `wp::store(var_4, var_6);`
_WRITTEN = re.compile(
    r"(?:^|[{}\s])\(*(var_\w+)\)?(?:(?:\.|->)\w+)+ = |wp::\w*(?:assign|store|inplace|atomic)\w*\((var_\w+)"
)


def pass_structs_by_reference() -> None:
    """Let Warp write functions of such modules so for CPUs from now on; called after `wp.init`."""
    within = _codegen.codegen_func
    if getattr(within, "is_by_reference", False):
        return
    flags = OUT_OF_LINE_OPTIONS["cpu_compiler_flags"]

    def codegen_func(adj: Any, *arguments: Any, device: str = "cpu", options: dict | None = None, **others: Any) -> str:
        source = within(adj, *arguments, device=device, options=options, **others)
        if device != "cpu" or (options or {}).get("cpu_compiler_flags") != flags:
            return source
        taken = {arg.emit(): arg.ctype() for arg in adj.args if isinstance(arg.type, _codegen.Struct)}
        return by_reference(source, taken)

    codegen_func.is_by_reference = True
    _codegen.codegen_func = codegen_func


def by_reference(source: str, taken: dict[str, str]) -> str:
    """`source`, Warp's C++ of one function, with its arguments `taken` (name -> type) by reference.

    Those that it writes to stay as they are. Its callers give each argument as a variable.
    """
    written = _written(source, set(taken))
    for name, ctype in taken.items():
        if name not in written:
            header = re.compile(rf"^(\s*{re.escape(ctype)}) ({re.escape(name)}[,)])", re.MULTILINE)
            source = header.sub(r"\1 & __restrict \2", source)
    return source


def _written(source: str, names: set[str]) -> set[str]:
    """The `names` whose members a line of `source` writes to, by name or by a pointer."""
    of = {name: name for name in names}  # pointer -> the name whose members it points into
    written = set()
    for line in source.splitlines():
        if (found := _POINTER.search(line)) and found[2] in of:
            of[found[1]] = of[found[2]]
        for match in _WRITTEN.finditer(line):
            if (target := match[1] or match[2]) in of:
                written.add(of[target])
    return written
