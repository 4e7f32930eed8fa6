"""Write the tables of shader nodes in docs/nodes.md: python scripts/tables/nodes_table.py [--check]

They are made from the registry of handlers (raybatch_addon/export/nodes), with the names that Blender's module bpy has
for the nodes. All nodes that Blender lets into a shader graph are listed: those that are followed rather than rendered,
and those that RayBatch does not have, too. With --check nothing is written, and the exit code is 1 where the file is
not up to date.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import bpy

from raybatch_addon.export import nodes  # noqa: F401  (registers handlers)
from raybatch_addon.export.nodes.registry import Handled, shader_nodes, value_nodes
from tables.marked_text import with_part, wrapped, write_or_check

MANUAL = ROOT / "docs/nodes.md"
FIRST, LAST = "<!-- nodes: made by scripts/tables/nodes_table.py -->", "<!-- end of nodes -->"
# Nodes that need no handler, and what becomes of them
FOLLOWED = {
    "The graph starts here": ("ShaderNodeOutputMaterial", "ShaderNodeOutputWorld", "ShaderNodeOutputLight"),
    "Followed to what is linked to them": (
        "ShaderNodeGroup",
        "ShaderNodeCustomGroup",
        "NodeGroupInput",
        "NodeGroupOutput",
        "NodeReroute",
    ),
    "From Blender 5.0 on, Blender has them gone before a graph is read": (
        "GeometryNodeRepeatInput",
        "GeometryNodeRepeatOutput",
        "NodeClosureInput",
        "NodeClosureOutput",
        "NodeEvaluateClosure",
        "NodeCombineBundle",
        "NodeSeparateBundle",
        "NodeJoinBundle",
        "GeometryNodeMenuSwitch",
        "FunctionNodeInputMenu",
        "NodeImplicitConversion",
    ),
    "What is linked to it goes to a pass of the view layer; in materials": ("ShaderNodeOutputAOV",),
    "Left out: lines": ("ShaderNodeOutputLineStyle",),
}
_NOTHING = ("NodeFrame",)  # has no sockets
_BASES = {"ShaderNode", "ShaderNodeTree", "ShaderNodeCustomGroup"}  # of classes, not kinds of nodes


def blender_nodes() -> dict[str, str]:
    """Names in Blender's menus of all nodes that this Blender lets into shader graphs, by `bl_idname`."""
    tree = bpy.data.node_groups.new("Shader nodes", "ShaderNodeTree")
    names = {}
    for name in dir(bpy.types):
        kind = getattr(bpy.types, name)
        if name in _BASES or name in _NOTHING or not isinstance(kind, type) or not issubclass(kind, bpy.types.Node):
            continue
        try:
            names[name] = tree.nodes.new(name).bl_rna.name
        except RuntimeError:  # it belongs into other graphs
            if name.startswith("ShaderNode"):  # into graphs of materials, worlds or lights, but into no group
                names[name] = getattr(bpy.types, name).bl_rna.name
    bpy.data.node_groups.remove(tree)
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
    lines += ["### Followed", "", "| nodes | what becomes of them |", "|---|---|"]
    names["ShaderNodeCustomGroup"] = "groups of add-ons"
    for what, kinds in FOLLOWED.items():
        lines.append(f"| {', '.join(names.pop(name, name) for name in kinds)} | {what} |")
    lines.append("")
    missing = sorted(label for name, label in names.items() if name not in known)
    lines += ["### Not supported", ""]
    lines += wrapped(f"A warning names each of these, its material and its objects: {', '.join(missing)}.")
    return "\n".join(lines)


def updated(text: str) -> str:
    """The manual `text` with the tables as they are now; raises `ValueError` where a mark is missing."""
    return with_part(text, FIRST, LAST, tables(), MANUAL)


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(MANUAL, updated, "scripts/tables/nodes_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
