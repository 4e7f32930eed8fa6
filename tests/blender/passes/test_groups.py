"""Passes of light groups and of volumes against Cycles' own of the same .blend."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.features.build import ball, diffuse, floor, lamp, look, shaded
from tests.blender.features.compare import Picture, add_world, figures_of, set_alike
from tests.blender.passes.test_passes import rendered

GROUPS = ("key", "fill", "glow", "sky")


def lit_by_groups(scene):
    """Balls below lamps, a luminous ball and a sky, each in a group of its own; one lamp is in none."""
    set_alike(scene, 32)
    add_world(scene, 0.3, (0.6, 0.75, 1.0)).lightgroup = "sky"
    for name in GROUPS:
        scene.view_layers[0].lightgroups.add(name=name)
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=1.0, angle=0.8).lightgroup = "key"
    lamp("POINT", (-1.5, -1.0, 2.0), energy=50.0, shadow_soft_size=0.2, color=(1, 0.6, 0.4)).lightgroup = "fill"
    lamp("AREA", (1.5, -1.0, 2.0), target=(0, 0, 0), energy=30.0, size=0.5)
    bulb = shaded(ball("Bulb", (0.2, -0.9, 0.25), 0.2), "ShaderNodeEmission", Color=(1, 0.5, 0.2, 1), Strength=3.0)
    bulb.lightgroup = "glow"
    floor()
    diffuse(ball("Chalk", (-0.8, 0, 0.5), 0.5), (0.2, 0.3, 0.8))
    shaded(ball("Gloss", (0.6, 0, 0.5), 0.5), "ShaderNodeBsdfGlossy", Color=(0.9, 0.8, 0.6, 1), Roughness=0.2)
    look(scene, (0, -4.0, 1.8), (0, 0, 0.5))


def compared(scene, folder, names):
    """Figures by pass of two renders by each engine."""
    blend = str(folder / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    pages = {
        engine: [rendered(scene, engine, folder / f"{engine}{seed}.exr", seed) for seed in (1, 2)]
        for engine in ("RAYBATCH", "CYCLES")
    }
    for engine in pages:
        assert set(names) <= set(pages[engine][0]), engine

    def picture(engine, name):
        first, second = (page[name].astype(float)[..., :3] for page in pages[engine])
        return Picture(first, second)

    return pages, {name: figures_of(picture("RAYBATCH", name), picture("CYCLES", name)) for name in names}


@pytest.mark.thorough
@pytest.mark.parametrize("transparent", [False, True], ids=["opaque", "transparent"])
def test_light_groups_are_those_of_cycles(scene, tmp_path, transparent):
    lit_by_groups(scene)
    scene.render.film_transparent = transparent
    names = [f"Combined_{name}" for name in GROUPS]
    pages, figures = compared(scene, tmp_path, names)
    for name, each in figures.items():
        bound = max(0.01, 4 * each.noise)
        assert each.ratios == pytest.approx(1, abs=bound), (name, each.ratios, each.noise)
        assert each.rel_mse < 3e-3 + 4 * each.rel_mse_noise, (name, each.rel_mse)
    ours = pages["RAYBATCH"][0]
    assert all(ours[name].mean() > 0 for name in names)


def smoke(scene):
    """A box of haze with a ball in it, on a floor."""
    set_alike(scene, 32)
    add_world(scene, 0.2)
    floor()
    lamp("POINT", (-1.2, -1.0, 2.0), energy=80.0, shadow_soft_size=0.2)
    diffuse(ball("Chalk", (0.3, 0, 0.5), 0.4), (0.8, 0.3, 0.2))
    haze = ball("Haze", (0, 0, 0.9), 0.8)
    material = bpy.data.materials.new("Haze")
    haze.data.materials.append(material)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    volume = tree.nodes.new("ShaderNodeVolumeScatter")
    volume.inputs["Density"].default_value = 1.0
    volume.inputs["Color"].default_value = (0.8, 0.9, 0.6, 1)
    tree.links.new(volume.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    look(scene, (0, -4.0, 1.8), (0, 0, 0.6))


@pytest.mark.thorough
def test_volume_passes_are_those_of_cycles(scene, tmp_path):
    smoke(scene)
    layer = scene.view_layers[0]
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
    layer.use_pass_diffuse_direct = layer.use_pass_diffuse_indirect = True
    names = ["Volume Direct", "Volume Indirect", "Diffuse Direct", "Diffuse Indirect"]
    pages, figures = compared(scene, tmp_path, names)
    for name, each in figures.items():
        bound = max(0.01, 4 * each.noise)
        assert each.ratios == pytest.approx(1, abs=bound), (name, each.ratios, each.noise)
    assert pages["RAYBATCH"][0]["Volume Direct"].mean() > 0
