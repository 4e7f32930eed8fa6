"""Files that are no scenes, and pictures that cannot be written, as scripts/render.py says them."""

import os

import pytest

pytest.importorskip("bpy")

from tests.support.command_line import error_line, run_script
from tests.support.scripts_here import call_script


def said(*arguments, call=call_script) -> str:
    """What the script says in its one line."""
    return error_line(call("render.py", *arguments))


def test_files_that_are_no_blend(tmp_path):
    junk, picture = tmp_path / "junk.blend", tmp_path / "x.png"
    junk.write_text("junk")
    assert "junk.blend is not a .blend file: save it in Blender" in said(junk, "-o", picture, call=run_script)
    junk.write_bytes(b"BLENDER-v500 and no more")
    assert "junk.blend cannot be opened" in said(junk, "-o", picture)
    junk.write_text("version https://git-lfs.github.com/spec/v1")
    assert "junk.blend is a pointer of Git LFS" in said(junk, "-o", picture)
    assert "there is no file" in said(tmp_path / "none.blend", "-o", picture)
    assert os.listdir(tmp_path) == ["junk.blend"]
