"""Handlers of nodes need Blender only to read its data: graphs can be built and closures tested without it."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
CODE = """
import sys

class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("bpy", "mathutils", "bmesh"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, NoBlender())
import raybatch_addon.export.nodes.compile
"""


def test_handlers_are_imported_without_blender():
    done = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
