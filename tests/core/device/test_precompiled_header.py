"""Threads and processes that compile for the CPU share what was read of Warp's header; what is left of it goes."""

import os
import subprocess
import sys
import tempfile
import time

import pytest

from raybatch_addon.core.device import precompiled_header
from raybatch_addon.core.device.kernel import OPTIMISATION
from tests.core.device.killed import ROOT, check_it_goes_at_the_next_start, holding, start_another

COMPILE = """
import sys, threading
import warp as wp
from raybatch_addon.core.device.devices import start_warp
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS

start_warp(sys.argv[1])

def compiled(name):
    @wp.kernel(**KERNEL_OPTIONS)
    def kernel(values: wp.array(dtype=float)):
        values[wp.tid()] = wp.static(float(name))

    values = wp.zeros(1, dtype=float, device="cpu")
    wp.launch(kernel, 1, [values], device="cpu")
    assert values.numpy()[0] == name

threads = [threading.Thread(target=compiled, args=(int(name),)) for name in sys.argv[2:]]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def compile_kernels(folder, *names):
    script = folder / "compile.py"  # Warp reads the source of kernels from a file
    script.write_text(COMPILE, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, str(script), str(folder), *names]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def parsed_headers(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.pch")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cpu_compiler):
    folder = tmp_path_factory.mktemp("kernels")
    compile_kernels(folder, "1", "2", "3")
    return folder


def test_threads_share_one(folder):
    assert len(parsed_headers(folder)) == 1


def test_the_next_process_uses_it(folder):
    before = parsed_headers(folder)
    compile_kernels(folder, "4")
    assert before and parsed_headers(folder) == before


def test_one_that_is_gone_is_made_again(folder):
    (path,) = parsed_headers(folder)
    path.unlink()
    compile_kernels(folder, "5")
    assert list(parsed_headers(folder)) == [path]


def test_each_optimisation_has_its_own(folder, monkeypatch):
    """By its name the level is what the compiler was given."""
    before = parsed_headers(folder)
    monkeypatch.setenv(OPTIMISATION, "0")
    compile_kernels(folder, "6", "7")
    (path,) = parsed_headers(folder).keys() - before.keys()
    assert "_o0_" in path.name and path.parent not in {each.parent for each in before}


# A process with a temporary folder for Warp's header, which waits for a line
HOLD = """
import sys
import warp as wp
wp.config.log_level = wp.LOG_ERROR
if sys.argv[1] == "raybatch":
    from raybatch_addon.core.device.devices import start_warp
    start_warp()
wp.init()
if sys.argv[2:] == ["spare"]:
    from pathlib import Path
    from raybatch_addon.core.device.kept_kernels import spare_folder
    print(spare_folder(Path("full"), OSError(28, "no room")).parent, flush=True)
else:
    print(wp._src.context.runtime._get_or_create_pch_dir(), flush=True)
input()
"""


@pytest.mark.parametrize("what, prefix", [([], "wp_pch_"), (["spare"], "raybatch-kernels-")])
def test_a_folder_of_a_killed_process_is_removed_at_the_next_start(what, prefix, tmp_path):
    with holding(HOLD, tmp_path, "raybatch", *what) as (process, folder):
        assert folder.parent == tmp_path and folder.name.startswith(prefix)
        (folder / "builtin.pch").write_bytes(b"parsed")
        check_it_goes_at_the_next_start(process, folder, tmp_path)


@pytest.mark.parametrize("began, stays", [([], False), ([-60.0, 60.0], True), ([60.0], False), ([0.0], True)])
def test_a_folder_without_an_owner_goes_where_no_process_is_as_old(began, stays, tmp_path, monkeypatch):
    folder = tmp_path / "wp_pch_x"
    folder.mkdir()
    made = folder.stat().st_mtime
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(precompiled_header, "_processes_with_warp", lambda: [made + each for each in began])
    precompiled_header.remove_left_folders()
    assert folder.exists() == stays


def test_processes_with_warp_are_seen(tmp_path):
    before = time.time()
    with holding(HOLD, tmp_path, "warp"):
        assert any(before - 2 <= began <= time.time() for began in precompiled_header._processes_with_warp()) or (
            sys.platform != "linux"  # where each folder without an owner stays
        )


def test_a_folder_goes_with_its_process(tmp_path):
    with holding(HOLD, tmp_path, "raybatch") as (process, folder):
        process.communicate("\n")
        assert process.returncode == 0 and not folder.exists()


def test_other_folders_stay(tmp_path):
    (tmp_path / "wp_other").mkdir()
    (tmp_path / "raybatch-kernels-of-old").mkdir()  # nobody tells whose it is
    (tmp_path / "wp_pch_file").write_bytes(b"")
    start_another(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"wp_other", "wp_pch_file", "raybatch-kernels-of-old"}
