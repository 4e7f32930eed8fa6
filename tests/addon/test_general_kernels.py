"""General kernels that the add-on compiles in the background, for the CPU and every kind of GPU."""

import shutil
from types import SimpleNamespace

import pytest
import warp as wp

from raybatch_addon.blender import general_kernels
from raybatch_addon.core.device.devices import one_of_each_kind, start_warp
from tests.core.device.small_kernels import put_header
from tests.support.running.general_kernels import put_general_kernels


def test_one_gpu_of_each_kind_is_compiled_for(monkeypatch):
    start_warp()
    gpus = [SimpleNamespace(alias=f"cuda:{i}", arch=arch) for i, arch in enumerate((86, 90, 86, 120, 90))]
    monkeypatch.setattr(wp, "get_cuda_devices", lambda: gpus)
    cpu, *others = one_of_each_kind()
    assert cpu.is_cpu and sorted(each.alias for each in others) == ["cuda:0", "cuda:1", "cuda:3"]
    monkeypatch.setattr(wp, "get_cuda_devices", list)
    assert one_of_each_kind() == [cpu]


def test_the_background_compiles_for_all_devices(tmp_path, monkeypatch):
    modules = put_general_kernels(tmp_path)
    if wp.get_cuda_devices():
        pytest.skip("general kernels take minutes to compile for a GPU")
    put_header(modules[0].parent)
    missing = next(module for module in modules if "add_spill_kernel" in module.name)  # one of the smallest
    shutil.rmtree(missing)
    monkeypatch.setenv("RAYBATCH_KERNEL_CACHE", str(tmp_path))
    general_kernels.stop()
    assert general_kernels.state() == "not looked for yet"
    general_kernels.start()
    try:
        assert general_kernels.is_compiling()
        general_kernels._process.wait()
        assert general_kernels.state() == "ready: a scene's first render waits for no compiler"
        done, total = general_kernels._process.progress
        assert done == total == len(modules)
    finally:
        general_kernels.stop()
    assert list(missing.glob("*.o"))


@pytest.mark.parametrize(("progress", "counted"), [(None, "background; "), ((37, 79), "background, 37 of 79 ready; ")])
def test_how_far_the_background_is_can_be_read(monkeypatch, progress, counted):
    monkeypatch.setattr(general_kernels, "_process", SimpleNamespace(is_running=True, progress=progress))
    assert general_kernels.state() == f"being compiled in the {counted}renders compile what they need until then"
