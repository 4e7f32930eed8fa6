"""What tests of scripts/benchmark.py measure, and how they know its errors."""

import re
from pathlib import Path

import numpy as np

from raybatch_addon.core.scene.description import Mesh
from tests.support import scenes


def bowl() -> Mesh:
    """The lower half of a sphere that is open above: light gets in, and paths bounce inside."""
    ball = scenes.sphere(segments=24, rings=12)
    centres = ball.positions[ball.triangles].mean(1)
    return Mesh("bowl", ball.positions, ball.triangles[centres[:, 2] < 0.2])


def save_bowl(folder: Path) -> Path:
    """The bowl as a NumPy archive in `folder`."""
    path = folder / "bowl.npz"
    np.savez(path, v=bowl().positions, f=bowl().triangles)
    return path


def assert_one_error(capfd, message: str) -> None:
    """That benchmark.py said one line of error alone, in which `message`, a regular expression, is found."""
    said = capfd.readouterr()
    assert said.out == ""
    (line,) = [line for line in said.err.splitlines() if not line.startswith("[")]
    assert line.startswith("benchmark.py: error: ")
    assert re.search(message, line), line
