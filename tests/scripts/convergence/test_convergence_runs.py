"""scripts/convergence.py: references, turns, ends of runs, halves, and what is compared."""

import dataclasses
import json

import convergence
import pytest
from converging import plots
from converging.cycles import samples_next, setup_seconds
from converging.equal_time import equal_times, error_at
from converging.reference import SEED, TAKEN_SEEDS, reference_settings
from converging.request import parse_comparison, run_seeds, variants

from raybatch_addon.core.convergence.points import PICTURE_SETTINGS, ErrorPoint
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from tests.support import scenes
from tests.support.command_line import HIDE_BPY, error_line, run_script
from tests.support.convergence_runs import FRAME, SMALL, measured

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


def test_references_are_kept_and_made_anew_when_they_must_be(lit, kept, capfd, tmp_path):
    options = (lit, *SMALL, "--no-flip", "--samples", "4", "--reference-samples", "64")
    first = measured(capfd, *options)["reference"]
    again = measured(capfd, *options, "--set", "nee=OFF", "--set", "ray_sort=OFF")[
        "reference"
    ]  # neither changes what is aimed at
    assert (
        not first["from_cache"] and again["from_cache"] and again["file"] == first["file"] and again["seconds"] is None
    )
    assert not measured(capfd, *options, "--new-reference")["reference"]["from_cache"]
    assert not measured(capfd, *options[:-1], "128")["reference"]["from_cache"]  # more samples
    assert measured(capfd, *options)["reference"]["samples"] == 128  # the better one is taken
    other = measured(capfd, *options, "--set", "bounce_max=2")["reference"]
    assert not other["from_cache"] and other["file"] != first["file"] and other["settings"]["bounce_max"] == 2
    turned = tmp_path / "lit.scene.npz"
    scene, settings = load_scene(lit)
    save_scene(turned, dataclasses.replace(scene, lights=(scenes.area_light(2.9),)), settings)
    assert measured(capfd, turned, *options[1:])["reference"]["file"] != first["file"]

    path = kept / first["file"]
    path.write_bytes(path.read_bytes()[:500])
    convergence.main([*map(str, options), "--json"])
    said = capfd.readouterr()
    assert "a kept reference is made anew" in said.err and not json.loads(said.out)["reference"]["from_cache"]


def test_settings_that_aim_at_other_pictures_have_references_of_their_own(lit, capfd):
    report = measured(
        capfd, lit, *SMALL, "--no-flip", "--samples", "4", "--compare", "bounce_max=0,1", "--set", "filter_width=1.2"
    )
    assert [each["settings"]["bounce_max"] for each in report["references"]] == [0, 1]
    assert all(each["settings"]["filter_width"] == 1.2 for each in report["references"])


def test_a_reference_has_nothing_that_biases_it():
    changed = RenderSettings(
        nee="OFF",
        clamp_direct=1.0,
        clamp_indirect=2.0,
        sample_sequence="INDEPENDENT",
        bounce_max=3,
        seed=5,
        time_limit=3.0,
        filter_width=2.0,
    )
    settings = reference_settings(changed, 63)
    assert (
        settings.sample_count == 64
        and settings.seed == SEED
        and settings.error_estimate == "ON"
        and settings.half_count == 2
    )
    for name, info in SETTINGS.items():
        if info.effect == "estimator" and name not in ("sample_count", "seed", "error_estimate"):
            assert getattr(settings, name) == (getattr(changed, name) if name in PICTURE_SETTINGS else info.default), (
                name
            )
    assert settings.clamp_direct == settings.clamp_indirect == 0


def test_independent_samples_have_slope_one_half_and_a_bias_is_flagged(lit, tmp_path, capfd):
    """Clamping takes light away, however many samples there are. What is flagged must be that, and that alone."""
    options = (
        lit,
        *SMALL,
        "--no-flip",
        "--samples",
        "512",
        "--compare",
        "clamp_direct=0,0.15",
        "--set",
        "sample_sequence=INDEPENDENT",
        "--reference-samples",
        "32768",
        "--json",
        tmp_path / "r.json",
        "--html",
        tmp_path / "r.html",
    )
    code = convergence.main([*map(str, options)])
    said = capfd.readouterr()
    if "wp_compile_cpp" in said.err:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert code == 0, said.err
    report = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    plain, clamped = report["summary"]
    # four standard errors, as the fit measures them, and what it takes slopes as the same within
    assert (
        abs(plain["slope"] + 0.5) < 4 * plain["slope_spread"] + 0.02
        and plain["flattens"] is False
        and "-0.5" in plain["says"]
    )
    assert clamped["flattens"] is True and "bias" in clamped["says"] and clamped["seconds_to_target"] is None
    assert any("clamp_direct=0.15" in note and "takes light away" in note for note in report["notes"])
    assert not any("clamp_direct=0:" in note for note in report["notes"])
    for reported in (said.out, (tmp_path / "r.html").read_text(encoding="utf-8")):
        assert reported.count("the curve flattens") == 1 and reported.count("BIAS") >= 1


def test_time_ends_runs_and_none_is_without_a_sample(lit, capfd):
    report = measured(capfd, lit, *SMALL, "--no-flip", "--seconds", "0.2", "--reference-samples", "64")
    assert report["request"]["seconds"] == 0.2
    assert all(run["points"] and run["points"][-1]["samples"] >= 1 for run in report["runs"])


def test_a_run_too_short_for_two_halves_has_no_points(lit, tmp_path, capfd):
    outputs = ("--html", tmp_path / "page.html", "--plot", tmp_path / "plot.svg")
    report = measured(capfd, lit, *SMALL, "--reference", "halves", "--seconds", "1e-6", *outputs)
    assert [run["points"] for run in report["runs"]] == [[], []] and report["summary"][0]["end"]["rmse"] is None
    assert (
        report["target"]["relmse"] is None and (tmp_path / "page.html").is_file() and (tmp_path / "plot.svg").is_file()
    )


def test_halves_need_no_reference(lit, capfd):
    report = measured(
        capfd, lit, *SMALL, "--reference", "halves", "--samples", "8", "--compare", "preset=AUTO,UNBATCHED"
    )
    assert report["reference"]["kind"] == "halves" and report["reference"]["samples"] is None
    assert [each["label"] for each in report["summary"]] == ["preset=AUTO", "preset=UNBATCHED"]
    assert all(
        [point["samples"] for point in run["points"]] == [2, 4, 8] and run["points"][0]["flip"] is None
        for run in report["runs"]
    )
    ends = {run["seed"]: run["points"][-1]["relmse"] for run in report["runs"]}
    assert all(
        run["points"][-1]["relmse"] == ends[run["seed"]] for run in report["runs"]
    )  # a schedule changes no picture
    assert any("a bias is not in them" in note for note in report["notes"])


def test_a_film_is_a_reference_of_unknown_noise(lit, tmp_path, capfd, session):
    scene, settings = load_scene(lit)
    film = session.render(scene, settings.replace(sample_count=256, seed=99))
    film.save_npz(tmp_path / "film.npz")
    report = measured(
        capfd, lit, *SMALL, "--no-flip", "--samples", "4", "--reference", tmp_path / "film.npz", "--target", "0.01"
    )
    assert report["reference"]["kind"] == "file" and report["reference"]["noise_floor"] == {
        "rmse": None,
        "relmse": None,
    }
    assert report["target"] == {"relmse": 0.01, "given": True}
    assert any("is not known" in note for note in report["notes"])


def test_without_its_package_flip_is_null_and_that_is_said_once(lit, kept):
    hidden = HIDE_BPY.replace(
        'name == "bpy"', 'name in ("bpy", "flip_evaluator", "matplotlib", "PIL", "tqdm", "scipy")'
    )
    done = run_script(
        "convergence.py", lit, *SMALL, "--samples", "2", "--json", before=hidden, RAYBATCH_REFERENCES=kept
    )
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("FLIP is left out") == 1
    assert all(point["flip"] is None for run in json.loads(done.stdout)["runs"] for point in run["points"])
    line = error_line(
        run_script(
            "convergence.py", lit, *SMALL, "--html", "x.html", before=hidden.replace("def find_spec", _FIND_NOTHING)
        )
    )
    assert "matplotlib" in line and "--json does without" in line


# find_spec of importlib.util is asked, and must not raise
_FIND_NOTHING = """pass
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "matplotlib" else found(name, *more)
class NoBlender(NoBlender):
    def find_spec"""


def test_a_picture_without_error_or_light_is_reported_too(tmp_path, capfd):
    """Nothing but a world that has one colour: the error is 0, and has no slope; and darkness, in which FLIP means
    nothing.
    """
    for world in (0.5, 0.0):
        path = tmp_path / f"world{world}.scene.npz"
        save_scene(path, scenes.scene(frame=FRAME, world=world), RenderSettings())
        report = measured(
            capfd, path, *SMALL, "--samples", "4", "--html", tmp_path / "page.html", "--plot", tmp_path / "plot.svg"
        )
        (only,) = report["summary"]
        assert (
            only["end"]["rmse"] == 0
            and only["slope"] is None
            and only["efficiency"] is None
            and only["seconds_to_target"] is None
        )


# --- parts


def test_seeds_of_runs_are_not_those_of_references():
    assert run_seeds(3, 4, ()) == [3, 4, 5, 6]
    assert run_seeds(SEED - 1, 3, TAKEN_SEEDS) == [SEED - 1, SEED + 2, SEED + 3]
    assert run_seeds(2**31 - 1, 2, ()) == [2**31 - 1, 0]


def test_what_cycles_takes_beside_its_samples_is_not_rendering():
    assert setup_seconds([(1, 1.1), (2, 1.2), (4, 1.4)]) == pytest.approx(1.0)
    assert setup_seconds([(1, 1.1), (2, 1.15), (4, 1.4)]) == pytest.approx(
        0.95
    )  # no render has less than its samples take
    assert setup_seconds([(1, 1.0)]) == setup_seconds([(1, 1.0), (2, 0.9)]) == 0


def test_samples_of_cycles_grow_to_what_time_allows():
    assert samples_next([(1, 1.1)], 1000, 10.0) == 2
    assert samples_next([(1, 1.1), (2, 1.2)], 1000, 10.0) == 4
    assert samples_next([(1, 1.1), (64, 7.4)], 1000, 10.0) == 100
    assert samples_next([(1, 1.1), (64, 7.4)], 80, 10.0) == 80
    assert samples_next([(1, 1.1), (64, 7.4)], 1000, 6.5) is None


def test_a_preset_leaves_what_is_set_or_compared():
    """A preset has every setting of the schedule."""
    changed = RenderSettings(ray_sort="OFF", queue_size=64)
    comparison = parse_comparison(["preset=AUTO,UNBATCHED", "queue_size=32,128"], {"ray_sort": "OFF"})
    found = [each.settings for each in variants(comparison, changed, kept=["ray_sort"])]
    assert [(s.batching, s.ray_sort, s.queue_size) for s in found] == [
        ("AUTO", "OFF", 32),
        ("AUTO", "OFF", 128),
        ("OFF", "OFF", 32),
        ("OFF", "OFF", 128),
    ]


def test_bands_are_of_what_all_runs_have():
    def run(*points):
        from converging.study import Run

        return Run(
            None,
            0,
            [
                ErrorPoint(seconds=seconds, seconds_total=seconds, samples=samples, rays={}, rmse=error, relmse=error)
                for samples, seconds, error in points
            ],
            None,
        )

    runs = [run((1, 1.0, 0.5), (2, 2.0, 0.4), (3, 3.0, 0.1)), run((1, 3.0, 0.7), (2, 4.0, 0.0), (4, 5.0, 0.1))]
    assert plots.medians(runs, plots.ERROR) == ([2.0], [0.5], [0.6], [0.7])


def test_errors_are_compared_at_the_time_that_all_runs_have():
    def curve(scale, count, cost=1.0):
        return [
            ErrorPoint(
                seconds=cost * n,
                seconds_total=cost * n,
                samples=n,
                rays={},
                rmse=1.0,
                relmse=50.0,  # a firefly
                relmse_cut=scale / n,
            )
            for n in (1, 2, 4, 8)[:count]
        ]

    assert error_at(curve(8.0, 4), 4) == 2 and error_at(curve(8.0, 4), 3) == pytest.approx(8 / 3)
    assert error_at(curve(8.0, 4), 0.5) is error_at(curve(8.0, 4), 9) is error_at([], 1) is None
    (found,) = equal_times(
        {
            "A": {1: curve(8.0, 4), 2: curve(4.0, 4), 3: curve(1.0, 4)},
            "B": {1: curve(8.0, 4, 0.5), 2: curve(8.0, 4, 0.5)},
        }
    )
    # to 4 s, where B ends, it has twice the samples, so half the error; and twice the variance in the second run
    assert (found.seconds, found.least, found.most, found.ratio) == (4, 0.5, 1, 0.75)
    assert found.says == "at equal time (4 s) B has 0.75 times the error of A (0.5 to 1 in single runs)"
    assert equal_times({"A": {1: curve(8.0, 4)}, "B": {2: curve(8.0, 4)}}) == []


def test_settings_go_on_top_of_a_preset(lit):
    from benchmarking.scenes import SceneRequest
    from converging.request import ConvergenceRequest, run_settings

    settings = run_settings(
        ConvergenceRequest(SceneRequest(lit), preset="UNBATCHED", settings={"ray_sort": "OFF"}), RenderSettings()
    )
    assert (settings.batching, settings.ray_sort) == ("OFF", "OFF")


def test_beside_cycles_only_the_request_clamps(lit, tmp_path):
    from benchmarking.scenes import SceneRequest
    from converging.request import ConvergenceRequest, run_settings

    file = RenderSettings(clamp_direct=3.0, clamp_indirect=4.0)
    request = ConvergenceRequest(SceneRequest(tmp_path / "a.blend"), cycles=True, settings={"clamp_direct": 2.0})
    settings = run_settings(request, file)
    assert (settings.clamp_direct, settings.clamp_indirect) == (2.0, 0.0)
    assert run_settings(ConvergenceRequest(SceneRequest(lit)), file).clamp_indirect == 4.0
