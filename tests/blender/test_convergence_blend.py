"""scripts/convergence.py on a .blend, with Cycles as peer."""

import json

import pytest

from tests.support.command_line import error_line, run_script
from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

import warp as wp
from benchmarking.whole_render import OpenedScene
from converging.cycles import open_peer

from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.blender_builders import add_grid, add_object, material_of, node_tree

OPTIONS = ("--device", "cpu", "--size", "24x24", "--runs", "1", "--no-flip", "--set", "thread_count=1")


@pytest.fixture
def blend(scene, tmp_path):
    """A white floor, and a wall that it lights, under a lamp, with settings that make Cycles show another picture."""
    for turn in (0, 1.0):
        tree, surface = node_tree(material_of(wall := add_grid("Wall", 4)))
        wall.rotation_euler[1] = turn
        tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], surface)
    scene.cycles.film_exposure, scene.cycles.use_fast_gi, scene.cycles.use_denoising = 2, True, True
    scene.view_layers.new("Another")
    scene.view_layers[0].samples = 1
    lamp = bpy.data.lights.new("Lamp", "AREA")
    lamp.energy = 100
    add_object("Lamp", lamp).location = (0, 0, 3)
    scene.raybatch.bounce_max = 2
    path = tmp_path / "floor.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_cycles_competes_at_its_own_samples(blend, tmp_path):
    options = (
        *OPTIONS,
        "--against",
        "cycles",
        "--samples",
        "16",
        "--reference-samples",
        "512",
        "--json",
        "--html",
        tmp_path / "page.html",
    )
    done = call_script("convergence.py", blend, *options, RAYBATCH_REFERENCES=tmp_path / "kept")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    ours, theirs = report["runs"]
    assert (ours["engine"], theirs["engine"], theirs["settings"]) == ("RayBatch", "Cycles", {"engine": "Cycles"})
    assert [point["samples"] for point in theirs["points"]] == [1, 2, 4, 8, 16]
    assert all(0 <= point["seconds"] <= point["seconds_total"] and point["rays"] is None for point in theirs["points"])
    for run in report["runs"]:
        assert run["points"][-1]["rmse"] < run["points"][0]["rmse"] and run["slope"] < 0
    assert [each["kind"] for each in report["references"]] == ["raybatch", "cycles"]
    assert all(each["samples"] == 512 and each["noise_floor"]["rmse"] > 0 for each in report["references"])
    # both engines aim at the same picture: their difference is noise
    apart = report["references_apart"]
    assert apart["rmse"] < 2 * apart["noise_rmse"] and apart["mean_ratio"] == pytest.approx(1, abs=0.01)
    assert len(report["summary"]) == 2 and report["summary"][1]["efficiency_relative"]["median"] > 0
    assert "Reference: Cycles" in (tmp_path / "page.html").read_text(encoding="utf-8")

    # either may be measured against Cycles' picture, which is kept
    options = (
        *OPTIONS,
        "--against",
        "cycles",
        "--reference",
        "cycles",
        "--reference-samples",
        "512",
        "--seconds",
        "0.3",
        "--json",
    )
    done = call_script("convergence.py", blend, *options, RAYBATCH_REFERENCES=tmp_path / "kept")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    (only,) = report["references"]
    assert only["kind"] == "cycles" and only["from_cache"] and report["references_apart"] is None
    samples = [[point["samples"] for point in run["points"]] for run in report["runs"]]
    assert all(each[0] == 1 and each == sorted(set(each)) for each in samples)


def test_cycles_renders_as_it_was_asked_to_after_references_for_others(blend, tmp_path):
    """Cycles' own reference is that of bounce_max=2, and that without bounces is made after it."""
    options = (
        *OPTIONS,
        "--against",
        "cycles",
        "--reference",
        "cycles",
        "--compare",
        "bounce_max=2,0",
        "--samples",
        "256",
        "--reference-samples",
        "4096",
    )
    done = call_script("convergence.py", blend, *options, "--json", RAYBATCH_REFERENCES=tmp_path / "kept")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    ours, _, theirs = report["summary"]
    assert [each["settings"]["bounce_max"] for each in report["references"]] == [2, 0]
    # at equal samples the two are about as noisy; the light of bounces is many times their noise
    assert theirs["end"]["rmse"] < 2 * ours["end"]["rmse"]


def test_cycles_renders_the_picture_alone(scene):
    """RayBatch renders the picture alone too: other work that a file asks for would count as Cycles' time."""
    layer = scene.view_layers[0]
    layer.use_pass_normal = layer.use_pass_cryptomatte_object = layer.cycles.denoising_store_passes = (
        scene.render.use_compositing
    ) = True
    another = scene.view_layers.new("Another")
    open_peer(OpenedScene("a.blend", None, RenderSettings(), scene), wp.get_device("cpu"), RenderSettings(bounce_max=3))
    assert not (
        layer.use_pass_normal
        or layer.use_pass_cryptomatte_object
        or layer.cycles.denoising_store_passes
        or scene.render.use_compositing
    )
    assert layer.use_pass_combined and layer.use and not another.use and scene.cycles.max_bounces == 3


def test_a_set_up_time_that_is_unknown_is_reported(blend, tmp_path):
    """A time from one render would look slower than it is."""
    done = run_script(
        "convergence.py",
        blend,
        *OPTIONS,
        "--against",
        "cycles",
        "--samples",
        "1",
        "--json",
        RAYBATCH_REFERENCES=tmp_path / "kept",
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert any(note.startswith("Cycles: its renders are too short") for note in report["notes"])
    ((only,),) = [run["points"] for run in report["runs"] if run["engine"] == "Cycles"]
    assert only["seconds"] == only["seconds_total"]


def test_a_blend_that_cannot_be_opened_is_one_line(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"no blend")
    line = error_line(
        call_script("convergence.py", tmp_path / "a.blend", "--device", "cpu", "--html", tmp_path / "new/page.html")
    )
    assert "a.blend is not a .blend file" in line and not (tmp_path / "new").exists()


def test_cycles_knows_no_halves(blend):
    line = error_line(call_script("convergence.py", blend, *OPTIONS, "--against", "cycles", "--reference", "halves"))
    assert "choose another for --against cycles" in line
