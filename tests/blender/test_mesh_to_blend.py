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
    assert done.returncode == 1 and "has no array f" in done.stderr, done.stderr
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


def test_files_that_blender_imports_are_read_too(addon, tmp_path):
    """In the axes of the file; what is there twice, as two objects, is there twice."""
    for number in (0, 1):
        shape = "".join(f"v {x + 3 * number} {y} {z}\n" for x, y, z in ((0, 0, 0), (1, 0, 0), (0, 2, 0)))
        with (tmp_path / "two.obj").open("a") as file:
            file.write(f"o part{number}\n{shape}f {3 * number + 1} {3 * number + 2} {3 * number + 3}\n")
    with (tmp_path / "two.obj").open("a") as file:
        file.write("v 50 50 50\n")  # of no face
    out = tmp_path / "made" / "two.blend"  # in a folder that is not there yet
    done = run_script("mesh_to_blend.py", tmp_path / "two.obj", out, "--stage")
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(out))
    mesh = bpy.data.objects["two"].data
    found = np.array(sorted(tuple(np.round(vertex.co, 6)) for vertex in mesh.vertices))
    assert found == pytest.approx(np.array([(0, 0, 0), (0, 0, 2), (1, 0, 0), (3, 0, 0), (3, 0, 2), (4, 0, 0)]))
    assert len(mesh.polygons) == 2


@pytest.mark.parametrize(
    "name, more, text",
    [
        ("none.npz", (), "there is no file"),
        ("two.stl", (), "cannot be read: convert it to one of .npz, .obj, .ply, .gltf, .glb"),
        ("two.glb", ("--up", "z"), "glTF has y up"),
        ("some.npz", ("--drop", "1"), "has no array m"),
        ("some.obj", ("--drop", "1"), "--drop names materials of an .npz"),
    ],
)
def test_what_cannot_be_made_is_said_in_a_line(name, more, text, tmp_path):
    np.savez(tmp_path / "some.npz", v=np.eye(3, dtype=np.float32), f=np.int32([[0, 1, 2]]))
    (tmp_path / "some.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    done = run_script("mesh_to_blend.py", tmp_path / name, tmp_path / "out.blend", "--stage", *more)
    assert done.returncode == 1 and text in done.stderr and done.stderr.count("\n") == 1, done.stderr
