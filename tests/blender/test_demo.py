"""The demo scene, made by its script and rendered whole."""

import json

import numpy as np
import pytest

from tests.support.command_line import run_script
from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The demo's .blend."""
    path = tmp_path_factory.mktemp("demo") / "demo.blend"
    done = run_script("make_demo.py", path)
    assert done.returncode == 0, done.stderr
    assert [entry.name for entry in path.parent.iterdir()] == ["demo.blend"]
    return path


def test_it_shows_what_the_engine_can_do(demo, addon):
    bpy.ops.wm.open_mainfile(filepath=str(demo))
    scene = bpy.context.scene
    modifiers = {modifier.type for thing in scene.objects for modifier in thing.modifiers}
    nodes = {node.bl_idname for material in bpy.data.materials for node in material.node_tree.nodes}
    assert scene.render.engine == "RAYBATCH"
    assert {"BEVEL", "SUBSURF", "ARRAY"} <= modifiers
    assert sum(thing.instance_type == "COLLECTION" for thing in scene.objects) >= 10
    assert {"ShaderNodeBsdfPrincipled", "ShaderNodeBsdfGlass", "ShaderNodeEmission", "ShaderNodeMixShader"} <= nodes
    assert {light.type for light in bpy.data.lights} == {"AREA"}
    assert "Suzanne" in scene.objects
    assert scene.camera.data.dof.use_dof
    assert (scene.render.resolution_x, scene.render.resolution_y) == (960, 540)


def test_it_renders_whole_and_without_a_warning(demo, tmp_path):
    film, statistics = tmp_path / "film.npz", tmp_path / "film.json"
    done = call_script(
        "render.py",
        demo,
        "--film",
        film,
        "--json",
        statistics,
        "--device",
        "cpu",
        "--set",
        "resolution=96x54",
        "--set",
        "sample_count=4",
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(statistics.read_text())
    assert report["warnings"] == []
    assert report["invalid_samples"] == 0
    assert not {
        "closure glass",
        "closure metal",
        "depth of field",
        "light rectangle",
        "mesh lights",
        "instancing",
    } & set(report["left_out"])
    with np.load(film) as passes:
        color = passes["Combined"][..., :3]
    assert np.isfinite(color).all() and (color >= 0).all()
    assert 0.05 < color.mean() < 2
    ring = color[49:51, 40:55].reshape(-1, 3)  # the ring of light crosses the top: far brighter in red than in blue
    assert ring[:, 0].max() > 2 * ring[:, 2].max() and ring[:, 0].max() > 1
