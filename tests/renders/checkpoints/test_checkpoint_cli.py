"""render.py --checkpoint and merge.py, where there is no Blender: what goes on, what is written, and what is said."""

import json
import signal

import numpy as np
import pytest
from rendering import stops as stops_module
from rendering.stops import StopRequests

from raybatch_addon.core.checkpoint.file import load_kept
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.wavefront.render import rendering
from tests.support import schedule_scenes
from tests.support.command_line import error_line
from tests.support.scripts_here import call_script

ENDLESS = 5_000_000  # samples


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "mixed.scene.npz"
    save_scene(path, schedule_scenes.SCENES["mixed"](), schedule_scenes.ESTIMATOR)
    return path


def call(saved, *arguments):
    return call_script("render.py", saved, "--device", "cpu", *arguments)


def film_of(path) -> dict:
    with np.load(path) as film:
        return {name: film[name] for name in film.files}


def assert_same_files(first, second):
    mine, theirs = film_of(first), film_of(second)
    assert mine.keys() == theirs.keys() and all(np.array_equal(mine[name], theirs[name]) for name in mine)


def stop_after(monkeypatch, looks):
    """The command is asked to stop when it has looked so often since the first path began."""
    left, begun = [looks], []
    run = rendering.Rendering.run

    def run_noted(self):
        begun.append(True)
        run(self)

    def asked(_):
        left[0] -= bool(begun)
        return left[0] < 0

    monkeypatch.setattr(rendering.Rendering, "run", run_noted)
    monkeypatch.setattr(StopRequests, "asked", asked)
    monkeypatch.setattr(rendering, "POLL_SECONDS", 0.001)


def test_a_stopped_command_goes_on_and_reports_what_was_done(saved, tmp_path, monkeypatch):
    checkpoint, out, report = tmp_path / "a.checkpoint", tmp_path / "a.png", tmp_path / "a.json"
    with monkeypatch.context() as patch:
        stop_after(patch, 100)
        many = ("--set", f"sample_count={ENDLESS}", "--set", "ray_count=1000")
        done = call(saved, "--checkpoint", checkpoint, "-o", out, "--json", report, *many)
    assert done.returncode == 130 and not out.exists()
    assert f"stopped; the same render goes on from {checkpoint}" in done.stderr
    reported = json.loads(report.read_text())
    assert not reported["complete"] and reported["samples"] == load_kept(checkpoint).film().sample_total
    assert reported["checkpoint"]["written"] == 1 and reported["checkpoint"]["bytes"] == checkpoint.stat().st_size

    with monkeypatch.context() as patch:
        stop_after(patch, 100)
        done = call(saved, "--checkpoint", checkpoint, *many)
    assert done.returncode == 130 and f"goes on from {checkpoint}: " in done.stderr


def test_a_finished_film_gets_more_samples(saved, tmp_path):
    checkpoint, film, whole = (tmp_path / name for name in ("a.checkpoint", "a.npz", "b.npz"))
    assert call(saved, "--checkpoint", checkpoint).returncode == 0
    more = ("--set", "sample_count=8")
    done = call(saved, "--checkpoint", checkpoint, "--film", film, "--json", "-", *more)
    assert json.loads(done.stdout)["checkpoint"]["samples_before"] == 3
    assert call(saved, "--film", whole, *more).returncode == 0
    assert_same_files(film, whole)


def test_ranges_of_several_calls_are_merged(saved, tmp_path):
    parts = [tmp_path / f"{name}.checkpoint" for name in "abc"]
    for first, part in zip((0, 3, 6), parts, strict=True):
        assert call(saved, "--checkpoint", part, "--sample-first", first).returncode == 0
    out, film, whole = tmp_path / "new/all.checkpoint", tmp_path / "a.npz", tmp_path / "b.npz"
    done = call_script("merge.py", out, *reversed(parts), "--film", film)
    assert done.returncode == 0 and "with samples 0 to 8 of each pixel" in done.stderr
    assert call(saved, "--film", whole, "--set", "sample_count=9").returncode == 0
    assert_same_files(film, whole)
    done = call(saved, "--checkpoint", out, "--film", film, "--json", "-", "--set", "sample_count=9")
    assert json.loads(done.stdout)["rays"]["total"] == 0
    assert_same_files(film, whole)


def test_bad_input_is_reported_in_a_line(saved, tmp_path):
    checkpoint, other = tmp_path / "a.checkpoint", tmp_path / "b.checkpoint"
    assert call(saved, "--checkpoint", checkpoint).returncode == 0
    assert call(saved, "--checkpoint", other, "--set", "seed=1").returncode == 0
    said = error_line(call(saved, "--checkpoint", checkpoint, "--set", "bounce_max=2"))
    assert "begun with bounce_max = 5, and this film has 2; render as it was begun, or name another checkpoint" in said
    for option, value in (("--checkpoint-interval", "soon"), ("--checkpoint-interval", "-1")):
        assert "a number of seconds above 0" in error_line(call(saved, "--checkpoint", checkpoint, f"{option}={value}"))
    assert "give --checkpoint FILE too" in error_line(call(saved, "-o", "a.png", "--checkpoint-interval", 5))
    assert "is no sample" in error_line(call(saved, "--checkpoint", checkpoint, "--sample-first=-1"))
    assert "it is a folder" in error_line(call(saved, "--checkpoint", tmp_path))
    merged = tmp_path / "c.checkpoint"
    for arguments, why in (
        ((merged, checkpoint), "name two checkpoints or more"),
        ((merged, checkpoint, tmp_path / "none"), "there is no file"),
        ((merged, checkpoint, saved), "cannot be read as a checkpoint"),
        ((merged, checkpoint, other), "cannot be merged with"),
        ((merged, checkpoint, other, "--film", "a.exr"), "with the ending .npz"),
        ((tmp_path, checkpoint, other), "it is a folder"),
    ):
        assert why in error_line(call_script("merge.py", *arguments))
    assert not merged.exists()


def test_a_picture_that_cannot_fit_is_refused(saved, tmp_path):
    done = call(saved, "-o", tmp_path / "a.png", "--set", "resolution=65536x65536")
    assert "a picture of 65,536 x 65,536 pixels" in error_line(done) and "lower the resolution" in done.stderr


def test_the_first_signal_asks_and_the_second_ends(monkeypatch):
    before = signal.getsignal(signal.SIGTERM)
    with StopRequests() as stops:
        assert not stops.asked()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)  # as of a process and of its group
        assert stops.asked()
        monkeypatch.setattr(stops_module, "SAME_SECONDS", -1.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before
