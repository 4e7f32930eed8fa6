"""The list of shader nodes is generated from their handlers."""

import pytest

bpy = pytest.importorskip("bpy")

from tables import nodes_table

from raybatch_addon.export.nodes.registry import shader_nodes, value_nodes

NEWEST = pytest.mark.skipif(bpy.app.version < (5, 2), reason="the list is that of Blender 5.2")


@NEWEST
def test_the_manual_is_up_to_date():
    assert nodes_table.main(["--check"]) == 0, "run python scripts/tables/nodes_table.py"


@NEWEST
def test_every_node_that_is_understood_is_one_of_blender():
    old = {
        "ShaderNodeCombineHSV",
        "ShaderNodeCombineRGB",
        "ShaderNodeSeparateHSV",
        "ShaderNodeSeparateRGB",
        "ShaderNodeMixRGB",
    }
    assert {*value_nodes, *shader_nodes} - old <= set(nodes_table.blender_nodes())


def test_every_node_is_listed_once():
    text = nodes_table.tables()
    for name in (*value_nodes, *shader_nodes):
        assert text.count(f"| `{name}` |") == 1
