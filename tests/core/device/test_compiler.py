"""Compilers run apart: what they complain of is one line and a log, and they can be stopped."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import warp as wp

from raybatch_addon.core.device import compiler, kept_kernels
from raybatch_addon.core.device.compile_errors import complaint_of
from raybatch_addon.core.device.compiler import CompileError, CompileStoppedError
from raybatch_addon.core.device.devices import load_kernels, load_module, start_warp
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import DeviceError
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.device.small_kernels import ROOT, files_of, forget, keep_in, small_kernel, works
from tests.support import scenes

PACKAGE = ROOT / "raybatch_addon"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    """A folder for kernels without any."""
    keep_in(tmp_path, monkeypatch)
    return tmp_path


@pytest.fixture(scope="module")
def shared_folder() -> str:
    """Where all tests keep their kernels."""
    start_warp()
    return wp.config.kernel_cache_dir


@wp.func_native("return this is no code;")
def no_code(x: float) -> float: ...


@wp.kernel(**KERNEL_OPTIONS)
def no_code_kernel(values: wp.array(dtype=float)):
    values[wp.tid()] = no_code(1.0)


def test_progress_counts_the_kernels_that_are_there_first():
    device, kernels = wp.get_device("cpu"), [small_kernel() for _ in range(3)]
    for there in (0, 1, 3):
        for kernel in kernels[:there]:
            load_module(kernel, device)
        shown = []
        assert len(load_kernels(kernels, device, lambda done, total: shown.append((done, total)))) == 3
        assert shown == [(count, 3) for count in range(there, 4)]
        for kernel in kernels:
            forget(kernel)


def test_a_compile_error_is_one_line_and_a_log(folder, capfd):
    with pytest.raises(DeviceError) as raised:
        load_module(no_code_kernel, wp.get_device("cpu"))
    line, log = str(raised.value), folder / "failed" / f"{no_code_kernel.module.name}.log"
    assert line.startswith("the kernel no_code_kernel could not be compiled for cpu: ") and "\n" not in line
    assert line.endswith(f"the log is {log}") and "return this is no code;" in log.read_text()
    assert capfd.readouterr() == ("", "")
    assert not [path for path in folder.iterdir() if path.name.startswith("wp_")], "what was half done"
    # nothing is compiled again for the same words
    log.unlink()
    with pytest.raises(DeviceError) as again:
        load_module(no_code_kernel, wp.get_device("cpu"))
    assert str(again.value) == line and not log.exists()


@pytest.mark.parametrize(
    "path, said",
    [
        ("core/shading/bsdf/bsdf.py", "closures (bsdf), core/shading/bsdf/bsdf.py:"),
        ("core/shading/lights/lights.py", "lights (lights), core/shading/lights/lights.py:"),
    ],
)
def test_a_compile_error_names_the_feature(path, said, folder, shared_folder, monkeypatch):
    """The code of one function is spoiled as it is generated."""
    # what other tests compiled is found, and what is compiled here is not kept there
    monkeypatch.setattr(wp.config, "kernel_cache_dir", shared_folder)
    monkeypatch.setattr(kept_kernels, "_spare", folder)
    generate, spoiled = wp.Module._run_codegen, []

    def spoil(module, options, is_cpu):
        source, *rest = generate(module, options, is_cpu)
        before, found, after = source.partition(f"// {PACKAGE / path}:")
        if found:
            spoiled.append(module.name)
            after = after.replace("{", "{ this is no code;", 1)
        return before + found + after, *rest

    monkeypatch.setattr(wp.Module, "_run_codegen", spoil)
    monkeypatch.setattr("raybatch_addon.core.device.loading._failed", {})
    # kernels of this scene alone, so that none was loaded before
    settings = RenderSettings(sample_count=1, kernel_tier="SPECIALISED", nee="HALF", clamp_indirect=0.75, mis="OFF")
    scene = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], lights=[scenes.area_light()])
    for module in list(wp._src.context.user_modules.values()):
        if "surface" in module.name or "connect" in module.name:
            module.unload()
    with pytest.raises(DeviceError, match="could not be compiled for cpu: .*; the log is ") as raised:
        Session("cpu").render(scene, settings)
    assert str(raised.value).startswith(said) and spoiled


def test_errors_of_generated_code_name_the_function():
    error = RuntimeError(
        f'Error while parsing function "f" at {PACKAGE}/core/programs/ops/values/math.py:12:\n x\n bad.'
    )
    line = complaint_of(small_kernel().module, wp.get_device("cpu"), error, Path("none"), Path("/none/such"))
    assert line.startswith(
        "shader nodes (math), core/programs/ops/values/math.py:12, could not be compiled for cpu: bad"
    )


def test_a_log_has_a_place_where_the_folder_has_none(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    kernel = small_kernel()
    line = complaint_of(kernel.module, wp.get_device("cpu"), CompileError("why", "log"), Path("none"), blocked)
    log = Path(line.rpartition("the log is ")[2])
    assert log.read_text().endswith("log") and kernel.module.name in log.name
    log.unlink()


def test_a_compiler_is_stopped_when_nobody_waits(folder):
    kernel, begun = small_kernel(), time.monotonic()
    with pytest.raises(CompileStoppedError):
        load_module(kernel, wp.get_device("cpu"), lambda: bool(compiler._running))
    assert not compiler._running and not files_of(kernel).binary.exists()
    assert time.monotonic() - begun < 30
    assert works(kernel), "the next one that asks gets it"


@pytest.mark.usefixtures("cpu_compiler")
def test_a_session_that_is_closed_compiles_no_longer(shared_folder, monkeypatch):
    """A cancelled render leaves its compilers to the next one; a closed session has none."""
    begun, results = threading.Event(), []
    session = Session("cpu")

    def render():
        scene = scenes.mixed()
        settings = RenderSettings(sample_count=1, kernel_tier="SPECIALISED", seed=5)
        for module in list(wp._src.context.user_modules.values()):
            module.unload()
        results.append(
            session.render(scene, settings, cancelled=lambda: bool(compiler._running) and begun.set() is None)
        )

    thread = threading.Thread(target=render)
    thread.start()
    assert begun.wait(60)
    thread.join(10)
    assert not thread.is_alive() and not results[0].complete
    assert compiler._running, "for the next render"
    session.close()
    end = time.monotonic() + 10
    while compiler._running:
        assert time.monotonic() < end
        time.sleep(0.05)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", shared_folder)
    plain = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], world=1.0)
    assert session.render(plain, RenderSettings(sample_count=1)).complete, "it opens again"


ENDS = """
import sys, threading, time
sys.path.insert(0, sys.argv[2])
import warp as wp
from raybatch_addon.core.session import Session
from raybatch_addon.core.device import compiler
from raybatch_addon.core.device.devices import load_kernels
from tests.core.device.small_kernels import small_kernel
session = Session("cpu", cache_folder=sys.argv[1])
from concurrent.futures import ThreadPoolExecutor
kernels = [small_kernel() for _ in range(30)]
ThreadPoolExecutor(1).submit(load_kernels, kernels, wp.get_device("cpu"), lambda done, total: None)
while not compiler._running:
    time.sleep(0.01)
"""


@pytest.mark.usefixtures("cpu_compiler")
def test_a_process_ends_in_the_middle_of_compiling(tmp_path):
    """It waits for its threads, and they for compilers."""
    done = subprocess.run(
        [sys.executable, "-c", ENDS, str(tmp_path), str(ROOT)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0 and done.stderr == ""
    # those that were under way at most, of thirty
    assert len(list(tmp_path.rglob("*.o"))) < 10
