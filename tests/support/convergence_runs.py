"""What tests of scripts/convergence.py render, and how they run it."""

import dataclasses
import json
from pathlib import Path

import convergence
import pytest

from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.under_test import DEVICE

FRAME = scenes.Frame(20, 16)
SMALL = ("--device", DEVICE, "--runs", "2")


def save_lit(folder: Path) -> Path:
    """A floor under a lamp, saved in `folder`: every path is short, and noise even."""
    path = folder / "lit.scene.npz"
    view = scenes.camera(eye=(0, 0, 3), up=(0, 1, 0))
    scene = scenes.scene(
        [(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], view=view, frame=FRAME, lights=[scenes.area_light(3.0)]
    )
    save_scene(path, scene, RenderSettings(bounce_max=1))
    return path


def picture_alone(path: Path) -> Scene:
    """The saved scene with the picture as its only pass, as the script renders it."""
    scene, _ = load_scene(path)
    return dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=("Combined",)))


def measured(capfd, *arguments) -> dict:
    """The JSON of a run."""
    code = convergence.main([*map(str, arguments), "--json"])
    said = capfd.readouterr()
    if "wp_compile_cpp" in said.err:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert code == 0, said.err
    return json.loads(said.out)
