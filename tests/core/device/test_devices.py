"""Devices, and what Warp says when it starts."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


def run(code):
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)


def test_warp_starts_without_a_word():
    done = run("from raybatch_addon.core.device.devices import find_device; find_device('cpu')")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_device_that_is_not_there_is_an_error_that_lists_those_that_are():
    done = run("from raybatch_addon.core.device.devices import find_device; find_device('cuda:99')")
    assert done.returncode and "Warp CUDA warning" not in done.stderr
    assert "there is no device 'cuda:99': choose one of AUTO, cpu" in done.stderr


def test_what_else_is_written_meanwhile_is_kept():
    done = run("""
import os, sys
from raybatch_addon.core.device import devices
def init():
    for start in devices._NO_CUDA:
        os.write(2, start + b". It is gone.\\n")
    os.write(2, b"Warp CUDA error 2: out of memory\\n")
    print("from Python", file=sys.stderr)
    raise RuntimeError("no Warp today")
devices.wp.init = init
devices.start_warp()
""")
    lines = done.stderr.splitlines()
    assert lines[:2] == ["Warp CUDA error 2: out of memory", "from Python"]
    assert lines[-1] == "RuntimeError: no Warp today" and "It is gone" not in done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="it closes a file descriptor of a process of its own")
def test_warp_starts_where_there_is_no_standard_error():
    done = run("""
import os
os.close(2)
from raybatch_addon.core.device.devices import find_device
print(find_device("cpu"))
""")
    assert (done.returncode, done.stdout) == (0, "cpu\n")


def test_warp_starts_where_no_temporary_file_can_be_made():
    done = run("""
import tempfile
tempfile.tempdir = "/nowhere"
from raybatch_addon.core.device.devices import find_device
print(find_device("cpu"))
""")
    assert (done.returncode, done.stdout) == (0, "cpu\n"), done.stderr
