"""Renders of the lit scene that work, and those that fail with a message."""

import os

import bpy
import numpy as np
import pytest

from raybatch_addon.blender import reports
from tests.support.blender_builders import material_of, node_tree

BACKGROUND = (0.25, 0.5, 0.75)


def glow(obj):
    """`obj`, emitting white light of radiance 1."""
    tree, surface = node_tree(material_of(obj))
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(emission.outputs[0], surface)
    return obj


def render():
    """Render a scene that is expected to work; returns the warnings."""
    assert bpy.ops.render.render() == {"FINISHED"}
    assert reports.last().errors == []
    return reports.last().warnings


def assert_picture(film):
    """Assert that the picture shows the lamp before the world, and nothing else, and that all is finite."""
    picture = film.passes["Combined"]
    assert film.complete and film.statistics["invalid_samples"] == 0
    assert np.isfinite(picture).all()
    assert picture[12, 16, :3] == pytest.approx([1, 1, 1])
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert picture[corner][:3] == pytest.approx(BACKGROUND, rel=1e-5)


def assert_fails(tmp_path, *words):
    """Assert that a render to files ends with an error whose one line has all `words`, and leaves no file."""
    scene = bpy.context.scene
    scene.render.filepath = str(tmp_path / "never")
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.render.render(write_still=True)
    (line,) = reports.last().errors
    assert line in str(caught.value) and "\n" not in line
    assert all(word in line for word in words), line
    assert os.listdir(tmp_path) == []
    assert "Traceback" not in line and "Error:" not in line, "a sentence for the user, not the name of an exception"
