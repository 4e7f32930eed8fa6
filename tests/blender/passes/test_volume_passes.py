"""Passes of what lies in smoke and behind it, against Cycles' own of the same .blend."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.passes import DEPTH_OF_NOTHING
from tests.blender.features.build import ball, box, diffuse, floor, lamp, look
from tests.blender.features.compare import add_world, set_alike
from tests.blender.features.families.volumes import volume_of
from tests.blender.passes import test_passes


def smoke(scene, driven):
    """A cube of smoke, driven by noise where it is `driven`, beside a ball above a floor."""
    set_alike(scene, 32)
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)
    floor()
    diffuse(ball("Chalk", (-1.0, 0.6, 0.5), 0.5), (0.8, 0.3, 0.2))

    def graph(made):
        density = made.value("ShaderNodeTexNoise") if driven else 1.0
        return made.value("ShaderNodeVolumePrincipled", {"Density": density, "Color": (0.9, 0.5, 0.3)})

    volume_of(box("Smoke", (0.8, 0, 1.2), (2, 2, 2), 0.0, (0, 0, 0)), graph)
    look(scene, (0, -4.2, 2.0), (0, 0, 0.6), lens=30)
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_mist = layer.use_pass_normal = layer.use_pass_diffuse_color = True
    layer.cycles.denoising_store_passes = True


@pytest.mark.parametrize("driven", [False, True])
def test_passes_of_smoke_are_those_of_cycles(scene, tmp_path, general_kernels, driven):
    smoke(scene, driven)
    ours, theirs = (test_passes.rendered(scene, each, tmp_path / f"{each}.exr", 1) for each in ("RAYBATCH", "CYCLES"))
    nothing = [each["Depth"] == np.float32(DEPTH_OF_NOTHING) for each in (ours, theirs)]
    assert ours["Depth"].min() > 0 and nothing[0].mean() == pytest.approx(nothing[1].mean(), abs=0.05)
    for name in ("Mist", "Normal", "Diffuse Color", "Denoising Albedo", "Denoising Normal"):
        # Cycles lets as many paths scatter as its picture so far advises, and does not weigh their normals by it
        error = 0.03 if name == "Denoising Normal" else 0.012
        for side in (slice(0, 16), slice(16, 32)):  # without smoke, and with it
            means = [each[name][:, side].mean((0, 1), dtype=np.float64) for each in (ours, theirs)]
            print(name, *means)
            assert means[0] == pytest.approx(means[1], abs=error), name
