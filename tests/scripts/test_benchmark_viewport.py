"""scripts/benchmark.py viewport: edits of every kind are shown, and what is reported for them."""

import json

import pytest
from benchmarking.viewport import EDITS, Watch

from raybatch_addon.core.errors import DeviceError
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.export.live.live_scene import is_same
from tests.core.wavefront.scene.edited import edited_scene
from tests.support.scenes import mixed
from tests.support.scripts_here import call_script


@pytest.mark.parametrize("kind", EDITS)
def test_an_edit_makes_another_scene_each_time_and_leaves_the_first_as_it_was(kind):
    scene, untouched = mixed(), mixed()
    first, second = EDITS[kind](scene, 1), EDITS[kind](scene, 2)
    assert not is_same(scene, first) and not is_same(first, second)
    assert is_same(scene, untouched)


@pytest.mark.parametrize("kind", ["value", "graph"])
def test_programs_of_few_constants_change_too(kind):
    scene = edited_scene()
    first, second = EDITS[kind](scene, 1), EDITS[kind](scene, 2)
    assert not is_same(scene, first) and not is_same(first, second)


def test_every_kind_of_edit_is_timed(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarking.viewport.PAUSE_SECONDS", 0.0)
    monkeypatch.setenv("RAYBATCH_KERNEL_TIER", "GENERAL")
    path = tmp_path / "mixed.scene.npz"
    save_scene(path, mixed(Frame(32, 24)), RenderSettings())
    done = call_script(
        "benchmark.py", "viewport", path, "--device", "cpu", "--runs", 2, "--samples", 4, "--json", tmp_path / "r.json"
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert [each["edit"] for each in report["edits"]] == list(EDITS)
    assert all(0 < each["median"] <= each["p95"] <= each["most"] for each in report["edits"])
    assert report["frame"] == {"width": 32, "height": 24} and report["edits_of_each_kind"] == 2
    assert all(kind in done.stdout for kind in EDITS)


def test_a_render_that_fails_ends_the_benchmark():
    class Broken:
        def render(self, *_, **__):
            raise DeviceError("the device is gone")

    watch = Watch(Broken(), RenderSettings(sample_count=1))
    with pytest.raises(DeviceError, match="the device is gone"):
        watch.show(mixed())
    watch.render.close()
    assert watch.render.join(10)
