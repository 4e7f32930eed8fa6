"""The study of the streaming schedule: what is measured, and its tables."""

import pytest
from studies import scenes
from studies.registry import STUDIES
from studies.streaming.cases import BATCHINGS, EDGE, FRAMES, SCENES, SCHEDULES
from studies.streaming.results import over_wavefront, range_over_median
from studies.study import Options, groups_of

STUDY = STUDIES["streaming"]
MACHINE = {"device": {"alias": "cpu", "cores": 2}, "device_kind": "cpu", "quick": True, "versions": {}}


def row(scene: str, batching: str, schedule: str, turn: int, seconds: float | None, film: str = "alike") -> dict:
    what = {"scene": scene, "batching": batching, "schedule": schedule, "turn": turn}
    case = f"{scene} {batching} {schedule}"
    return {"case": case, "seconds": seconds, "rays": 2_000_000, "film": film, "complete": True, **what}


def test_both_schedules_take_turns_within_a_scene_and_batching():
    groups = groups_of(STUDY.cases(Options()))
    assert set(groups) == {f"{scene} {batching}" for scene in SCENES for batching in BATCHINGS}
    assert all([case.what["schedule"] for case in group] == list(SCHEDULES) for group in groups.values())
    assert set(SCENES) - {"room"} <= set(scenes.FILES), "files that are looked for before time is spent"


class Watched:
    """A bench that renders nothing."""

    def __init__(self, options: Options):
        self.options = options

    def scene(self, key, make):
        return make()

    def timed(self, scene, settings, warm):
        return {"frame": (scene.frame.width, scene.frame.height), "settings": settings, "warm": warm}


@pytest.mark.parametrize("cuda", (False, True))
def test_a_case_is_what_is_rendered(cuda, monkeypatch):
    asked = []

    def stand_in(name, options, *sizes):
        asked.append((name, *sizes))
        return scenes.room(8, 8)

    monkeypatch.setattr(scenes, "grid", stand_in)
    monkeypatch.setattr(scenes, "under_the_sky", stand_in)
    options = Options(is_cuda=cuda)
    for case in STUDY.cases(options):
        found = STUDY.measure(case, 0, Watched(options))
        assert (*found["frame"], found["settings"].sample_count) == FRAMES[cuda][1]
        assert (found["settings"].batching, found["settings"].schedule) == (
            case.what["batching"],
            case.what["schedule"],
        )
        assert found["warm"] == case.key, "each case has a render that loads its kernels"
    assert set(asked) == {("bunny", 4 if cuda else 1, EDGE)} | {
        (name, EDGE) for name in SCENES if name not in ("room", "bunny")
    }


def test_tables_and_ratios():
    rows = [
        row("room", batching, schedule, turn, seconds)
        for (batching, schedule), times in {
            ("OFF", "WAVEFRONT"): (1.0, 1.0, 3.0),
            ("OFF", "STREAMING"): (2.0, 2.5, 6.0),
            ("ON", "WAVEFRONT"): (8.0, 8.0, 8.0),
            ("ON", "STREAMING"): (4.0, 4.0, 4.0),
        }.items()
        for turn, seconds in enumerate(times)
    ]
    rows.append({"case": "hotel OFF WAVEFRONT", "scene": "hotel", "turn": 0, "seconds": None, "refused": "no room"})
    report = {"rows": rows, **MACHINE}
    assert over_wavefront(rows, "room", "ON", "ON") == 0.5
    assert over_wavefront(rows, "room", "OFF", "OFF") == 2.0, "within a turn: the last was slow for both"
    assert over_wavefront(rows, "room", "ON", "OFF") == 4.0
    assert over_wavefront(rows, "hotel", "OFF", "OFF") is None
    assert range_over_median(rows) == 2.0
    text = STUDY.fragment({"cpu": report})
    assert "| room | 2.00 | 0.50 | 4.00 | 2 |" in text and "hotel" not in text
    assert "All 12 films" in text
    rows[1]["film"] = "another"
    assert "**Films differ**" in STUDY.fragment({"cpu": report})
