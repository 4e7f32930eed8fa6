"""Kernels that many tests share: where it does not matter which tier renders, nothing is compiled for a single scene.

Both tiers give the same film bit for bit, which `tests/core/ahead` holds.
"""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import warp as wp

from raybatch_addon.core import device, session
from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.device.devices import load_kernels, start_warp
from raybatch_addon.core.scene.features import SceneFeatures
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.wavefront.tier import VARIABLE, TierChoice, choose_tier, general_features, why_not_general
from tests.support.running.unweighed_kernels import can_be_unweighed, unweighed_features


@contextlib.contextmanager
def by_general_kernels() -> Iterator[None]:
    """Inside, scenes are rendered by general kernels on the CPU, unless a test sets `kernel_tier`; processes too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, "GENERAL")
        patch.setattr(session, "choose_tier", choose_general)
        yield


def choose_general(features: SceneFeatures, setting: str, device: wp.Device) -> TierChoice:
    """The tier that `choose_tier` gives, but general kernels where there are any, and no warning where there are none.

    Those of independent samples, which no user has, and those that weigh no light are compiled once for all tests.
    """
    if setting != "AUTO":
        return choose_tier(features, setting, device)
    if device.is_cuda:  # whose general kernels take minutes to compile
        return choose_tier(features, "SPECIALISED", device)
    for shared, can_be in (
        (independent_features(), can_be_independent),
        (unweighed_features(features.sample_sequence), can_be_unweighed),
    ):
        if can_be(features):
            return TierChoice(shared, True, setting, "kernels are shared with other tests")
    return choose_tier(features, "SPECIALISED" if why_not_general(features, device) else "GENERAL", device)


def independent_features() -> SceneFeatures:
    """Features of all scenes without shader programs, whose code takes most of the time, with independent samples."""
    return dataclasses.replace(
        general_features(wp.get_device("cpu")),
        programs=ProgramFeatures(),
        world_program=ProgramFeatures(),
        lamp_program=ProgramFeatures(),
        volume_program=ProgramFeatures(),
        mesh_programs=False,
        world_light=False,
        closure_count=8,
        sample_sequence="INDEPENDENT",
    )


def can_be_independent(features: SceneFeatures) -> bool:
    """Whether kernels of `independent_features` can render a scene with `features`."""
    wide = independent_features()
    return (
        features.sample_sequence == "INDEPENDENT"
        and not (features.programs or features.world_program or features.lamp_program or features.volume_program)
        and features.closure_count <= wide.closure_count
        and not why_not_general(dataclasses.replace(features, sample_sequence="SOBOL"), wp.get_device("cpu"))
    )


def put_general_kernels(folder: Path) -> list[Path]:
    """Put the kernels that any scene can begin with into `folder`, as an environment makes them, and no others; returns
    where each module is.
    """
    start_warp()
    device, kept = wp.get_device("cpu"), Path(wp.config.kernel_cache_dir)
    kernels = GeneralRequest().kernels(device)
    load_kernels(kernels, device, lambda done, total: None)
    names = sorted({kernel.module.get_module_identifier(1) for kernel in kernels})
    return [Path(shutil.copytree(kept / name, folder / kept.name / name)) for name in names]


def general_source(kernel: wp.Kernel) -> str:
    """The C++ of a general kernel for a CPU: as the environment compiled it, where the code that writes it has not been
    changed since; else it is written now, which takes three to six seconds of each.
    """
    module, name = kernel.module, kernel.module.get_module_identifier(1)
    kept = Path(wp.config.kernel_cache_dir) / name / f"{name}.cpp"
    changed = max(each.stat().st_mtime for each in Path(device.__file__).parent.rglob("*.py"))
    if kept.is_file() and kept.stat().st_mtime > changed:
        return kept.read_text(encoding="utf-8")
    module.get_module_hash(1)  # declares it
    return module._run_codegen(module.resolved_options[1] | {"output_arch": None}, True)[0]
