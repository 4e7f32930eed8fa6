"""scripts/benchmark.py animation and previews: what is measured through Blender."""

import json

import pytest

from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

from benchmarking.in_blender.animation import FRAME_PARTS, times
from benchmarking.in_blender.moving_scene import SIZES, SceneSize, make_moving_scene
from benchmarking.in_blender.previews import KINDS

from raybatch_addon.blender import preview

OPTIONS = ("--device", "cpu", "--samples", 1, "--set", "resolution=16x12", "--json")


def test_frames_of_an_animation_are_timed_by_their_parts(monkeypatch, addon):
    monkeypatch.setitem(SIZES, "small", SceneSize(edge=4, waves=3))
    done = call_script("benchmark.py", "animation", "--size", "small", "--frames", 20, *OPTIONS)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["frames"], report["samples_per_pixel"]) == (20, 1)
    assert report["triangles"] == SceneSize(edge=4, waves=3).triangles
    assert [report["frame"][name] for name in ("width", "height")] == [16, 12]
    for part in FRAME_PARTS:
        assert 0 < report["seconds"][part]["median"] < report["seconds"][part]["sum"]
    spent = {part: report["seconds"][part]["sum"] for part in FRAME_PARTS}
    assert spent["export"] + spent["build"] + spent["render"] < spent["raybatch"]
    assert spent["raybatch"] + spent["evaluation"] < spent["whole"]
    # what moves and waves is followed: nothing is built after the first frame
    assert report["trees"]["built"] == 0 and report["trees"]["refitted"] >= 19
    assert [each["after_frames"] for each in report["resident"]] == list(range(2, 21, 2))
    assert all(each["mib"] > 1 for each in report["resident"])


def test_a_file_is_measured_from_its_first_frame_on(tmp_path, scene):
    make_moving_scene(SceneSize(edge=4), 30)
    bpy.context.scene.frame_start = 7
    path = tmp_path / "flight.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    done = call_script("benchmark.py", "animation", path, "--frames", 2, *OPTIONS)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["scene"], report["frame_first"], report["frames"]) == ("flight.blend", 7, 2)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["flight.blend"], "pictures are not left"


def test_a_frame_that_fails_ends_the_benchmark(tmp_path, scene):
    scene.camera.scale.x = 0.0
    path = tmp_path / "flat.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    done = call_script("benchmark.py", "animation", path, "--frames", 2, *OPTIONS)
    assert done.returncode == 1 and "Camera" in done.stderr and not done.stdout


def test_shares_are_of_the_whole_time():
    def frame(export, build, whole):
        return dict.fromkeys(FRAME_PARTS, 0.0) | {"export": export, "build": build, "whole": whole}

    found = times([frame(1.0, 2.0, 4.0), frame(0.0, 0.25, 1.0), frame(0.25, 0.0, 1.0)])
    assert found["export_and_build_share"] == round(3.5 / 6, 4)
    assert found["export_and_build_share_after_first"] == 0.25
    assert found["first_frame"]["export"] == 1.0 and found["seconds"]["export"] == {"median": 0.125, "sum": 1.25}


def test_the_sizes_are_what_they_are_called():
    assert SIZES["large"].triangles == pytest.approx(1_000_000, rel=0.01)
    make_moving_scene(SceneSize(edge=3, waves=2), 5)
    found = 0
    for each in bpy.data.meshes:
        each.calc_loop_triangles()
        found += len(each.loop_triangles)
    assert found == SceneSize(edge=3, waves=2).triangles


def test_previews_are_timed_by_kind(monkeypatch, addon):
    monkeypatch.setattr(preview, "PREVIEW_SETTINGS", preview.PREVIEW_SETTINGS.replace(sample_count=2, time_limit=0.0))
    done = call_script("benchmark.py", "previews", "--runs", 2, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert [each["of"] for each in report["previews"]] == list(KINDS)
    assert all(0 < each["median"] <= each["most"] and each["runs"] == 2 for each in report["previews"])
    assert report["device"] == "cpu" and min(report["previews"][0]["pixels"]) > 0


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("animation", "--frames", 0), "--frames 0 is not valid"),
        (("animation", "nowhere.blend"), "nowhere.blend cannot be measured"),
        (("animation", "--device", "cuda:99"), "cuda:99"),
        (("previews", "--runs", 0), "--runs 0 is not valid"),
        (("previews", "--set", "seed=3"), "settings of their own"),
    ],
)
def test_what_cannot_be_measured_is_one_clear_line(addon, arguments, message):
    done = call_script("benchmark.py", *arguments)
    assert done.returncode == 1 and message in done.stderr and "Traceback" not in done.stderr
