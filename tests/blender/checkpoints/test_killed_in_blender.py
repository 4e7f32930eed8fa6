"""Renders in Blender that are killed go on: `scripts/testing/kill_renders.py` does the same of any file."""

import json
import os

import pytest

from tests.support.command_line import run_script
from tests.support.under_test import DEVICE

bpy = pytest.importorskip("bpy")

KILLS = 3  # in a thorough run


@pytest.mark.skipif(DEVICE != "cpu" or os.name == "nt", reason="processes are killed by SIGKILL, on the CPU")
def test_a_film_of_killed_blenders_is_that_of_one_nobody_killed(scene, tmp_path, pytestconfig):
    kills = KILLS if pytestconfig.option.thorough else 2
    bpy.ops.mesh.primitive_monkey_add(size=2)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.2, 0.4, 0.6)
    scene.view_layers[0].use_pass_normal = True
    blend, report = tmp_path / "scene.blend", tmp_path / "kills.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True)
    done = run_script("testing/kill_renders.py", blend, "--kills", kills, "--variants", "plain", "--json", report)
    assert done.returncode == 0, done.stderr
    (outcome,) = json.loads(report.read_text())["outcomes"]
    # each was killed once it had kept samples, and the next one found them
    assert outcome["kills"] == outcome["goings_on"] == kills and outcome["films"]
    assert not outcome["faults"]
