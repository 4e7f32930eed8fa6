"""The tables of docs/studies/lineage.md are made of data, and name what there is."""

import re
from pathlib import Path

import pytest
from tables import lineage_table
from tables.lineage import figures
from tables.lineage.figures import extent, hardware_beyond
from tables.lineage.rows import HARDWARE, RIVALS, THESIS

from raybatch_addon.core.settings.presets import PRESETS
from raybatch_addon.core.settings.settings import SETTINGS
from tests.support.command_line import ROOT

ROWS = THESIS + RIVALS + HARDWARE


def test_the_page_is_up_to_date():
    assert lineage_table.main(["--check"]) == 0, "run python scripts/tables/lineage_table.py"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.system)
def test_a_row_names_code_and_settings_that_there_are(row):
    assert (ROOT / row.code).is_file()
    for name in re.findall(r"`([a-z_]+)[`=]", row.setting):
        assert name in SETTINGS or name in map(str.lower, PRESETS), name


def test_no_rival_and_no_way_to_schedule_is_left_out():
    from benchmarking.tracers.rivals.registry import RIVALS as REGISTERED

    settings = " ".join(row.setting for row in ROWS)
    assert all(f"--rival {name}`" in settings for name in REGISTERED)
    for name in ("bucket_selection", "top_level_traversal"):
        left = [str(choice[0]) for choice in SETTINGS[name].choices if choice[0] not in settings]
        assert set(left) <= {"AUTO", "NAIVE", "NEXT", "RANDOM"}


def test_ranges_are_over_scenes():
    assert extent([0.456, 2.0, 1.0]) == "0.46–2.00" and extent([1.001, 1.0]) == "1.00" and extent([]) == "–"
    with pytest.raises(ValueError, match="has no policy 'none'"):
        hardware_beyond("none")
    assert Path(lineage_table.PAGE).is_file()


def row(case: str, turn: int, seconds: float | None, **what) -> dict:
    return {"case": case, "turn": turn, "seconds": seconds, **what}


def test_rates_are_of_turns_and_faster_is_more(monkeypatch):
    rows = [
        row("a bounce1 ALL NAIVE", 0, 3.0, scene="a"),
        row("a bounce1 ALL LONG_HAUL", 0, 6.0, scene="a"),
        row("a bounce1 ALL NAIVE", 1, 30.0, scene="a"),
        row("a bounce1 ALL LONG_HAUL", 1, 60.0, scene="a"),
        row("b bounce1 ALL NAIVE", 0, 3.0, scene="b"),
        row("b bounce1 ALL LONG_HAUL", 0, 2.0, scene="b"),
        row("c bounce1 ALL NAIVE", 0, 2.0, scene="c"),
        row("c bounce1 ALL LONG_HAUL", 0, None, scene="c"),
    ]
    monkeypatch.setattr(figures, "_rows", lambda name: rows)
    assert figures.top_level_rates("LONG_HAUL").endswith(": bounce 1 0.50–1.50")


def test_whole_renders_are_over_those_whose_rays_do_not_wait(monkeypatch):
    seconds = {"OFF WAVEFRONT": 1.0, "OFF STREAMING": 2.0, "ON WAVEFRONT": 5.0, "ON STREAMING": 4.0}
    rows = [row(f"room {name}", 0, each, scene="room") for name, each in seconds.items()]
    monkeypatch.setattr(figures, "_rows", lambda name: rows)
    assert figures.streaming("cuda") == "whole renders, batching OFF 0.50, ON 0.25"
