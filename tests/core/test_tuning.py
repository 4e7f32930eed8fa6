"""Schedules are tried one beside another: the fastest is reported, and none with another film is offered."""

from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.errors import RayBatchError, SettingsError
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.tuning import tune

AUTO = {"batching": {"value": "OFF"}, "ray_sort": {"value": "OFF"}, "hit_sort": {"value": "OFF"}}


class Renders:
    """Stands in for renders: how long a sample takes, by settings."""

    def __init__(self, seconds, bits=lambda settings: 0.0):
        self.seconds, self.bits, self.asked = seconds, bits, []

    def __call__(self, settings, cancelled, on_progress):
        self.asked.append(settings)
        on_progress(SimpleNamespace(stage="render"))
        pixels = np.full((2, 2, 4), self.bits(settings), np.float32)
        alias = "cpu" if settings.device == "AUTO" else settings.device
        statistics = {
            "seconds": {"render": self.seconds(settings) * settings.sample_count},
            "device": {"alias": alias},
            "devices": [{"alias": each} for each in alias.split(",")],
            "auto": AUTO,
            "kernels": {"tier": "GENERAL"},
            "schedule": {"ray_count": 1000},
        }
        return SimpleNamespace(complete=not cancelled(), statistics=statistics, passes={"Combined": pixels})


def changes(tuning):
    return [trial.changes for trial in tuning.trials]


def test_what_is_faster_is_kept_and_tried_with_the_rest():
    renders = Renders(lambda each: 0.5 - 0.2 * (each.batching == "ON") - 0.1 * (each.ray_count == 2000))
    tuning, film = tune(RenderSettings(), [], renders, 2.0)
    assert tuning.samples == 4 and tuning.ended and film.complete
    assert changes(tuning) == [
        {},
        {"batching": "ON"},
        {"batching": "ON", "ray_sort": "ON"},
        {"batching": "ON", "hit_sort": "ON"},
        {"batching": "ON", "ray_count": 500},
        {"batching": "ON", "ray_count": 2000},
    ]
    assert tuning.best.changes == {"batching": "ON", "ray_count": 2000}
    assert tuning.best.seconds == pytest.approx(0.2)
    assert [each.sample_count for each in renders.asked] == [1, *[4] * 8], "all render the same samples"
    assert [each.ray_count for each in renders.asked[-2:]] == [0, 2000], "first and fastest are looked at twice"


def test_a_machine_that_had_other_work_at_first_decides_nothing():
    count = []

    def seconds(_settings):
        count.append(1)
        return 0.9 if len(count) == 2 else 0.3

    tuning, _ = tune(RenderSettings(), [], Renders(seconds), 2.0)
    assert tuning.best.changes == {} and tuning.best.seconds == pytest.approx(0.3)


def test_noise_of_the_clock_changes_nothing():
    tuning, _ = tune(RenderSettings(), [], Renders(lambda each: 0.5 - 0.01 * (each.ray_sort == "ON")), 2.0)
    assert tuning.best.changes == {}


def test_what_ends_by_clock_or_error_is_off_and_kernels_stay_the_same():
    given = RenderSettings(time_limit=1.0, adaptive_sampling="ON", error_target=0.1, denoise="ON", sample_count=3)
    renders = Renders(lambda _: 0.1)
    tuning, _ = tune(given, [], renders, 60.0)
    assert tuning.samples == 3, "no more than the picture has"
    for each in renders.asked:
        assert (each.time_limit, each.adaptive_sampling, each.error_target, each.denoise) == (0, "OFF", 0, "OFF")
    assert [each.kernel_tier for each in renders.asked] == ["AUTO", *["GENERAL"] * (len(renders.asked) - 1)]


def test_devices_are_tried_and_each_has_bits_of_its_own():
    renders = Renders(lambda each: 0.1 if each.device == "cuda:0" else 0.5, lambda each: float(each.device == "cuda:0"))
    tuning, _ = tune(RenderSettings(device="cpu"), ["cuda:0"], renders, 1.0)
    assert changes(tuning)[1] == {"device": "cuda:0"} and tuning.best.changes["device"] == "cuda:0"
    assert all(trial.same_bits for trial in tuning.trials)
    assert {each.kernel_tier for each in renders.asked if each.device == "cuda:0"} == {"AUTO"}, "nothing is compiled"


def test_rays_alive_are_tried_as_each_of_several_devices_has_them():
    tuning, _ = tune(RenderSettings(device="cuda:0,cuda:1"), [], Renders(lambda _: 0.5), 1.0)
    assert [each["ray_count"] for each in changes(tuning) if "ray_count" in each] == [250, 1000]


def test_another_film_is_reported_and_never_offered():
    renders = Renders(
        lambda each: 0.1 if each.batching == "ON" else 0.5, lambda each: float(each.batching == "ON") * 1e-7
    )
    tuning, _ = tune(RenderSettings(), [], renders, 1.0)
    assert [trial.same_bits for trial in tuning.trials][:2] == [True, False]
    assert tuning.best.changes == {}


def test_candidates_that_cannot_be_are_reported():
    def seconds(settings):
        if settings.batching == "OFF":
            raise RayBatchError("the tree does not fit")
        return 0.5

    tuning, _ = tune(RenderSettings(batching="ON"), [], Renders(seconds), 1.0)
    assert tuning.trials[1].why == "the tree does not fit" and tuning.trials[1].seconds is None
    given = RenderSettings(batching="ON", geometry_budget=10**6)
    tuning, _ = tune(given, [], Renders(lambda _: 0.5), 1.0)
    assert "geometry_budget" in tuning.trials[1].why, "settings that do not go together are no candidate"
    with pytest.raises(SettingsError):

        def broken(_settings):
            raise SettingsError("no camera")

        tune(RenderSettings(), [], Renders(broken), 1.0)


def test_a_stop_keeps_what_was_tried():
    stops = iter([False] * 6)
    tuning, film = tune(RenderSettings(), [], Renders(lambda _: 0.5), 1.0, cancelled=lambda: next(stops, True))
    assert not tuning.ended and film is not None and 1 <= len(tuning.trials) < 6
    tuning, film = tune(RenderSettings(), [], Renders(lambda _: 0.5), 1.0, cancelled=lambda: True)
    assert film is None and tuning.trials == [] and tuning.best is None


def test_what_is_slow_is_given_up(monkeypatch):
    monkeypatch.setattr("raybatch_addon.core.tuning._MOMENT", -1e9)
    tuning, _ = tune(RenderSettings(), [], Renders(lambda _: 0.5), 1.0)
    assert [trial.why for trial in tuning.trials] == ["", *["slower"] * 5]
    assert tuning.best is tuning.trials[0]
