"""scripts/benchmark.py render: whole renders, beside the same with a part of the geometry on the device."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import benchmark
import numpy as np
import pytest
from benchmarking import recording
from benchmarking.against import films, memory
from benchmarking.render import equal_error, measured_settings, with_counts
from benchmarking.scenes import SceneRequest
from benchmarking.slopes import Timed, relmse_of_pairs
from benchmarking.tables import render_text, slopes_text
from benchmarking.whole_render import RenderRequest
from lib.films import differing_passes

from raybatch_addon.core.convergence.errors import RELMSE_MOST
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.benchmark_scenes import assert_one_error, bowl, save_bowl
from tests.support.command_line import HIDE_BPY, run_script

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.fixture(scope="module")
def geometry(tmp_path_factory) -> Path:
    """The bowl as a NumPy archive."""
    return save_bowl(tmp_path_factory.mktemp("geometry"))


def test_whole_renders_are_reported_in_words_or_as_json(tmp_path, capfd):
    archive, picture = tmp_path / "mixed.scene.npz", tmp_path / "a.png"
    save_scene(archive, scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    options = [
        "render",
        str(archive),
        "--device",
        "cpu",
        "--samples",
        "2",
        "--runs",
        "2",
        "--threads",
        "1",
        "--set",
        "nee=OFF",
    ]
    assert benchmark.main([*options, "--json", "--size", "32x24"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["frame"]["width"] == 32 and report["samples_per_pixel"] == 2 and report["bounces"] == 7
    assert (
        report["settings"]["nee"] == "OFF" and report["settings"]["thread_count"] == 1 and report["rays"]["shadow"] == 0
    )
    assert (
        report["raybatch"]["runs"] == 2 and report["raybatch"]["seconds"] >= report["raybatch"]["render"]["seconds"] > 0
    )
    assert benchmark.main([*options, "--picture", str(picture)]) == 0
    said = capfd.readouterr().out
    assert said.startswith("mixed.scene.npz") and "whole render" in said and "{" not in said
    assert picture.is_file()


def test_an_equal_error_render_is_not_clamped_whatever_the_file_asks():
    clamped = RenderSettings(clamp_direct=2.0, clamp_indirect=3.0)
    scene = SceneRequest(Path("any.blend"))

    def clamps(**request) -> tuple[float, float]:
        settings = measured_settings(clamped, RenderRequest(scene, samples=5, bounces=2, **request))
        assert (settings.sample_count, settings.bounce_max) == (5, 2)
        return settings.clamp_direct, settings.clamp_indirect

    assert clamps() == (2.0, 3.0) and clamps(equal_error=True) == (0.0, 0.0)
    # what is asked for by name counts
    assert clamps(equal_error=True, settings={"clamp_direct": 4.0}) == (4.0, 0.0)


def test_what_recording_costs(tmp_path, capfd):
    archive = tmp_path / "mixed.scene.npz"
    save_scene(
        archive, scenes.mixed(scenes.Frame(16, 12)), RenderSettings(error_target=0.5, time_limit=1e-3)
    )  # which end no render here
    options = ["recording", str(archive), "--device", "cpu", "--samples", "5", "--runs", "3", "--threads", "1"]
    assert benchmark.main([*options, "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["samples_per_pixel"] == 5 and report["clock"] == "processor"
    assert report["films"] == {"compared": 4, "equal": True, "differences": []}
    reported = [(way["error_estimate"], way["recorded"], way["rounds"]) for way in report["ways"]]
    assert reported == [("OFF", False, 1), ("OFF", True, 4), ("ON", False, 1), ("ON", True, 4)]
    assert report["ways"][0]["cost"] == report["ways"][0]["seconds_added"] == 0
    for way in report["ways"]:
        assert way["runs"] == 3 and way["seconds"] > 0 and way["cost_half"][0] <= way["cost"] <= way["cost_half"][1]
    assert benchmark.main([*options, "--runs", "1"]) == 0
    said = capfd.readouterr().out
    assert said.startswith("mixed.scene.npz") and "recording changes no bit of the films" in said
    assert benchmark.main([*options, "--samples", "1"]) == 1
    assert_one_error(capfd, "must be 2 or more")


def test_a_film_that_recording_changed_is_reported(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(
        recording, "_compared", lambda films: {"compared": 4, "equal": False, "differences": ["recorded, with a flaw"]}
    )
    archive = tmp_path / "mixed.scene.npz"
    save_scene(archive, scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    assert benchmark.main(["recording", str(archive), "--device", "cpu", "--samples", "2", "--runs", "1"]) == 1
    said = capfd.readouterr()
    assert "FILMS DIFFER: recorded, with a flaw" in said.out and "films differ" in said.err


IN_MEMORY = (
    "--device",
    "cpu",
    "--samples",
    "1",
    "--size",
    "32x24",
    "--threads",
    "1",
    "--against",
    "memory",
    "--set",
    "geometry_store=HOST",
)


def test_a_budget_of_geometry_is_measured_beside_memory(geometry, capfd):
    options = ["render", str(geometry), "--grid", "2", "--up", "z", *IN_MEMORY, "--runs", "2"]
    assert benchmark.main([*options, "--budgets", "90%,60%", "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["scene"] == "bowl.npz 2 x 2" and report["triangles"] == 4 * len(bowl().triangles)
    assert report["frame"]["width"] == 32 and report["geometry_bytes"] == report["memory"]["tree"]["bytes"] > 0
    assert report["films"] == {"compared": 3 * (1 + 1 + 2), "equal": True, "differences": []}
    assert [each["budget"] for each in report["budgets"]] == ["90%", "60%"]
    assert (
        report["settings"]["geometry_budget"] == 0
        and report["settings"]["batching"] == "OFF"
        and report["settings"]["counters"] == "OFF"
    )
    for each, share in zip(report["budgets"], (0.9, 0.6), strict=True):
        assert each["geometry_budget"] == int(share * report["geometry_bytes"]) >= each["resident_peak"] > 0
        assert each["tree"]["pages"] > 1 and each["bytes_copied"] > 0 and each["pages_loaded"] > 1
        assert each["rays_queued_per_ray"] > 0 and each["steps"] > 0 and each["speed"] > 0 and each["speed_whole"] > 0
    for each in (report["memory"], *report["budgets"]):
        assert each["whole"]["runs"] == each["build"]["runs"] == each["render"]["runs"] == 2
        assert each["whole"]["seconds"] >= each["render"]["seconds"] > 0 and each["build"]["seconds"] > 0
        assert each["stages"]["trace"] > 0 and each["rays_per_second"] > 0
    assert report["memory"]["stages"]["copy"] == 0 < report["budgets"][0]["stages"]["copy"]


def test_a_budget_is_reported_in_words_and_without_counters(geometry, tmp_path, capfd):
    picture = tmp_path / "a.png"
    options = [
        "render",
        str(geometry),
        *IN_MEMORY,
        "--runs",
        "1",
        "--no-counters",
        "--preset",
        "AUTO",
        "--picture",
        str(picture),
    ]
    assert benchmark.main([*options, "--budgets", "80%"]) == 0
    said = capfd.readouterr()
    assert re.search(r"^memory .* 1$", said.out, re.M) and re.search(r"^80% .* \d\.\d{3} ", said.out, re.M)
    assert "4 films are equal bit for bit" in said.out and "stages" not in said.out and "counters" not in said.err
    assert picture.is_file()


def test_films_that_differ_are_an_error_and_the_report_is_kept(geometry, tmp_path, capfd, monkeypatch):
    taken = []
    monkeypatch.setattr(films, "differing_pixels", lambda a, b: 3 * (len(taken) == 1) if taken.append(1) is None else 0)
    target = tmp_path / "r.json"
    options = [
        "render",
        str(geometry),
        *IN_MEMORY,
        "--runs",
        "1",
        "--no-counters",
        "--budgets",
        "80%",
        "--json",
        str(target),
    ]
    assert benchmark.main(options) == 1
    said = capfd.readouterr()
    assert (
        "benchmark.py: error: films differ: memory: 3 of 768 pixels of Combined differ" in said.err
        and "FILMS DIFFER" in said.out
    )
    assert json.loads(target.read_text())["films"]["equal"] is False


def test_pixels_differ_by_their_bits():
    a = np.zeros((2, 3, 4), np.float32)
    b = a.copy()
    assert films.differing_pixels(a, b) == 0
    b[0, 0] = -0.0
    b[1, 2, 3] = np.nextafter(np.float32(0), np.float32(1))
    assert films.differing_pixels(a, b) == 2
    nan = np.full_like(a, np.nan)
    assert differing_passes({"Combined": a, "Mist": nan}, {"Mist": nan.copy(), "Combined": a.copy()}) == []
    assert differing_passes({"Combined": a, "Depth": a}, {"Combined": b, "Mist": nan}) == ["Combined", "Depth", "Mist"]


def test_budgets_are_bytes_or_shares():
    found = memory.parse_budgets("1.5G, 10%,5%,10%")
    assert [each.of(2000) for each in found] == [1_500_000_000, 200, 100]


def test_a_mesh_is_rendered_where_only_numpy_and_warp_are(geometry):
    hidden = HIDE_BPY.replace(
        'name == "bpy"', 'name in ("bpy", "embreex", "tqdm", "PIL", "OpenEXR", "matplotlib", "scipy")'
    )
    options = (
        "--device",
        "cpu",
        "--samples",
        "1",
        "--size",
        "16x12",
        "--runs",
        "1",
        "--threads",
        "1",
        "--up",
        "z",
        "--json",
    )
    done = run_script("benchmark.py", "render", geometry, *options, before=hidden)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["raybatch"]["render"]["seconds"] > 0


def test_a_preset_is_what_settings_start_from(geometry, capfd):
    options = [
        "render",
        str(geometry),
        "--device",
        "cpu",
        "--samples",
        "1",
        "--size",
        "8x6",
        "--runs",
        "1",
        "--preset",
        "thesis",
    ]
    assert benchmark.main([*options, "--set", "treelet_size=900", "--json"]) == 0
    settings = json.loads(capfd.readouterr().out)["settings"]
    assert settings["batching"] == "ON" and settings["queue_size"] == 64 and settings["treelet_size"] == 900


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{folder}/none.scene.npz"], "no file .*none.scene.npz"),
        (["{folder}/a.obj"], "no file .*a.obj"),
        (["{bowl}", "--grid", "0"], "--grid 0 is not valid"),
        (["{bowl}", "--camera", "1,2"], "seven numbers"),
        (["{bowl}", "--preset", "fast"], "no preset is called 'fast'"),
        (["{bowl}", "--against", "cycles"], "--against cycles needs a .blend, not bowl.npz"),
        (["{bowl}", "--against", "memory"], "give --budgets, such as 10%"),
        (["{bowl}", "--against", "devices"], "--device .* names .* alone: name more, such as cuda:0,cuda:1"),
        (["{bowl}", "--against", "devices", "--samples", "1,2"], "takes one count of --samples"),
        (["{bowl}", "--budgets", "10%"], "--budgets belongs .* give --against memory too"),
        (["{bowl}", "--no-counters"], "--no-counters belongs .* give --against memory too"),
        (["{bowl}", "--against", "memory", "--budgets", "10%", "--equal-error"], "give --against cycles too"),
        (["{bowl}", "--against", "memory", "--budgets", "10%,"], "--budgets '' is not valid"),
        (["{bowl}", "--against", "memory", "--budgets", "100%"], "--budgets '100%' is not valid"),
        (["{bowl}", "--against", "memory", "--budgets", "x%"], "--budgets 'x%' is not valid"),
        (["{bowl}", "--against", "memory", "--budgets", "0"], "--budgets '0' is not valid"),
        (["{bowl}", "--against", "memory", "--budgets", "much"], "--budgets 'much' is not valid: give bytes"),
        (
            ["{bowl}", "--against", "memory", "--budgets", "1G", "--size", "8x6", "--samples", "1"],
            "--budgets 1G holds all of the geometry",
        ),
        (["{bowl}", "--against", "memory", "--budgets", "10%", "--set", "geometry_budget=1G"], "leave it out of --set"),
        (
            ["{bowl}", "--against", "memory", "--budgets", "10%", "--set", "counters=ON"],
            "counters would make .* slower",
        ),
        (
            ["{bowl}", "--against", "memory", "--budgets", "10%", "--preset", "unbatched"],
            "batching is OFF, and within --budgets rays must wait",
        ),
        (["{folder}/a.scene.npz", "--grid", "2"], "a.scene.npz is a whole scene"),
        (["{folder}/a.scene.npz", "--against", "cycles"], "--against cycles needs a .blend"),
        (["{folder}/a.scene.npz", "--equal-error"], "give --against cycles too"),
        (["{folder}/a.scene.npz", "--size", "8"], "WIDTHxHEIGHT"),
        (["{folder}/a.scene.npz", "--picture", "{folder}/x.gif"], "without Blender as .gif"),
        (["{folder}/a.scene.npz", "--samples", "0"], "--samples 0 is not valid"),
        (["{folder}/a.scene.npz", "--samples", "8,8"], "the second count must be larger"),
        (["{folder}/a.scene.npz", "--samples", "8,16", "--against", "memory"], "leave .*--against memory out"),
        (["{folder}/a.scene.npz", "--resume"], "give --json FILE too"),
        (["{folder}/a.scene.npz", "--threads", "5000"], "thread_count"),
    ],
)
def test_errors_of_render_are_one_clear_line(geometry, tmp_path, capfd, arguments, message):
    save_scene(tmp_path / "a.scene.npz", scenes.mixed(scenes.Frame(8, 6)), RenderSettings())
    assert (
        benchmark.main(
            ["render", *(argument.format(folder=tmp_path, bowl=geometry) for argument in arguments), "--device", "cpu"]
        )
        == 1
    )
    assert_one_error(capfd, message)


def test_error_falls_as_samples_rise():
    """Noise of a known size: relMSE is its variance over the squared brightness."""
    random = np.random.default_rng(3)
    truth = random.uniform(0.5, 2, (64, 64, 3))

    def pictures(deviation):
        return [truth + random.normal(0, deviation, truth.shape) for _ in range(2)]

    found = equal_error(8.0, pictures(0.02), 1.0, pictures(0.04))
    assert found["relmse"]["raybatch"] == pytest.approx((0.02**2 / (truth**2 + 0.01)).mean(), rel=0.05)
    assert found["relmse"]["cycles"] == pytest.approx(4 * found["relmse"]["raybatch"], rel=0.1)
    # eight times slower with a quarter of the error: twice the cost
    assert found["raybatch_over_cycles"] == pytest.approx(2, rel=0.1)
    assert found["raybatch_seconds_to_cycles_error"] == pytest.approx(2, rel=0.1)
    assert found["mean_ratio"] == pytest.approx(1, abs=1e-3)


def test_a_bright_dot_does_not_rule_the_error():
    picture = np.full((8, 8, 3), 0.5)
    dotted = picture.copy()
    dotted[2, 3] = 1e4
    pairs = [picture, dotted], *[[picture, picture]] * 7
    assert relmse_of_pairs(*pairs) == [pytest.approx(RELMSE_MOST / 64, rel=1e-12), *[0.0] * 7]


def test_what_a_render_takes_once_is_separated_from_what_a_sample_takes():
    timed = Timed([2.5, 2.7, 2.6], [3.5, 3.6, 3.7])
    reported = timed.report((10, 20))
    assert reported["ms_a_sample"] == 100 and (reported["ms_a_sample_least"], reported["ms_a_sample_most"]) == (90, 110)
    assert reported["fixed_seconds"] == pytest.approx(1.5, abs=0.001) and reported["runs"] == 3


def test_a_gpu_is_compared_by_two_counts_unless_one_is_asked_for():
    def counts(is_cuda, **request):
        asked = RenderRequest(SceneRequest(Path("a.blend")), samples_given=False, **request)
        return with_counts(asked, SimpleNamespace(is_cuda=is_cuda)).counts

    assert counts(True, against="cycles") == (64, 256)
    assert counts(False, against="cycles") == counts(True) == counts(True, against="memory") == (16, 0)
    assert counts(True, against="cycles", equal_error=True) == (16, 0)
    given = RenderRequest(SceneRequest(Path("a.blend")), samples=8, against="cycles")
    assert with_counts(given, SimpleNamespace(is_cuda=True)) is given


def test_a_comparison_on_a_gpu_says_what_its_times_hold():
    time = {"seconds": 1.0, "spread": 0.1}
    report = {
        "scene": "a.blend",
        "triangles": 2,
        "device": {"name": "a GPU"},
        "frame": {"width": 4, "height": 3},
        "samples_per_pixel": 16,
        "bounces": 7,
        "rays": {"total": 9},
        "cold": time,
        "invalid_samples": 0,
        "raybatch": time | {"build": time, "render": time},
        "cycles": time | {"device": "OPTIX"},
        "raybatch_over_cycles": 1.0,
        "ray_tracing_cores": False,
        "export_s": 0.125,
    }
    assert "Set-up is in these times" in render_text(report) and "no ray-tracing cores" in render_text(report)
    assert "Set-up" not in render_text(report | {"ray_tracing_cores": None})  # a CPU
    assert "once     0.125 s" in render_text(report) and "export from" not in render_text(report | {"export_s": None})
    engine = Timed([1.0], [2.0]).report((64, 256)) | {"first_seconds": 3.25}
    report |= {"raybatch": engine, "cycles": {"OPTIX": engine | {"first_seconds": 4.5}}}
    said = slopes_text(report | {"sample_counts": [64, 256]})
    ours, theirs = (line for line in said.splitlines() if line.startswith(("RayBatch ", "Cycles (OPTIX)")))
    assert ours.split()[-4:] == ["0.125", "s", "3.250", "s"] and theirs.split()[-4:] == ["in", "it", "4.500", "s"]
    assert "has no ray-tracing cores" in said and "export: RayBatch's" in said
    assert "not timed" in slopes_text(report | {"sample_counts": [64, 256], "export_s": None})


def test_slopes_without_a_peer(tmp_path, capfd):
    archive, picture = tmp_path / "mixed.scene.npz", tmp_path / "a.png"
    save_scene(archive, scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    options = ["render", str(archive), "--device", "cpu", "--samples", "1,3", "--runs", "1", "--picture", str(picture)]
    assert benchmark.main(options) == 0
    said = capfd.readouterr().out
    assert "1 samples" in said and "3 samples" in said and "a sample" in said and "Cycles" not in said
    assert picture.is_file()
