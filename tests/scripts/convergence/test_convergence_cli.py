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
from converging import plots
from converging.page import png

from raybatch_addon.core.convergence.points import load_reference, scene_hash
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.command_line import HIDE_BPY, run_script
from tests.support.convergence_runs import FRAME, SMALL, measured, picture_alone

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A saved scene with a bit of everything."""
    path = tmp_path_factory.mktemp("scene") / "mixed.scene.npz"
    save_scene(path, scenes.mixed(FRAME), RenderSettings())
    return path


@pytest.fixture(scope="module")
def reported(saved, kept, tmp_path_factory):
    """A run with all that is written, on a machine without Blender."""
    folder = tmp_path_factory.mktemp("report") / "made"
    files = {name: folder / f"report.{name}" for name in ("json", "html", "svg", "npz")}
    done = run_script(
        "convergence.py",
        saved,
        *SMALL,
        "--compare",
        "nee=ON,OFF",
        "--samples",
        "16",
        "--json",
        files["json"],
        "--html",
        files["html"],
        "--plot",
        files["svg"],
        "--save-reference",
        files["npz"],
        before=HIDE_BPY,
        RAYBATCH_REFERENCES=kept / "first",
    )
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0, done.stderr
    return done, files, json.loads(files["json"].read_text(encoding="utf-8"))


def test_the_report_has_every_run_in_the_order_of_turns(reported, saved):
    _, _, report = reported
    assert report["scene"] == "mixed.scene.npz" and isinstance(report["device"], str) and report["machine"]["alias"]
    assert [(run["settings"], run["seed"]) for run in report["runs"]] == [
        ({"nee": "ON"}, 0),
        ({"nee": "OFF"}, 0),
        ({"nee": "OFF"}, 1),
        ({"nee": "ON"}, 1),
    ]
    for run in report["runs"]:
        assert run["engine"] == "RayBatch" and run["slope"] < 0
        assert [point["samples"] for point in run["points"]] == [1, 2, 4, 8, 16]
        assert all({"seconds", "samples", "rmse", "relmse", "flip"} <= point.keys() for point in run["points"])
        seconds = [point["seconds"] for point in run["points"]]
        assert seconds == sorted(seconds) and all(
            0 < point["seconds"] <= point["seconds_total"] for point in run["points"]
        )
        assert all(
            point["invalid_samples"] == 0 and point["rays"]["camera"] == 20 * 16 * point["samples"]
            for point in run["points"]
        )
    on, off = report["summary"]
    assert on["label"] == "nee=ON" and on["efficiency_relative"]["median"] == 1 and on["end"]["samples"] == 16
    assert on["end"]["relmse"] < off["end"]["relmse"] and off["efficiency_relative"]["median"] < 1
    assert report["target"] == {"relmse": on["end"]["relmse"], "given": False}
    assert off["seconds_to_target"] is None or off["seconds_to_target"]["extrapolated"]
    assert (
        report["reference"]["samples"] == 256
        and report["reference"]["from_cache"] is False
        and report["reference"]["kind"] == "raybatch"
    )
    assert report["reference"]["noise_floor"]["relmse"] > 0


def test_errors_are_those_of_the_pictures_that_a_session_renders(reported, saved, session):
    """From their definitions, of a render that had no rounds."""
    _, files, report = reported
    with np.load(files["npz"]) as archive:
        truth = archive["picture"]
    for run in report["runs"]:
        film = session.render(
            load_scene(saved)[0], RenderSettings(sample_count=16, seed=run["seed"], **run["settings"])
        )
        error = (film.passes["Combined"][..., :3].astype(np.float64) - truth) ** 2
        last = run["points"][-1]
        assert last["rmse"] == pytest.approx(math.sqrt(error.mean()), rel=1e-5)
        assert last["relmse"] == pytest.approx((error / (truth**2 + 0.01)).mean(), rel=1e-5)
    noise = (
        load_reference(files["npz"], (20, 16), scene_hash(picture_alone(saved)), RenderSettings()).variance.mean()
        ** 0.5
    )
    assert report["reference"]["noise_floor"]["rmse"] == pytest.approx(noise, rel=1e-5)


def test_flip_is_that_of_its_package(reported, saved, session):
    flip_evaluator = pytest.importorskip(
        "flip_evaluator", reason="FLIP is not installed: the column is null, which another test looks at"
    )
    _, files, report = reported
    with np.load(files["npz"]) as archive:
        truth = archive["picture"][::-1].astype(np.float32)
    run = report["runs"][0]
    film = session.render(load_scene(saved)[0], RenderSettings(sample_count=16, seed=run["seed"], **run["settings"]))
    picture = np.ascontiguousarray(film.passes["Combined"][::-1, :, :3])
    expected = flip_evaluator.evaluate(np.ascontiguousarray(truth), picture, "HDR", inputsRGB=False, applyMagma=False)[
        1
    ]
    assert run["points"][-1]["flip"] == pytest.approx(expected, rel=1e-4)
    assert all(0 < point["flip"] < 1 for each in report["runs"] for point in each["points"])


def test_words_are_for_people(reported):
    done, _, report = reported
    assert (
        done.stdout.startswith("mixed.scene.npz, 20 x 16 pixels")
        and "reference: RayBatch with another seed, 256 samples" in done.stdout
    )
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
    assert (
        text.startswith("<!doctype html>")
        and "prefers-color-scheme: dark" in text
        and page.tags.count("svg") == 2 + flip
    )
    assert not any(each in text for each in ("http:", "https:", "<script", "<link", "@import", "url(http", plots.INK))
    assert all(source.startswith(("#", "data:image/png;base64,")) for source in page.sources)
    assert (
        "currentColor" in text and report["versions"]["warp"] in text and "nee=OFF" in text and "convergence.py" in text
    )
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
    assert (
        "a&lt;b&gt;&amp;$x_$" in text and "Object &lt;img" in text and "<b>&" not in text and "<img src=x" not in text
    )
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
    assert "<svg" in files["svg"].read_text(encoding="utf-8") and plots.INK not in files["svg"].read_text(
        encoding="utf-8"
    )
    measured(capfd, lit, *SMALL, "--samples", "2", "--plot", tmp_path / "p.png", "--no-flip")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
