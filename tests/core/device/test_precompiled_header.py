"""Threads and processes that compile for the CPU share what was read of Warp's header."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
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
def folder(tmp_path_factory):
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
