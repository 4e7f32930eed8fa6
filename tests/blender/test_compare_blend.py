"""scripts/compare.py on .blend files, with Cycles."""

import json
import shutil
import warnings

import numpy as np
import pytest

from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.command_line import ROOT, run_script
from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

from tests.support.blender_builders import add_grid, add_object, material_of, node_tree

SMALL = ("--width", "32", "--samples", "16", "--threads", "1")


@pytest.fixture
def blend(scene, tmp_path):
    """A white floor under two lamps and a world, with a square that emits, and a lamp that is hidden."""
    tree, surface = node_tree(material_of(add_grid("Floor", 4)))
    tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], surface)
    glowing = add_grid("Glowing", 1)
    glowing.location, glowing.scale = (0.6, 0.6, 0.2), (0.1, 0.1, 0.1)
    tree, surface = node_tree(material_of(glowing, "Glow"))
    tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], surface)
    for name, place in (("Left", -0.3), ("Right", 0.3)):
        lamp = bpy.data.lights.new(name, "SUN")
        lamp.energy = 2
        add_object(name, lamp).rotation_euler = (0, place, 0)
    hidden = bpy.data.collections.new("Hidden")
    scene.collection.children.link(hidden)
    hidden.hide_render = True
    hidden.objects.link(bpy.data.objects.new("Unseen", bpy.data.lights.new("Unseen", "POINT")))
    world = bpy.data.worlds.new("World")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # needed up to 4.5, always on from 5.0
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    scene.world = world
    camera = scene.camera
    camera.location, camera.rotation_euler = (0, 0, 3), (0, 0, 0)
    scene.cycles.sample_clamp_indirect = 0.01  # which the comparison takes away
    path = tmp_path / "floor.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_a_file_is_rendered_by_both_and_judged_by_its_sources(blend, tmp_path):
    out = tmp_path / "out"
    done = run_script("compare.py", blend, *SMALL, "--superposition-of-all", "--out", out)
    report = json.loads((out / "results.json").read_text())
    (row,) = report["files"]
    assert done.returncode == 0 and not row["errors"], (done.stderr, row)
    assert row["verdict"] == "same", row
    assert set(row["ratios"]) == {"first", "again", "small", "all-2", "variance", "equal error"}
    assert report["versions"]["Blender"] == bpy.app.version_string
    names = {"lamp “Left”", "lamp “Right”", "the world", "surfaces that emit"}
    assert set(row["superposition"]["sources"]) == names
    for each in row["superposition"]["engines"].values():
        assert each["ratio"] == pytest.approx(1, abs=max(0.01, 5 * each["ratio_error"]))
    with np.load(next((out / "files").glob("*.npz"))) as pictures:
        alone = [pictures[f"RAYBATCH/source-{number}-1"][..., :3].mean() for number in range(4)]
        assert pictures["RAYBATCH/all-1"].shape == (24, 32, 4) and min(alone) > 0


def test_the_add_on_of_an_extension_renders(blend, tmp_path):
    packed = tmp_path / "packed"
    shutil.copytree(ROOT / "raybatch_addon", packed, ignore=shutil.ignore_patterns("__pycache__"))
    (packed / "blender_manifest.toml").write_text('version = "9.8.7"\n')
    zipped = shutil.make_archive(str(tmp_path / "raybatch"), "zip", packed)
    done = call_script("compare.py", blend, *SMALL, "--extension", zipped, "--out", tmp_path / "out")
    report = json.loads((tmp_path / "out" / "results.json").read_text())
    assert done.returncode == 0 and report["files"][0]["verdict"] == "same", (done.stderr, report["files"])
    assert report["versions"]["RayBatch"] == "9.8.7"


def test_cycles_takes_no_shortcuts(scene):
    from lib.cycles_peer import make_unbiased

    lamp, scene.world = bpy.data.lights.new("Lamp", "SPOT"), bpy.data.worlds.new("World")
    lamp.cycles.is_caustics_light = scene.world.cycles.is_caustics_light = True
    scene.cycles.blur_glossy, scene.cycles.caustics_refractive = 1.0, False
    make_unbiased(scene, RenderSettings(bounce_max=3))
    assert not lamp.cycles.is_caustics_light and not scene.world.cycles.is_caustics_light
    assert scene.cycles.blur_glossy == 0 and scene.cycles.caustics_refractive and scene.cycles.max_bounces == 3


def test_a_scene_without_a_camera_is_given_one_that_sees_all(blend, tmp_path, scene):
    bpy.data.objects.remove(scene.camera)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    done = call_script("compare.py", blend, *SMALL, "--out", tmp_path / "out")
    (row,) = json.loads((tmp_path / "out" / "results.json").read_text())["files"]
    assert done.returncode == 0 and row["verdict"] == "same", (done.stderr, row)
    assert "no camera: it was given one that sees all of it" in row["notes"][0]
    with np.load(next((tmp_path / "out" / "files").glob("*.npz"))) as pictures:
        floor = pictures["RAYBATCH/all-1"][..., :3].mean(-1)
    edge = np.concatenate([floor[0], floor[-1], floor[:, 0], floor[:, -1]])
    assert floor.max() > 2 * edge.max(), "all of the floor, with the world around it"


def test_a_scene_without_a_camera_in_which_nothing_is_to_be_seen_is_a_row_that_says_so(scene, tmp_path):
    bpy.data.objects.remove(scene.camera)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    done = call_script("compare.py", tmp_path / "empty.blend", *SMALL, "--out", tmp_path / "out")
    assert done.returncode == 1 and "has no camera, and nothing that one could see" in done.stderr


@pytest.mark.parametrize("defaults", [False, True])
def test_the_kernels_that_are_asked_for_render(blend, defaults):
    from real_files.opened import RAYBATCH, OpenFile

    OpenFile(str(blend), RAYBATCH, 48, 1, defaults, "SPECIALISED")
    assert bpy.context.scene.raybatch.kernel_tier == "SPECIALISED"
    OpenFile(str(blend), RAYBATCH, 48, 1, defaults)
    assert bpy.context.scene.raybatch.kernel_tier == "AUTO"


def test_materials_of_a_library_are_put_on_balls(scene, tmp_path):
    from real_files.opened import RAYBATCH, OpenFile

    bpy.data.objects.remove(scene.camera)
    reds = [0.1 + 0.05 * number for number in range(13)]
    for number, red in enumerate(reds):
        made = bpy.data.materials.new(f"Paint {number:02}")
        made.use_fake_user = True
        tree, surface = node_tree(made)
        diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
        diffuse.inputs["Color"].default_value = (red, 0.3, 0.3, 1)
        tree.links.new(diffuse.outputs[0], surface)
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    opened = OpenFile(str(path), RAYBATCH, 48, 1, False)
    reported = opened.prepared()
    assert "13 materials are on balls" in reported["prepared"] and opened.size == (48, 36)
    picture = opened.render(4, 1)
    assert picture.shape == (72, 48, 4), "two sheets, one above the other"
    assert [each["material"] for each in reported["cells"]] == [f"Paint {number:02}" for number in range(13)]
    shown = []
    for x0, y0, x1, y1 in (each["box"] for each in reported["cells"]):
        middle = picture[(y0 + y1) // 2 - 1 : (y0 + y1) // 2 + 2, (x0 + x1) // 2 - 1 : (x0 + x1) // 2 + 2]
        shown.append(float((middle[..., 0] / middle[..., 1]).mean()))
    assert shown == sorted(shown) and shown[0] < 0.6 < 2.0 < shown[-1], shown


def test_a_damaged_file_is_a_row_that_says_so(blend, tmp_path):
    blend.write_bytes(blend.read_bytes()[:100])
    done = call_script("compare.py", blend, *SMALL, "--out", tmp_path / "out")
    assert done.returncode == 1 and "cannot open it" in done.stderr, done.stderr


def test_lamps_of_one_name_in_several_libraries_are_sources_of_their_own(scene, tmp_path):
    from real_files.sources import leave_alone, sources_of

    def add_lamp(energy):
        lamp = bpy.data.lights.new("Lamp", "SUN")
        lamp.energy = energy
        return add_object("Lamp", lamp)

    for name in ("one", "two"):
        lamp = add_lamp(1.0)
        bpy.data.libraries.write(str(tmp_path / f"{name}.blend"), {lamp})
        bpy.data.objects.remove(lamp)
    for name in ("one", "two"):
        with bpy.data.libraries.load(str(tmp_path / f"{name}.blend"), link=True) as (_, into):
            into.objects = ["Lamp"]
        scene.collection.objects.link(into.objects[0])
    add_lamp(2.0)
    names = [each.name for each in sources_of(scene)]
    assert names == ["lamp “Lamp”", "lamp “Lamp [one.blend]”", "lamp “Lamp [two.blend]”"]
    leave_alone(scene, names[1])
    (left,) = [each for each in bpy.data.objects if each.type == "LIGHT" and not each.hide_render]
    assert left.library.name == "one.blend" and [each.name for each in sources_of(scene)] == names[1:2]
