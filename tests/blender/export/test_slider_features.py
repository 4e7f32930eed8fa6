"""Which sliders change a scene's features, so that other kernels are specialised on it; general ones hold them all."""

import re
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.features import SceneFeatures, derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.kernels import StageKernels
from raybatch_addon.core.wavefront.tier import why_not_general
from raybatch_addon.export.scene import export_scene
from tests.support.blender_builders import add_triangle, node_tree

PAGE = Path(__file__).resolve().parents[3] / "docs/architecture.md"
SETTINGS = RenderSettings()
VALUES = (0.0, 0.3, 1.0)  # that a slider is moved to
NAMED = re.compile(r"\*([A-Z][A-Za-z ]+)\*")  # sockets, as the page names them


def features_now() -> SceneFeatures:
    exported = export_scene(bpy.context.evaluated_depsgraph_get())
    return derive_features(prepared_scene(exported, SETTINGS), SETTINGS)


def moved(socket, value: float):
    """The value of `socket` where its slider, or the last of them, is at `value`."""
    if socket.type == "RGBA":
        return (value, value / 2, value / 2, 1.0)
    return {"VALUE": value, "VECTOR": (value,) * 3, "BOOLEAN": value > 0}[socket.type]


def sliders_that_change(node) -> set[str]:
    """The inputs of `node` whose values alone ask for other specialised kernels; general ones hold all of them."""
    device, found = find_device("cpu"), set()
    before = StageKernels.choose(features_now(), device).that_shade()
    for socket in (each for each in node.inputs if not each.hide_value and not each.is_linked):
        old = socket.default_value if socket.type in ("VALUE", "BOOLEAN") else tuple(socket.default_value)
        for value in VALUES:
            socket.default_value = moved(socket, value)
            features = features_now()
            assert why_not_general(features, device) == "", socket.name
            if StageKernels.choose(features, device).that_shade() != before:
                found.add(socket.name)
        socket.default_value = old
    return found


@pytest.fixture
def node(scene):
    """The Principled BSDF of the only material."""
    material = bpy.data.materials.new("Moved")
    tree, surface = node_tree(material)
    node = tree.nodes.new("ShaderNodeBsdfPrincipled")
    tree.links.new(node.outputs[0], surface)
    add_triangle("Flat").data.materials.append(material)
    return node


def test_the_page_lists_the_sliders_that_change_kernels(node):
    """Those of a material that is a program, and those of constants alone beside them."""
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    (listed,) = re.findall(r"Of Principled's sliders these change kernels: (.*?)\.", page)
    (of_constants,) = re.findall(r"in a material of constants alone, (.*?)\.", page)
    constant = sliders_that_change(node)
    tree = node.id_data
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs["Color"], node.inputs["Base Color"])
    program = sliders_that_change(node)
    there = {socket.name for socket in node.inputs}  # Blender 4.5 has fewer
    assert set(NAMED.findall(listed)) & there == program
    assert set(NAMED.findall(of_constants)) & there == constant - program
