"""Pictures that no memory holds, asked for in a file: an error says so, before anything is rendered."""

import re
import subprocess
import sys

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import reports
from raybatch_addon.blender.result import check_result_fits
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.host_memory import size_text

# the steps of a person: open the file, render, save
RENDER = """
import sys
import bpy
import raybatch_addon
raybatch_addon.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
try:
    bpy.ops.render.render(write_still=True)
except RuntimeError as error:
    print("failed:", error)
"""
SIZE = 65_536  # the largest that Blender takes


def in_the_middle(render, crop):
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x = render.border_min_y = 0.499
    render.border_max_x = render.border_max_y = 0.501


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("whole", "lower the resolution, ask for fewer passes"),
        ("a border in it", "lower the resolution, ask for fewer passes, or turn on Crop to Render Region"),
    ],
)
def test_a_picture_that_does_not_fit_is_refused(lit, tmp_path, part, words):
    lit.render.resolution_x = lit.render.resolution_y = SIZE
    lit.render.resolution_percentage = 100
    if part != "whole":
        in_the_middle(lit.render, crop=False)
    lit.render.filepath = str(tmp_path / "never")
    file = tmp_path / "large.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    done = subprocess.run(
        [sys.executable, "-c", RENDER, str(file)], capture_output=True, text=True, check=False, timeout=300
    )
    (line,) = re.findall("^failed: (.*)$", done.stdout, re.MULTILINE)
    assert f"picture of {SIZE:,} x {SIZE:,} pixels with its passes takes" in line and words in line
    assert "Traceback" not in done.stdout + done.stderr and done.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["large.blend"]


def test_a_small_part_of_a_large_picture_is_rendered_where_blender_crops(lit, films):
    lit.render.resolution_x = lit.render.resolution_y = SIZE // 4
    in_the_middle(lit.render, crop=True)
    assert bpy.ops.render.render() == {"FINISHED"}
    (film,) = films
    assert film.complete and film.passes["Combined"].shape[:2] == (33, 33)


def test_all_passes_of_all_layers_count(lit, monkeypatch):
    lit.render.resolution_x, lit.render.resolution_y, lit.render.resolution_percentage = 200, 100, 50
    lit.view_layers[0].use_pass_z = True
    other = lit.view_layers.new("Other")
    other.use_pass_normal, other.use_pass_z = True, False
    monkeypatch.setattr("raybatch_addon.blender.result.host_memory_free", lambda: 0)
    with pytest.raises(RuntimeError, match="fewer passes"):
        bpy.ops.render.render()
    channels = 4 + 1 + 4 + 3
    assert f"takes {size_text(100 * 50 * channels * 4)} of memory" in reports.last().errors[0]


@pytest.mark.parametrize("views", [1, 2])
def test_layers_that_blender_holds_already_do_not_count_again(lit, monkeypatch, views):
    lit.render.resolution_x, lit.render.resolution_y, lit.render.resolution_percentage = 200, 100, 100
    lit.render.use_multiview = views == 2
    first, second = lit.view_layers[0], lit.view_layers.new("Other")
    lit.view_layers.new("Unused").use = False
    first.use_pass_z, second.use_pass_z, second.use_pass_normal = True, False, True
    of_first, of_second = (200 * 100 * 4 * channels * views for channels in (4 + 1, 4 + 3))
    free = of_second
    monkeypatch.setattr("raybatch_addon.blender.result.host_memory_free", lambda: free)
    check_result_fits(lit, second)
    with pytest.raises(OutOfMemoryError, match=f"takes {size_text(of_first + of_second)} of memory"):
        check_result_fits(lit, first)
    free = of_second - 1
    with pytest.raises(OutOfMemoryError, match=f"takes {size_text(of_second)} of memory"):
        check_result_fits(lit, second)
