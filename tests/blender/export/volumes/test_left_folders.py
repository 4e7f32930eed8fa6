"""Files that volumes are read by go at the end of it, and after a kill at the next start."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.core.device.killed import check_it_goes_at_the_next_start, holding

# Exports a volume object with a modifier, whose grids Blender writes to a file; waits where that is read
HOLD = """
import sys
from types import SimpleNamespace
import bpy
from raybatch_addon.export.meshes import volumes

data = bpy.data.volumes.new("Smoke")
data.filepath = sys.argv[1]
data.grids.load()
obj = bpy.data.objects.new("Smoke", data)
obj.modifiers.new("Displace", "VOLUME_DISPLACE")

def read(path, name):
    print(path, flush=True)
    input()
    raise ValueError("nothing is read")

volumes._openvdb = lambda: SimpleNamespace(read=read)
volumes.export_volume(obj, ["density"], 1, [])
"""


@pytest.fixture
def grid_file(tmp_path):
    bpy.utils.expose_bundled_modules()
    openvdb = pytest.importorskip("openvdb")
    grid = openvdb.FloatGrid()
    grid.name = "density"
    grid.copyFromArray(np.ones((4, 4, 4), np.float32))
    path = tmp_path / "grids.vdb"
    openvdb.write(str(path), [grid])
    return path


@pytest.fixture
def temporary(tmp_path):
    folder = tmp_path / "temporary"
    folder.mkdir()
    return folder


def test_a_file_of_a_killed_blender_is_removed_at_the_next_start(grid_file, temporary):
    with holding(HOLD, temporary, str(grid_file)) as (process, path):
        assert path.name == "made.vdb" and path.stat().st_size > 0
        check_it_goes_at_the_next_start(process, path.parent, temporary)


def test_a_file_goes_when_its_volume_is_read(grid_file, temporary):
    with holding(HOLD, temporary, str(grid_file)) as (process, path):
        assert path.exists()
        process.communicate("\n")
        assert process.returncode == 0 and not path.parent.exists()
