"""Renders that are killed at random moments go on: `scripts/testing/kill_renders.py` tries it some hundred times."""

import json
import os

import pytest
from testing.kill_renders import table_of

from raybatch_addon.core.scene.archive import save_scene
from tests.support import schedule_scenes
from tests.support.command_line import run_script
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

KILLS = 10


@pytest.mark.skipif(DEVICE != "cpu" or not hasattr(os, "fork"), reason="processes that render are forked, on the CPU")
def test_films_of_killed_renders_are_those_of_others(tmp_path):
    """All passes, and films in halves whose pixels end one by one."""
    scene, report = tmp_path / "mixed.scene.npz", tmp_path / "kills.json"
    save_scene(scene, schedule_scenes.SCENES["mixed"](), schedule_scenes.ESTIMATOR)
    chosen = ("--kills", KILLS, "--variants", "plain", "adaptive", "--json", report)
    done = run_script("testing/kill_renders.py", scene, *chosen)
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(report.read_text())["outcomes"]
    assert sum(each["kills"] for each in outcomes) == KILLS and all(each["films"] for each in outcomes)
    assert sum(each["goings_on"] for each in outcomes) > KILLS / 3
    assert not any(each["faults"] for each in outcomes)


def test_a_report_shows_what_differs():
    outcome = dict(scene="a", variant="plain", kills=3, kills_of_writers=1, goings_on=2, films=1, faults=["gone"])
    text = table_of(dict(date="today", commit="c", seed=1, seconds=2, outcomes=[outcome]))
    assert "| a | plain | 3 | 1 | 2 | 1 | 1 |" in text and "- a, plain: gone" in text
