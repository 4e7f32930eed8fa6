"""Headers become the body of a native function: macros end with it, and compilers name the header and the line."""

import importlib.util
import os
import subprocess
import sys

import pytest

from raybatch_addon.core.native import build
from raybatch_addon.core.native.build import native_source
from tests.support.command_line import ROOT

HEADERS = sorted(build.FOLDER.rglob("*.h"))

# Compiles a kernel whose native function calls what is not there, for sys.argv[1]; sys.argv[2] is a folder for it
FAULTY = """
import sys
from pathlib import Path
import warp as wp
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native import build

folder = Path(sys.argv[2])
build.FOLDER = folder
(folder / "sound.h").write_text("const int two = TWO;\\n\\n")
(folder / "faulty.h").write_text("const int three = two + 1;\\nconst int four = is_not_there(three);\\n")

@wp.func_native(build.native_source("sound.h", "faulty.h", TWO=2))
def faulty(): ...

@wp.kernel(**KERNEL_OPTIONS)
def kernel():
    faulty()

wp.config.kernel_cache_dir = str(folder / "kernels")
device = {"device": "cpu"} if sys.argv[1] == "cpu" else {"arch": 90}
wp.compile_aot_module(kernel.module, module_dir=folder / "module", **device)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of headers in place of the package's own."""
    monkeypatch.setattr(build, "FOLDER", tmp_path)
    build._read.cache_clear()
    yield tmp_path
    build._read.cache_clear()


def test_headers_are_put_together_in_order_and_leave_no_macro(folder):
    (folder / "a.h").write_text("#define INLINE inline\n    # define OTHER 1\nint a = COUNT;\n")
    (folder / "b.h").write_text("float b = SIZE;\n")
    assert native_source("a.h", "b.h", COUNT=3, SIZE=0.5).split("\n") == [
        "",
        "#define COUNT 3",
        "#define SIZE 0x1.0000000000000p-1f",
        '#line 1 "raybatch native: a.h"',
        "#define INLINE inline",
        "    # define OTHER 1",
        "int a = COUNT;",
        '#line 1 "raybatch native: b.h"',
        "float b = SIZE;",
        '#line 1 "raybatch native: end"',
        "#undef COUNT",
        "#undef SIZE",
        "#undef INLINE",
        "#undef OTHER",
        "",
    ]


@pytest.mark.parametrize(
    "value, literal", [(True, "1"), (False, "0"), (-2, "(-2)"), (-0.5, "(-0x1.0000000000000p-1f)"), ("other", "other")]
)
def test_values_are_spelt_as_in_cpp(folder, value, literal):
    assert f"#define VALUE {literal}\n" in native_source(VALUE=value)


def test_what_has_no_literal_is_refused():
    with pytest.raises(ValueError, match="inf has no literal"):
        native_source(VALUE=float("inf"))


@pytest.mark.parametrize(
    "device, condition", [("cpu", "#if !defined(__CUDA_ARCH__)"), ("cuda", "#if defined(__CUDA_ARCH__)")]
)
def test_a_function_of_one_device_is_empty_on_the_other(device, condition):
    lines = native_source(device=device, VALUE=1).split("\n")
    assert lines[1] == condition and lines[-2] == "#endif"


@pytest.mark.parametrize("target", ["cpu", "cuda"])
def test_compilers_name_the_header_and_the_line(target, tmp_path, request):
    if target == "cpu":
        request.getfixturevalue("cpu_compiler")
    script = tmp_path / "faulty.py"  # Warp reads the source of kernels
    script.write_text(FAULTY)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, str(script), target, str(tmp_path)], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    said = done.stdout + done.stderr
    if target == "cuda" and "not built with CUDA" in said:
        pytest.skip("this Warp was built without CUDA")
    assert done.returncode != 0
    assert "raybatch native: faulty.h:2:" in said or "raybatch native: faulty.h(2)" in said, said
    assert "is_not_there" in said


@pytest.mark.skipif(importlib.util.find_spec("clang_format") is None, reason="clang-format is not installed")
@pytest.mark.parametrize("header", HEADERS, ids=lambda path: path.relative_to(build.FOLDER).as_posix())
def test_headers_are_formatted(header):
    from clang_format import get_executable

    command = [get_executable("clang-format"), "--dry-run", "--Werror", str(header)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
