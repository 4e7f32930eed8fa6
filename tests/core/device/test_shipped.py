"""Shipped kernels: bits do not depend on the processor's level, and what does not fit is said and compiled."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from lib.shipped_kernels import can_be_made, compile_source, kernels_for, make_kernels, source_of

from raybatch_addon.core.device import ready, shipped
from raybatch_addon.core.device.devices import is_compiled, shipped_target, start_warp
from raybatch_addon.core.device.kept_kernels import remove
from raybatch_addon.core.device.kernel import GENERAL_MODULE, KERNEL_OPTIONS
from raybatch_addon.core.device.notes import take_notes
from raybatch_addon.core.device.shipped import INDEX, LEVELS, fitting_targets
from tests.core.device.small_kernels import ROOT, files_of, forget, keep_in, small_kernel, works
from tests.support.running.kernels_to_ship import LOWEST, make_lowest

pytestmark = pytest.mark.skipif(not can_be_made("linux-x64"), reason="kernels are shipped for Linux on x86-64")
BEST = "x86-64-v2"  # every processor has it


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder for shipped kernels that is not there yet, and an empty one for those that are compiled."""
    keep_in(tmp_path / "kept", monkeypatch)
    monkeypatch.setattr(ready, "SHIPPED", tmp_path / "shipped")
    shipped._index.cache_clear()
    shipped._is_sound.cache_clear()
    take_notes()
    yield tmp_path / "shipped"
    shipped._index.cache_clear()


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder for what is compiled to be shipped."""
    return tmp_path_factory.mktemp("made")


def kernel_to_ship() -> wp.Kernel:
    """The same kernel for all tests here, not loaded: it is compiled once for each level."""
    kernel = small_kernel(2001)
    forget(kernel)
    return kernel


@pytest.fixture
def kernel(folder, made) -> wp.Kernel:
    """A kernel that was shipped for the lowest level."""
    kernel = kernel_to_ship()
    make_kernels(folder, made, [kernel], [BEST])
    return kernel


def compiled_here(kernel: wp.Kernel) -> bool:
    return files_of(kernel).binary.exists()


def test_a_shipped_kernel_is_loaded_from_where_it_is(kernel):
    device = wp.get_device("cpu")
    assert shipped_target(kernel, device) == BEST and is_compiled(kernel, device)
    assert works(kernel) and not compiled_here(kernel) and take_notes() == []


def test_what_was_compiled_here_comes_first(folder, made):
    kernel = kernel_to_ship()
    assert works(kernel)
    make_kernels(folder, made, [kernel], [BEST])
    forget(kernel)
    assert shipped_target(kernel, wp.get_device("cpu")) == "" and works(kernel)


def change(folder: Path, **changes) -> None:
    index = json.loads((folder / INDEX).read_text())
    (folder / INDEX).write_text(json.dumps(index | changes))


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)


SPOILT = {
    "object": (lambda folder: flip(next(folder.glob("*/*.o"))), "the shipped kernel .* is damaged .install"),
    "cut object": (lambda folder: next(folder.glob("*/*.o")).write_bytes(b""), "is damaged"),
    "no object": (lambda folder: next(folder.glob("*/*.o")).unlink(), "is damaged"),
    "meta": (lambda folder: flip(next(folder.glob("*/*.meta"))), "is damaged"),
    "index": (lambda folder: (folder / INDEX).write_text('{"format": 2, "wa'), "list of shipped kernels .* is damaged"),
    "index of garbage": (lambda folder: (folder / INDEX).write_bytes(bytes(range(256))), "list .* is damaged"),
    "index without hashes": (
        lambda folder: change(folder, modules={"wp_a_1234567": {}}),
        "list of shipped kernels .* is damaged",
    ),
    "Warp": (lambda folder: change(folder, warp="1.18.0"), "are for Warp 1.18.0, and this is"),
    "compiler": (
        lambda folder: change(folder, targets={BEST: {"llvm": "21.0", "triple": "x86_64-unknown-linux-gnu"}}),
        f"for {BEST} are for another compiler or system",
    ),
}


@pytest.mark.parametrize("which", SPOILT)
def test_what_does_not_fit_is_said_and_compiled(kernel, folder, which):
    spoil, said = SPOILT[which]
    spoil(folder)
    assert not is_compiled(kernel, wp.get_device("cpu"))
    assert works(kernel) and compiled_here(kernel)
    (note,) = take_notes()
    assert "kernels are compiled here instead" in note
    assert re.search(said, note), note


def test_a_lower_level_takes_the_place_of_what_is_damaged(folder, made):
    kernel, levels = kernel_to_ship(), fitting()[-2:]
    if len(levels) < 2:
        pytest.skip("this processor has one level alone")
    make_kernels(folder, made, [kernel], levels)
    flip(next((folder / levels[0]).glob("*.o")))
    assert works(kernel) and not compiled_here(kernel)
    (note,) = take_notes()
    assert "is damaged" in note and note.endswith(f"that for {BEST} takes its place")


def test_a_processor_with_too_few_instructions_compiles(kernel, monkeypatch):
    monkeypatch.setattr(wp._src.context, "_get_cpu_feature_set", lambda: frozenset({"sse2", "sse3"}))
    assert works(kernel) and compiled_here(kernel)
    (note,) = take_notes()
    assert "need a processor of at least x86-64-v2; kernels are compiled here instead" in note


def test_a_gpu_that_nothing_was_shipped_for_is_said(kernel, folder):
    index = json.loads((folder / INDEX).read_text())
    change(folder, targets={**index["targets"], "sm_90": {}})
    card = SimpleNamespace(is_cuda=True, is_cpu=False, arch=50, name="an old card")
    assert shipped.shipped_files(kernel.module, card, 1) is None
    assert take_notes() == ["there are no shipped kernels for an old card; kernels are compiled here instead"]


def test_general_kernels_of_other_code_are_said(folder, made, monkeypatch):
    monkeypatch.setattr(wp.config, "optimization_level", None)  # as for users
    make_kernels(folder, made, [kernel_to_ship()], [BEST])
    module = wp.get_module(f"{GENERAL_MODULE}_stages")
    assert shipped.shipped_files(module, wp.get_device("cpu"), 1) is None
    assert "belong to other code than this RayBatch" in take_notes()[0]


def test_general_kernels_for_a_cpu_and_for_cuda_share_no_module():
    """A module's hash is that of all its kernels: a process that wants both would find neither among the shipped."""
    cpu, cuda = (
        {kernel for kernel in kernels_for(target) if kernel.module.name.startswith(GENERAL_MODULE)}
        for target in ("x86-64-v2", "sm_90")
    )
    assert cpu != cuda
    assert {kernel.module.name for kernel in cpu - cuda}.isdisjoint(kernel.module.name for kernel in cuda)
    assert {kernel.module.name for kernel in cuda - cpu}.isdisjoint(kernel.module.name for kernel in cpu)


def test_levels_are_chosen_by_what_the_processor_has(monkeypatch):
    device, has = wp.get_device("cpu"), set()
    for level in reversed(LEVELS):
        assert level not in fitting_targets(device) or not has
        has |= set(LEVELS[level])
        monkeypatch.setattr(wp._src.context, "_get_cpu_feature_set", lambda: frozenset(has))
        assert fitting_targets(device)[0] == level
    has.remove("sse4.2")
    assert fitting_targets(device) == []


ON_GPUS = {
    70: [],
    75: ["sm_75"],
    80: ["sm_80"],
    86: ["sm_80"],
    89: ["sm_80"],
    90: ["sm_90"],
    103: ["sm_100"],
    110: [],
    121: ["sm_120"],
}


@pytest.mark.parametrize("arch", ON_GPUS)
def test_a_gpu_takes_code_of_its_major_number(arch):
    assert fitting_targets(SimpleNamespace(is_cuda=True, arch=arch)) == ON_GPUS[arch]


def test_a_gpu_takes_the_nearest_code_first(monkeypatch):
    several = {name: int(name.removeprefix("sm_")) for name in ("sm_80", "sm_89", "sm_86", "sm_90")}
    monkeypatch.setattr(shipped, "ARCHITECTURES", several)
    assert fitting_targets(SimpleNamespace(is_cuda=True, arch=89)) == ["sm_89", "sm_86", "sm_80"]
    assert fitting_targets(SimpleNamespace(is_cuda=True, arch=87)) == ["sm_86", "sm_80"]


@pytest.fixture
def driver(folder, monkeypatch) -> SimpleNamespace:
    """A driver that does not load shipped kernels as many times as it is asked to."""
    driver, load = SimpleNamespace(failures=99, asked=[]), wp.Module.load

    def load_others(module, device, block_dim=None, binary_path=None, **options):
        if binary_path is not None and folder in binary_path.parents:
            driver.asked.append(binary_path)
            if len(driver.asked) <= driver.failures:
                raise RuntimeError("no kernel image for this device")
        return load(module, device, block_dim, binary_path, **options)

    monkeypatch.setattr(wp.Module, "load", load_others)
    monkeypatch.setattr(shipped, "_refused", {})
    return driver


def test_what_the_driver_does_not_load_is_said_once_and_compiled(kernel, driver):
    assert works(kernel) and compiled_here(kernel)
    (note,) = take_notes()
    assert note.endswith("cannot be loaded: no kernel image for this device; kernels are compiled here instead"), note
    (refused,) = set(driver.asked)
    assert str(refused) in note
    driver.asked.clear()
    forget(kernel)
    remove(files_of(kernel))
    assert works(kernel) and compiled_here(kernel)
    assert driver.asked == [] and take_notes() == []


def test_what_the_driver_loads_at_the_second_try_is_not_refused(kernel, driver):
    driver.failures = 1
    assert works(kernel) and not compiled_here(kernel)
    assert len(driver.asked) == 2 and take_notes() == []


def fitting() -> list[str]:
    start_warp()
    return fitting_targets(wp.get_device("cpu"))


@wp.kernel(**KERNEL_OPTIONS)
def many_functions(values: wp.array(dtype=float), found: wp.array2d(dtype=float)):
    i = wp.tid()
    x = values[i]
    y = values[(i * 7 + 3) % values.shape[0]]
    v = wp.vec3(x, y, x * y)
    m = wp.matrix_from_rows(v, wp.vec3(y, x, 1.0), wp.vec3(1.0, x + y, y))
    found[i, 0] = wp.sin(x) * wp.cos(y) + wp.tan(x)
    found[i, 1] = wp.exp(-wp.abs(x)) + wp.log(wp.abs(y) + 1.0)
    found[i, 2] = wp.pow(wp.abs(x), y * 0.1)
    found[i, 3] = wp.sqrt(wp.abs(x)) / (1.0 + y * y)
    found[i, 4] = wp.atan2(x, y) + wp.asin(wp.clamp(x, -1.0, 1.0)) + wp.acos(wp.clamp(y, -1.0, 1.0))
    found[i, 5] = wp.floor(x) + wp.ceil(y) + wp.round(x * 3.0) + wp.mod(x, 0.7)
    found[i, 6] = wp.dot(m * v, wp.normalize(v)) + wp.length(wp.cross(v, m * v))
    found[i, 7] = x * y + x * y + x - y * x + wp.sinh(x * 0.1) + wp.erf(y)
    total = float(0.0)
    for k in range(32):  # loops that a compiler may turn into vectors
        total += values[(i + k) % values.shape[0]] * values[(i + 2 * k) % values.shape[0]]
    found[i, 8] = total + wp.determinant(m)


def test_levels_and_optimisation_give_the_same_bits(tmp_path, monkeypatch):
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "kept"))
    device, module = wp.get_device("cpu"), many_functions.module
    source, meta = source_of(module)
    values = np.random.default_rng(7).normal(scale=3.0, size=20011).astype(np.float32)
    results = {}
    native = [("native", optimisation) for optimisation in (2, 1, 0)]
    for level, optimisation in [*native, *((level, 2) for level in fitting()), ("x86-64-v2", 3)]:
        name = f"{level}-{optimisation}"
        compile_source(source, level, tmp_path / f"{name}.o", optimization_level=optimisation)
        (tmp_path / "module.meta").write_bytes(meta)
        module.unload()
        module.load(device, 1, binary_path=tmp_path / f"{name}.o", meta_path=tmp_path / "module.meta")
        found = wp.zeros((len(values), 9), dtype=float, device=device)
        wp.launch(many_functions, len(values), [wp.array(values, dtype=float, device=device), found], device=device)
        results[name] = found.numpy()
    module.unload()
    expected = results["native-2"]
    assert np.isfinite(expected).all() and len(results) >= 5
    assert all(np.array_equal(result, expected) for result in results.values())


# Renders scenes by general kernels of the level sys.argv[3] out of the folder sys.argv[2] to the file sys.argv[1]
RENDER = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[4:]
import numpy as np
from raybatch_addon.core.device import ready, shipped
ready.SHIPPED = Path(sys.argv[2])
from raybatch_addon.core.session import Session
from tests.core.ahead.test_tiers import SCENES, SETTINGS
session, level = Session("cpu"), sys.argv[3]
shipped.fitting_targets = lambda device: [level]
films = {}
for name, make in SCENES.items():
    film = session.render(make(), SETTINGS.replace(kernel_tier="AUTO", batching="OFF"))
    assert level in film.statistics["auto"]["kernel_tier"]["why"], film.statistics["auto"]
    assert not film.statistics["warnings"], film.statistics["warnings"]
    films |= {f"{name} {each}": values for each, values in film.passes.items()}
np.savez(sys.argv[1], **films)
"""


@pytest.fixture(scope="module")
def general_folder(tmp_path_factory) -> Path:
    """All that is shipped for the lowest level."""
    folder = tmp_path_factory.mktemp("shipped") / "kernels"
    make_lowest(folder)
    return folder


@pytest.mark.thorough  # compiles the general tier for another processor
def test_shipped_general_kernels_give_the_films_of_specialised_ones(general_folder, tmp_path):
    from raybatch_addon.core.session import Session
    from tests.core.ahead.test_tiers import SCENES, SETTINGS

    kept = {"RAYBATCH_KERNEL_CACHE": str(tmp_path / "kept"), "WARP_CACHE_PATH": str(tmp_path / "kept")}
    environment = os.environ | kept | {"RAYBATCH_KERNEL_TIER": "AUTO"}
    command = [sys.executable, "-c", RENDER, tmp_path / "films.npz", general_folder, LOWEST, ROOT, ROOT / "scripts"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    films = np.load(tmp_path / "films.npz")
    for name, make in SCENES.items():
        expected = Session("cpu").render(make(), SETTINGS.replace(kernel_tier="SPECIALISED", batching="OFF"))
        for each, values in expected.passes.items():
            assert np.array_equal(films[f"{name} {each}"], values, equal_nan=True), (name, each)
    # a scene's own small kernels are compiled, as far as they are not shipped; never one that shades
    assert not list((tmp_path / "kept").glob("*/wp_raybatch_general*"))
