"""General kernels on a GPU give the films of specialised ones, bit for bit.

CUDA's compiler takes minutes for them, so they are not compiled here: they must be among the shipped kernels
(`scripts/package.py` makes them), or compiled before (`render.py --prewarm --device cuda:0`).
"""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.devices import is_compiled
from raybatch_addon.core.session import Session
from raybatch_addon.core.wavefront.tier import VARIABLE, general_kernels
from tests.support import schedule_scenes
from tests.support.feature_scenes import ALL_FEATURES, SETTINGS
from tests.support.under_test import DEVICE

# With and without programs of each kind, and what the large kernels have branches for
CHOSEN = (
    "everything",
    "subsurface",
    "lamp program behind what is transparent",
    "lamp program without a shadow",
    "all passes of a program",
    "transparent with a program that asks for history",
    "settings of Cycles, and a denoiser's passes",
    "moving, transparent with a program",
    "fibres",
    "volume",
    "a volume with a program",
)
SCENES = {name: (scene, {"sample_count": 4}) for name, scene in schedule_scenes.SCENES.items()}
SCENES |= {name: (lambda name=name: ALL_FEATURES[name][0], ALL_FEATURES[name][1]) for name in CHOSEN}


@pytest.fixture(autouse=True)
def shipped(monkeypatch):
    """Tiers are chosen as for a user; skips where there are no general kernels for the device."""
    monkeypatch.delenv(VARIABLE, raising=False)
    device = wp.get_device(DEVICE)
    if device.is_cpu:
        pytest.skip("on a GPU alone")
    general_kernels(wp.get_device("cpu"))  # as in Blender, where a process knows those of both devices
    if not all(is_compiled(kernel, device) for kernel in general_kernels(device)):
        pytest.skip(f"no general kernels for {device.name}")


@pytest.mark.parametrize("name", list(SCENES))
def test_tiers_give_the_same_film(name):
    make, changes = SCENES[name]
    scene, settings = make(), SETTINGS.replace(**changes)
    specialised, general = (
        Session(DEVICE).render(scene, settings.replace(kernel_tier=tier)) for tier in ("SPECIALISED", "GENERAL")
    )
    assert general.statistics["warnings"] == specialised.statistics["warnings"]  # general ones were there
    assert general.passes.keys() == specialised.passes.keys()
    for pass_name, values in specialised.passes.items():
        assert np.isfinite(values).all(), pass_name
        assert np.array_equal(general.passes[pass_name], values), pass_name
    assert specialised.passes["Combined"][..., :3].std() > 0
