"""Two Blenders that render at once, and lack the same kernels."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from raybatch_addon.core.device.kept_kernels import KernelFiles, is_as_written
from tests.support.running.general_kernels import put_general_kernels
from tests.support.under_test import DEVICE

ROOT = Path(__file__).resolve().parents[3]
LACKING = ("settle_kernel", "add_spill_kernel")  # which the render needs, and which are small
SECONDS_MOST = 300

# A Blender that renders a cube once it is told to, and says what it found and which kernels it compiled
PROCESS = """
import json, sys
import bpy
import numpy as np
import warp as wp
import raybatch_addon
from raybatch_addon.blender import frame, reports
raybatch_addon.register()
compile_module, compiled, films = wp.Module._compile, [], []
def noted(module, *arguments, **options):
    compiled.append(module.name)
    return compile_module(module, *arguments, **options)
wp.Module._compile = noted
frame.film_listeners.append(lambda _layer, _scene, film: films.append(film))
scene = bpy.context.scene
scene.render.engine, scene.raybatch.device, scene.raybatch.sample_count = "RAYBATCH", "cpu", 2
scene.render.resolution_x = scene.render.resolution_y = 32
print("ready", flush=True)
sys.stdin.readline()
bpy.ops.render.render()
(film,) = films
np.save(sys.argv[1], film.passes["Combined"])
print(json.dumps([compiled, film.statistics["warnings"], reports.last().errors]))
"""


@pytest.mark.skipif(DEVICE != "cpu", reason="general kernels take minutes to compile for a GPU")
def test_both_compile_what_both_lack(tmp_path):
    """Each has the picture, neither says a word, and each kernel is there once, whole and sealed."""
    kept = tmp_path / "kernels"
    for module in put_general_kernels(kept):
        if module.name.removeprefix("wp_").startswith(LACKING):
            shutil.rmtree(module)
    (folder,) = kept.iterdir()
    missing: set[str] = set()
    pictures = [tmp_path / f"{number}.npy" for number in range(2)]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "RAYBATCH_KERNEL_CACHE": str(kept),
        "WARP_CACHE_PATH": str(kept),
        "RAYBATCH_KERNEL_TIER": "GENERAL",
    }
    both = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, str(picture)], env=environment, stdin=-1, stdout=-1, stderr=-1, text=True
        )
        for picture in pictures
    ]
    try:
        assert [process.stdout.readline() for process in both] == ["ready\n"] * 2
        for process in both:
            process.stdin.write("\n")
            process.stdin.flush()
        for process in both:
            output, complaints = process.communicate(timeout=SECONDS_MOST)
            assert (process.returncode, complaints) == (0, "")
            compiled, warnings, errors = json.loads(output.strip().splitlines()[-1])
            assert (warnings, errors) == ([], [])
            missing |= set(compiled)
    finally:
        for process in both:
            process.kill()
    assert {name.rpartition("_")[0] for name in missing} == set(LACKING)
    first, second = (np.load(picture) for picture in pictures)
    assert np.array_equal(first, second) and first[..., :3].std() > 0
    for name in missing:
        (module,) = folder.glob(f"wp_{name}_*")
        assert {path.suffix for path in module.iterdir()} == {".o", ".meta", ".sum", ".cpp"}
        assert all(_is_sealed(each) for each in module.glob("*.o"))
    assert not [path for path in folder.iterdir() if re.search(r"_p\d+_t\d+$", path.name)], "nothing half done"
    assert len(list(folder.glob("header-*/*.pch"))) == 1


def _is_sealed(binary: Path) -> bool:
    (meta,) = binary.parent.glob("*.meta")
    return is_as_written(KernelFiles(binary, meta))
