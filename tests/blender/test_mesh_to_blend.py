"""scripts/mesh_to_blend.py: bare geometry as a .blend."""

import numpy as np
import pytest

from tests.support.command_line import run_script

bpy = pytest.importorskip("bpy")


def test_bad_input_is_an_error_in_a_line(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    done = run_script("mesh_to_blend.py", tmp_path / "bad.npz", tmp_path / "out.blend", "--stage")
    assert done.returncode == 1 and done.stderr.startswith("mesh_to_blend.py: error: "), done.stderr
    np.savez(tmp_path / "lacking.npz", v=np.zeros((3, 3), np.float32))
    done = run_script("mesh_to_blend.py", tmp_path / "lacking.npz", tmp_path / "out.blend", "--stage")
    assert done.returncode == 1 and "f is not a file in the archive" in done.stderr, done.stderr
    assert not (tmp_path / "out.blend").exists()


@pytest.mark.parametrize("flat", [False, True])
def test_normals_are_interpolated_unless_flat_ones_are_asked_for(flat, addon, tmp_path):
    corners = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]])
    np.savez(tmp_path / "fold.npz", v=corners, f=np.int32([[0, 1, 2], [0, 2, 3], [0, 1, 3]]), m=np.int32([0, 0, 7]))
    out = tmp_path / "fold.blend"
    asked = ("--camera=0,0,3,0,0,0,50", "--drop", "7", *(["--flat"] if flat else []))
    done = run_script("mesh_to_blend.py", tmp_path / "fold.npz", out, *asked)
    assert done.returncode == 0 and out.is_file(), done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(out))
    mesh = bpy.data.objects["fold"].data
    assert len(mesh.polygons) == 2
    along_the_fold = [
        normal.vector for loop, normal in zip(mesh.loops, mesh.corner_normals, strict=True) if loop.vertex_index == 0
    ]
    assert (max(abs(a - b) for a, b in zip(*along_the_fold, strict=True)) < 1e-6) == (not flat)
