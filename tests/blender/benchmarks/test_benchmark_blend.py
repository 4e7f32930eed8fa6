"""scripts/benchmark.py on a .blend, with Cycles as peer."""

import json

import pytest
from benchmarking.scenes import SceneRequest
from benchmarking.whole_render import RenderRequest, open_scene

from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

from tests.support.blender_builders import add_grid, add_object, material_of, node_tree


@pytest.fixture
def blend(scene, tmp_path):
    """A white floor under a lamp, whose light the file clamps."""
    bpy.context.scene.raybatch.clamp_direct = bpy.context.scene.raybatch.clamp_indirect = 0.01
    tree, surface = node_tree(material_of(add_grid("Floor", 4)))
    tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], surface)
    lamp = bpy.data.lights.new("Lamp", "AREA")
    lamp.energy = 100
    add_object("Lamp", lamp).location = (0, 0, 3)
    path = tmp_path / "floor.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_both_engines_render_the_same_picture_with_about_the_same_noise(blend):
    options = (
        "--device",
        "cpu",
        "--samples",
        "16",
        "--bounces",
        "2",
        "--runs",
        "1",
        "--threads",
        "1",
        "--against",
        "cycles",
        "--equal-error",
        "--json",
    )
    done = call_script("benchmark.py", "render", blend, *options)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["export_s"] > 0 and report["triangles"] == 32
    assert (
        report["cycles"]["device"] == "CPU" and report["cycles"]["seconds"] > 0 and report["raybatch_over_cycles"] > 0
    )
    assert report["settings"]["clamp_direct"] == report["settings"]["clamp_indirect"] == 0
    equal = report["equal_error"]
    assert equal["mean_ratio"] == pytest.approx(1, abs=0.05)
    assert 0 < equal["relmse"]["raybatch"] < 0.1 and 0.1 < equal["relmse"]["raybatch"] / equal["relmse"]["cycles"] < 10
    cost = report["raybatch"]["seconds"] * equal["relmse"]["raybatch"]
    assert equal["raybatch_seconds_to_cycles_error"] == pytest.approx(cost / equal["relmse"]["cycles"], rel=1e-4)
    assert equal["efficiency"]["raybatch"] == pytest.approx(1 / cost, rel=1e-4)


def test_two_sample_counts_separate_set_up_from_sampling_and_a_report_is_not_made_twice(blend, tmp_path):
    kept = tmp_path / "slopes.json"
    options = (
        "--device",
        "cpu",
        "--samples",
        "4,16",
        "--bounces",
        "2",
        "--runs",
        "2",
        "--threads",
        "1",
        "--size",
        "32x24",
    )
    options += ("--against", "cycles", "--json", kept, "--resume")
    done = call_script("benchmark.py", "render", blend, *options)
    assert done.returncode == 0, done.stderr
    report = json.loads(kept.read_text())
    assert report["sample_counts"] == [4, 16] and report["settings"]["clamp_indirect"] == 0
    assert report["peer"] == "CPU" and list(report["cycles"]) == ["CPU"] and report["ray_tracing_cores"] is None
    for engine in (report["raybatch"], report["cycles"]["CPU"]):
        assert engine["runs"] == 2 and engine["first_seconds"] > 0
        least, most = engine["ms_a_sample_least"], engine["ms_a_sample_most"]
        assert least <= engine["ms_a_sample"] <= most
    # the larger count's pictures, of two seeds: the same picture, with noise
    assert report["mean_ratio"] == pytest.approx(1, abs=0.05) and 0 < report["relmse"]["raybatch"] < 0.1
    written = kept.stat().st_mtime_ns
    again = call_script("benchmark.py", "render", blend, *options)
    assert again.returncode == 0 and "measured before" in again.stdout and kept.stat().st_mtime_ns == written


def test_files_are_opened_one_after_another_in_one_process(blend):
    """As a study of several does, and where the add-on is registered already."""
    opened = [open_scene(RenderRequest(SceneRequest(blend), size=(16, 12))) for _ in range(2)]
    assert [each.scene.frame.width for each in opened] == [16, 16]
    assert opened[0].scene.object_names == opened[1].scene.object_names
    assert opened[1].settings.clamp_direct == pytest.approx(0.01)
