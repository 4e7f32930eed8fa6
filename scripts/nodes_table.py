"""Write the tables of shader nodes in docs/nodes.md: python scripts/nodes_table.py [--check]

They are made from the registry of handlers (raybatch_addon/export/nodes), with the names that Blender's module bpy has for the nodes; nodes
that Blender has and RayBatch does not are listed too. With --check nothing is written, and the exit code is 1 where the file is not up to date.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import bpy

from marked_text import with_part
from raybatch_addon.export import nodes  # noqa: F401  (registers handlers)
from raybatch_addon.export.nodes.registry import Handled, shader_nodes, value_nodes

MANUAL = ROOT / "docs/nodes.md"
FIRST, LAST = "<!-- nodes: made by scripts/nodes_table.py -->", "<!-- end of nodes -->"
# Nodes that are followed rather than rendered, those of other engines and of no engine
_OUTPUTS = re.compile(r"ShaderNode(Output|Custom|Tree|Group|Script|EeveeSpecular|ShaderToRGB)")


def blender_nodes() -> dict[str, str]:
    """Names in Blender's menus of all shader nodes that this Blender has, by `bl_idname`."""
    names = {}
    for name in dir(bpy.types):
        if name.startswith("ShaderNode") and name != "ShaderNode" and not _OUTPUTS.match(name):
            names[name] = getattr(bpy.types, name).bl_rna.name
    return names


def tables() -> str:
    """A table for each family, and the list of what is not supported."""
    known: dict[str, Handled] = {**value_nodes, **shader_nodes}
    names = blender_nodes()
    lines = []
    for family in sorted({handled.family for handled in known.values()}):
        lines += [f"### {family}", "", "| node | `bl_idname` | approximated or left out |", "|---|---|---|"]
        mine = sorted((names.get(name, name), name) for name, handled in known.items() if handled.family == family)
        lines += [f"| {label} | `{name}` | {known[name].note} |" for label, name in mine]
        lines.append("")
    missing = sorted(label for name, label in names.items() if name not in known)
    lines += ["### Not supported", "", "A warning names each of these, its material and its objects: " + ", ".join(missing) + "."]
    return "\n".join(lines)


def updated(text: str) -> str:
    """The manual `text` with the tables as they are now; raises `ValueError` where a mark is missing."""
    return with_part(text, FIRST, LAST, tables(), MANUAL)


def main(arguments: list[str]) -> int:
    """The exit code."""
    text = MANUAL.read_text(encoding="utf-8")
    new = updated(text)
    if "--check" in arguments:
        if new != text:
            print(f"{MANUAL} is not up to date: run python scripts/nodes_table.py", file=sys.stderr)
        return int(new != text)
    MANUAL.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
