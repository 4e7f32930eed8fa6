"""scripts/convergence.py: what it measures, and what it writes."""

import base64
import dataclasses
import io
import json
import math
from html.parser import HTMLParser

import convergence
import numpy as np
import pytest
import scenes
from command_line import HIDE_BPY, error_line, run_script
from convergence_runs import FRAME, SMALL, measured, picture_alone, save_lit
from converging import plots
from converging.cycles import samples_next, setup_seconds
from converging.page import png
from converging.reference import SEED, TAKEN_SEEDS, reference_settings
from converging.request import parse_comparison, run_seeds, variants

from raybatch_addon.core.report.convergence import PICTURE_SETTINGS, ErrorPoint, load_reference, scene_hash
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.settings import SETTINGS, RenderSettings


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Where references are kept."""
    return tmp_path_factory.mktemp("references")


@pytest.fixture(autouse=True)
def own_folder(kept, monkeypatch):
    monkeypatch.setenv("RAYBATCH_REFERENCES", str(kept))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A saved scene with a bit of everything."""
    path = tmp_path_factory.mktemp("scene") / "mixed.scene.npz"
    save_scene(path, scenes.mixed(FRAME), RenderSettings())
    return path


@pytest.fixture(scope="module")
def lit(tmp_path_factory):
    """A floor under a lamp."""
    return save_lit(tmp_path_factory.mktemp("lit"))


@pytest.fixture(scope="module")
def reported(saved, kept, tmp_path_factory):
    """A run with all that is written, on a machine without Blender."""
    folder = tmp_path_factory.mktemp("report") / "made"
    files = {name: folder / f"report.{name}" for name in ("json", "html", "svg", "npz")}
    done = run_script(
        "convergence.py", saved, *SMALL, "--compare", "nee=ON,OFF", "--samples", "16", "--json", files["json"], "--html", files["html"],
        "--plot", files["svg"], "--save-reference", files["npz"], before=HIDE_BPY, RAYBATCH_REFERENCES=kept / "first",
    )  # fmt: skip
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0, done.stderr
    return done, files, json.loads(files["json"].read_text(encoding="utf-8"))


def test_the_report_has_every_run_in_the_order_of_turns(reported, saved):
    _, _, report = reported
    assert report["scene"] == "mixed.scene.npz" and isinstance(report["device"], str) and report["machine"]["alias"]
    assert [(run["settings"], run["seed"]) for run in report["runs"]] == [
        ({"nee": "ON"}, 0), ({"nee": "OFF"}, 0), ({"nee": "OFF"}, 1), ({"nee": "ON"}, 1)
    ]  # fmt: skip
    for run in report["runs"]:
        assert run["engine"] == "RayBatch" and run["slope"] < 0
        assert [point["samples"] for point in run["points"]] == [1, 2, 4, 8, 16]
        assert all({"seconds", "samples", "rmse", "relmse", "flip"} <= point.keys() for point in run["points"])
        seconds = [point["seconds"] for point in run["points"]]
        assert seconds == sorted(seconds) and all(0 < point["seconds"] <= point["seconds_total"] for point in run["points"])
        assert all(point["invalid_samples"] == 0 and point["rays"]["camera"] == 20 * 16 * point["samples"] for point in run["points"])
    on, off = report["summary"]
    assert on["label"] == "nee=ON" and on["efficiency_relative"]["median"] == 1 and on["end"]["samples"] == 16
    assert on["end"]["relmse"] < off["end"]["relmse"] and off["efficiency_relative"]["median"] < 1
    assert report["target"] == {"relmse": on["end"]["relmse"], "given": False}
    assert off["seconds_to_target"] is None or off["seconds_to_target"]["extrapolated"]
    assert report["reference"]["samples"] == 256 and report["reference"]["from_cache"] is False and report["reference"]["kind"] == "raybatch"
    assert report["reference"]["noise_floor"]["relmse"] > 0


def test_errors_are_those_of_the_pictures_that_a_session_renders(reported, saved, session):
    """From their definitions, of a render that had no rounds."""
    _, files, report = reported
    with np.load(files["npz"]) as archive:
        truth = archive["picture"]
    for run in report["runs"]:
        film = session.render(load_scene(saved)[0], RenderSettings(sample_count=16, seed=run["seed"], **run["settings"]))
        error = (film.passes["Combined"][..., :3].astype(np.float64) - truth) ** 2
        last = run["points"][-1]
        assert last["rmse"] == pytest.approx(math.sqrt(error.mean()), rel=1e-5)
        assert last["relmse"] == pytest.approx((error / (truth**2 + 0.01)).mean(), rel=1e-5)
    noise = load_reference(files["npz"], (20, 16), scene_hash(picture_alone(saved)), RenderSettings()).variance.mean() ** 0.5
    assert report["reference"]["noise_floor"]["rmse"] == pytest.approx(noise, rel=1e-5)


def test_flip_is_that_of_its_package(reported, saved, session):
    flip_evaluator = pytest.importorskip("flip_evaluator", reason="FLIP is not installed: the column is null, which another test looks at")
    _, files, report = reported
    with np.load(files["npz"]) as archive:
        truth = archive["picture"][::-1].astype(np.float32)
    run = report["runs"][0]
    film = session.render(load_scene(saved)[0], RenderSettings(sample_count=16, seed=run["seed"], **run["settings"]))
    picture = np.ascontiguousarray(film.passes["Combined"][::-1, :, :3])
    expected = flip_evaluator.evaluate(np.ascontiguousarray(truth), picture, "HDR", inputsRGB=False, applyMagma=False)[1]
    assert run["points"][-1]["flip"] == pytest.approx(expected, rel=1e-4)
    assert all(0 < point["flip"] < 1 for each in report["runs"] for point in each["points"])


def test_words_are_for_people(reported):
    done, _, report = reported
    assert done.stdout.startswith("mixed.scene.npz, 20 x 16 pixels") and "reference: RayBatch with another seed, 256 samples" in done.stdout
    for each in report["summary"]:
        assert f"{each['label']}: {each['says']}" in done.stdout
    assert "[1/8" in done.stderr and "[1/8" not in done.stdout


class _Page(HTMLParser):
    """Collects tags; an end that is not of what is open is an error."""

    def __init__(self):
        super().__init__()
        self.tags, self.sources, self._open = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action", "data")]
        if tag not in ("meta", "img", "br"):
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.handle_endtag(tag)

    def close(self):
        super().close()
        assert not self._open


def test_the_page_stands_alone(reported):
    _, files, report = reported
    text = files["html"].read_text(encoding="utf-8")
    page = _Page()
    page.feed(text)
    page.close()
    flip = report["runs"][0]["points"][0]["flip"] is not None
    assert text.startswith("<!doctype html>") and "prefers-color-scheme: dark" in text and page.tags.count("svg") == 2 + flip
    assert not any(each in text for each in ("http:", "https:", "<script", "<link", "@import", "url(http", plots.INK))
    assert all(source.startswith(("#", "data:image/png;base64,")) for source in page.sources)
    assert "currentColor" in text and report["versions"]["warp"] in text and "nee=OFF" in text and "convergence.py" in text
    pictures = [source for source in page.sources if source.startswith("data:")]
    assert len(pictures) == 1 + 2 * 2  # the reference, and of either setting the picture and the difference
    for each in pictures:
        assert base64.b64decode(each.partition(",")[2]).startswith(b"\x89PNG")


def test_names_from_files_are_text(lit, tmp_path, capfd):
    """Neither markup of the page nor formulas of the plot."""
    scene, settings = load_scene(lit)
    path = tmp_path / "a<b>&$x_$.scene.npz"
    save_scene(path, dataclasses.replace(scene, warnings=("Object <img src=x> has none",)), settings)
    outputs = ("--html", tmp_path / "page.html", "--plot", tmp_path / "plot.svg")
    code = convergence.main([*map(str, (path, *SMALL, "--samples", "2", "--no-flip", "--json", *outputs))])
    said = capfd.readouterr()
    if "wp_compile_cpp" in said.err:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert code == 0, said.err
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "a&lt;b&gt;&amp;$x_$" in text and "Object &lt;img" in text and "<b>&" not in text and "<img src=x" not in text
    assert "convergence.py: warning: Object <img src=x> has none" in said.err
    page = _Page()
    page.feed(text)
    page.close()


def test_pictures_are_the_pixels():
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 3), np.uint8)
    assert (np.array(image.open(io.BytesIO(png(pixels)))) == pixels).all()


def test_a_plot_is_a_picture_of_its_own(reported, tmp_path, lit, capfd):
    _, files, _ = reported
    assert "<svg" in files["svg"].read_text(encoding="utf-8") and plots.INK not in files["svg"].read_text(encoding="utf-8")
    measured(capfd, lit, *SMALL, "--samples", "2", "--plot", tmp_path / "p.png", "--no-flip")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_references_are_kept_and_made_anew_when_they_must_be(lit, kept, capfd, tmp_path):
    options = (lit, *SMALL, "--no-flip", "--samples", "4", "--reference-samples", "64")
    first = measured(capfd, *options)["reference"]
    again = measured(capfd, *options, "--set", "nee=OFF", "--set", "ray_sort=OFF")["reference"]  # neither changes what is aimed at
    assert not first["from_cache"] and again["from_cache"] and again["file"] == first["file"] and again["seconds"] is None
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
    report = measured(capfd, lit, *SMALL, "--no-flip", "--samples", "4", "--compare", "bounce_max=0,1", "--set", "filter_width=1.2")
    assert [each["settings"]["bounce_max"] for each in report["references"]] == [0, 1]
    assert all(each["settings"]["filter_width"] == 1.2 for each in report["references"])


def test_a_reference_has_nothing_that_biases_it():
    changed = RenderSettings(
        nee="OFF", clamp_direct=1.0, clamp_indirect=2.0, sample_sequence="INDEPENDENT", bounce_max=3, seed=5, time_limit=3.0, filter_width=2.0
    )
    settings = reference_settings(changed, 63)
    assert settings.sample_count == 64 and settings.seed == SEED and settings.error_estimate == "ON" and settings.half_count == 2
    for name, info in SETTINGS.items():
        if info.effect == "estimator" and name not in ("sample_count", "seed", "error_estimate"):
            assert getattr(settings, name) == (getattr(changed, name) if name in PICTURE_SETTINGS else info.default), name
    assert settings.clamp_direct == settings.clamp_indirect == 0


def test_independent_samples_have_slope_one_half_and_a_bias_is_flagged(lit, tmp_path, capfd):
    """Clamping takes light away, however many samples there are. What is flagged must be that, and that alone."""
    options = (
        lit, *SMALL, "--no-flip", "--samples", "512", "--compare", "clamp_direct=0,0.15", "--set", "sample_sequence=INDEPENDENT",
        "--reference-samples", "32768", "--json", tmp_path / "r.json", "--html", tmp_path / "r.html",
    )  # fmt: skip
    code = convergence.main([*map(str, options)])
    said = capfd.readouterr()
    if "wp_compile_cpp" in said.err:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert code == 0, said.err
    report = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    plain, clamped = report["summary"]
    # four standard errors, as the fit measures them, and what it takes slopes as the same within
    assert abs(plain["slope"] + 0.5) < 4 * plain["slope_spread"] + 0.02 and plain["flattens"] is False and "-0.5" in plain["says"]
    assert clamped["flattens"] is True and "bias" in clamped["says"] and clamped["seconds_to_target"] is None
    assert any("clamp_direct=0.15" in note and "takes light away" in note for note in report["notes"])
    assert not any("clamp_direct=0:" in note for note in report["notes"])
    for told in (said.out, (tmp_path / "r.html").read_text(encoding="utf-8")):
        assert told.count("the curve flattens") == 1 and told.count("BIAS") >= 1


def test_time_ends_runs_and_none_is_without_a_sample(lit, capfd):
    report = measured(capfd, lit, *SMALL, "--no-flip", "--seconds", "0.2", "--reference-samples", "64")
    assert report["request"]["seconds"] == 0.2
    assert all(run["points"] and run["points"][-1]["samples"] >= 1 for run in report["runs"])


def test_a_run_too_short_for_two_halves_has_no_points(lit, tmp_path, capfd):
    outputs = ("--html", tmp_path / "page.html", "--plot", tmp_path / "plot.svg")
    report = measured(capfd, lit, *SMALL, "--reference", "halves", "--seconds", "1e-6", *outputs)
    assert [run["points"] for run in report["runs"]] == [[], []] and report["summary"][0]["end"]["rmse"] is None
    assert report["target"]["relmse"] is None and (tmp_path / "page.html").is_file() and (tmp_path / "plot.svg").is_file()


def test_halves_need_no_reference(lit, capfd):
    report = measured(capfd, lit, *SMALL, "--reference", "halves", "--samples", "8", "--compare", "preset=AUTO,UNBATCHED")
    assert report["reference"]["kind"] == "halves" and report["reference"]["samples"] is None
    assert [each["label"] for each in report["summary"]] == ["preset=AUTO", "preset=UNBATCHED"]
    assert all([point["samples"] for point in run["points"]] == [2, 4, 8] and run["points"][0]["flip"] is None for run in report["runs"])
    ends = {run["seed"]: run["points"][-1]["relmse"] for run in report["runs"]}
    assert all(run["points"][-1]["relmse"] == ends[run["seed"]] for run in report["runs"])  # a schedule changes no picture
    assert any("a bias is not in them" in note for note in report["notes"])


def test_a_film_is_a_reference_of_unknown_noise(lit, tmp_path, capfd, session):
    scene, settings = load_scene(lit)
    film = session.render(scene, settings.replace(sample_count=256, seed=99))
    film.save_npz(tmp_path / "film.npz")
    report = measured(capfd, lit, *SMALL, "--no-flip", "--samples", "4", "--reference", tmp_path / "film.npz", "--target", "0.01")
    assert report["reference"]["kind"] == "file" and report["reference"]["noise_floor"] == {"rmse": None, "relmse": None}
    assert report["target"] == {"relmse": 0.01, "given": True}
    assert any("is not known" in note for note in report["notes"])


def test_without_its_package_flip_is_null_and_that_is_said_once(lit, kept):
    hidden = HIDE_BPY.replace('name == "bpy"', 'name in ("bpy", "flip_evaluator", "matplotlib", "PIL", "tqdm", "scipy")')
    done = run_script("convergence.py", lit, *SMALL, "--samples", "2", "--json", before=hidden, RAYBATCH_REFERENCES=kept)
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("FLIP is left out") == 1
    assert all(point["flip"] is None for run in json.loads(done.stdout)["runs"] for point in run["points"])
    line = error_line(run_script("convergence.py", lit, *SMALL, "--html", "x.html", before=hidden.replace("def find_spec", _FIND_NOTHING)))
    assert "matplotlib" in line and "--json does without" in line


# find_spec of importlib.util is asked, and must not raise
_FIND_NOTHING = """pass
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "matplotlib" else found(name, *more)
class NoBlender(NoBlender):
    def find_spec"""


def test_a_picture_without_error_or_light_is_reported_too(tmp_path, capfd):
    """Nothing but a world that has one colour: the error is 0, and has no slope; and darkness, in which FLIP means nothing."""
    for world in (0.5, 0.0):
        path = tmp_path / f"world{world}.scene.npz"
        save_scene(path, scenes.scene(frame=FRAME, world=world), RenderSettings())
        report = measured(capfd, path, *SMALL, "--samples", "4", "--html", tmp_path / "page.html", "--plot", tmp_path / "plot.svg")
        (only,) = report["summary"]
        assert only["end"]["rmse"] == 0 and only["slope"] is None and only["efficiency"] is None and only["seconds_to_target"] is None


# --- parts


def test_seeds_of_runs_are_not_those_of_references():
    assert run_seeds(3, 4, ()) == [3, 4, 5, 6]
    assert run_seeds(SEED - 1, 3, TAKEN_SEEDS) == [SEED - 1, SEED + 2, SEED + 3]
    assert run_seeds(2**31 - 1, 2, ()) == [2**31 - 1, 0]


def test_what_cycles_takes_beside_its_samples_is_not_rendering():
    assert setup_seconds([(1, 1.1), (2, 1.2), (4, 1.4)]) == pytest.approx(1.0)
    assert setup_seconds([(1, 1.1), (2, 1.15), (4, 1.4)]) == pytest.approx(0.95)  # no render has less than its samples take
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
        ("AUTO", "OFF", 32), ("AUTO", "OFF", 128), ("OFF", "OFF", 32), ("OFF", "OFF", 128)
    ]  # fmt: skip


def test_bands_are_of_what_all_runs_have():
    def run(*points):
        from converging.study import Run

        return Run(None, 0, [ErrorPoint(seconds, seconds, samples, {}, error, error) for samples, seconds, error in points], None)

    runs = [run((1, 1.0, 0.5), (2, 2.0, 0.4), (3, 3.0, 0.1)), run((1, 3.0, 0.7), (2, 4.0, 0.0), (4, 5.0, 0.1))]
    assert plots.medians(runs, plots.ERROR) == ([2.0], [0.5], [0.6], [0.7])


def test_settings_go_on_top_of_a_preset(lit):
    from benchmarking.scenes import SceneRequest
    from converging.request import ConvergenceRequest, run_settings

    settings = run_settings(ConvergenceRequest(SceneRequest(lit), preset="UNBATCHED", settings={"ray_sort": "OFF"}), RenderSettings())
    assert (settings.batching, settings.ray_sort) == ("OFF", "OFF")


def test_beside_cycles_only_the_request_clamps(lit, tmp_path):
    from benchmarking.scenes import SceneRequest
    from converging.request import ConvergenceRequest, run_settings

    file = RenderSettings(clamp_direct=3.0, clamp_indirect=4.0)
    request = ConvergenceRequest(SceneRequest(tmp_path / "a.blend"), cycles=True, settings={"clamp_direct": 2.0})
    settings = run_settings(request, file)
    assert (settings.clamp_direct, settings.clamp_indirect) == (2.0, 0.0)
    assert run_settings(ConvergenceRequest(SceneRequest(lit)), file).clamp_indirect == 4.0
