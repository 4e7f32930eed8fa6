"""Missing parts are reported before the render: weighed, with objects, nodes and remedies, and refused where asked."""

import dataclasses
import json
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import exit_code, frame, missing, reports
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Closure, ClosureKind, Material, Volume, World
from raybatch_addon.core.scene.notice import Notice, Weight, by_weight, described
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.export.asked import asked
from raybatch_addon.export.passed_over.look import with_light_looked_for
from raybatch_addon.export.scene import export_scene
from tests.support import scenes
from tests.support.blender_builders import add_grid

ROOT = Path(__file__).resolve().parents[3]


def found(scene):
    """Notices of an export of `scene`."""
    return by_weight(export_scene(bpy.context.evaluated_depsgraph_get()).warnings)


def the_one(scene, words):
    (notice,) = (each for each in found(scene) if words in each)
    return notice


def lamp(scene):
    obj = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    scene.collection.objects.link(obj)
    return obj


def lost_volume(scene):
    """A volume whose file is not there, which every Blender reports: the collection that holds it."""
    volume = bpy.data.volumes.new("Smoke")
    volume.filepath = "//nowhere.vdb"
    collection = bpy.data.collections.new("Smoke")
    collection.objects.link(bpy.data.objects.new("Smoke", volume))
    scene.collection.children.link(collection)
    return collection


def unknown_node(name):
    """A material whose shader hangs on a node that RayBatch does not know."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True  # before Blender 5 a choice
    nodes = material.node_tree.nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    mixed = nodes.new("ShaderNodeMixShader")
    output = next(node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    unknown = nodes.new("ShaderNodeUVAlongStroke")
    unknown.name = "Strand"
    material.node_tree.links.new(unknown.outputs[0], mixed.inputs[0])
    material.node_tree.links.new(diffuse.outputs[0], mixed.inputs[1])
    material.node_tree.links.new(mixed.outputs[0], output.inputs["Surface"])
    return material


def test_notices_are_texts_that_keep_what_they_are_about(tmp_path, scene):
    about = dict(objects=["A"], material="M", nodes=["N"], remedy="mend it", option="settings-from cycles")
    notice = Notice("a thing", Weight.MISSING, **about)
    assert notice == "a thing" and f"{notice}" == "a thing"
    assert described(notice) == {
        "what": "a thing",
        "weight": "MISSING",
        "objects": ["A"],
        "material": "M",
        "nodes": ["N"],
        "remedy": "mend it",
        "option": "settings-from cycles",
    }
    assert described(pickle.loads(pickle.dumps(notice))) == described(notice)
    assert notice.to_do() == "mend it, or --settings-from cycles" and Notice("plain").to_do() == ""
    assert [each.weight for each in by_weight(["plain", notice])] == [Weight.MISSING, Weight.REPLACED]
    scene.cycles.use_guiding = True
    exported = export_scene(bpy.context.evaluated_depsgraph_get())
    save_scene(tmp_path / "a.scene.npz", exported, RenderSettings())
    kept = load_scene(tmp_path / "a.scene.npz")[0].warnings
    assert [described(each) for each in kept] == [described(each) for each in exported.warnings] and kept


def test_what_is_missing_is_said_before_the_render(scene, monkeypatch):
    lamp(scene)
    lost_volume(scene)
    order = []
    monkeypatch.setattr(frame, "scene_listeners", [lambda *_: order.append(list(missing.found_in(scene)))])
    monkeypatch.setattr(frame, "film_listeners", [lambda _layer, _scene, film: order.append(film.statistics)])
    bpy.ops.render.render()
    before, statistics = order
    assert before[0].weight == Weight.MISSING and "nowhere.vdb not found" in before[0]
    assert statistics["missing"][0] == described(before[0]) and str(before[0]) in statistics["warnings"]


@pytest.mark.parametrize(
    "what", ["render time", "guiding", "culling", "denoising data", "biased volumes", "fast gi", "simplify", "samples"]
)
def test_what_was_passed_over_is_named(scene, what):
    obj = add_grid("Host", 1)
    layer = scene.view_layers[0]
    if what == "render time":
        if not hasattr(layer.cycles, "pass_render_time"):
            pytest.skip("this Cycles has no such pass")
        layer.cycles.pass_render_time = True
        notice = the_one(scene, "Render Time")
        assert notice.weight == Weight.MISSING and notice.remedy
    elif what == "guiding":
        scene.cycles.use_guiding = True
        assert the_one(scene, "Guiding on").weight == Weight.SETTING
    elif what == "culling":
        obj.cycles.use_camera_cull = True
        assert the_one(scene, "culling").objects == ("Host",)
    elif what == "denoising data":
        if not hasattr(layer.cycles, "denoising_pass_use_albedo_roughness_weighting"):
            pytest.skip("this Cycles writes no such passes")
        layer.cycles.denoising_store_passes = True
        assert the_one(scene, "Denoising Specular Albedo and Denoising Roughness").weight == Weight.SETTING
    elif what == "biased volumes":
        if not hasattr(scene.cycles, "volume_biased"):
            pytest.skip("volumes of this Cycles are always in steps")
        scene.cycles.volume_step_rate = 2.0
        assert found(scene) == []  # not heard by Cycles either
        scene.cycles.volume_biased = True
        notice = the_one(scene, "Biased on, Step Rate 2")
        assert notice.weight == Weight.SETTING and notice.remedy
    elif what == "fast gi":
        scene.cycles.ao_bounces_render = 3
        assert found(scene) == []  # as above
        scene.cycles.use_fast_gi = True
        assert the_one(scene, "fast global illumination").weight == Weight.REPLACED
    elif what == "simplify":
        scene.cycles.texture_limit_render = "512"
        assert found(scene) == []  # as above
        scene.render.use_simplify = True
        scene.render.simplify_subdivision_render, scene.render.simplify_child_particles_render = 1, 0.5  # by Blender
        notice = the_one(scene, "Simplify")
        assert "512" in notice and "ubdivision" not in notice and "hild" not in notice
    else:
        scene.cycles.samples = 77
        assert "Samples: 77 in Cycles" in the_one(scene, "settings of Cycles")


def test_a_new_scene_lacks_nothing_but_light(scene):
    assert found(scene) == []
    bpy.ops.render.render()
    (notice,) = missing.found_in(scene)
    assert "nothing gives light" in notice and notice.weight == Weight.MISSING
    lamp(scene)
    bpy.ops.render.render()
    assert missing.found_in(scene) == []


def emitting(color):
    """A program of a volume that emits `color`, black or not."""
    builder = ProgramBuilder()
    builder.closure("emission", color)
    return builder.finish()


@pytest.mark.parametrize(
    "volume, is_dark",
    [
        (Volume((Closure(ClosureKind.VOLUME_ABSORPTION, (1.0,) * 3),)), True),
        (Volume((Closure(ClosureKind.EMISSION, (1.0,) * 3),)), False),
        (Volume(program=emitting((0.0, 0.0, 0.0))), True),
        (Volume(program=emitting((0.0, 1.0, 0.0))), False),
    ],
    ids=["absorbs", "emits", "emits black", "emits by a program"],
)
def test_volumes_that_emit_give_light(volume, is_dark):
    for material, world in ((Volume(), volume), (volume, None)):
        made = scenes.scene([(scenes.box(), scenes.IDENTITY, Material("gas", volume=material))])
        made = dataclasses.replace(made, world=World(volume=world))
        assert any("nothing gives light" in each for each in with_light_looked_for(made).warnings) == is_dark


def test_a_material_is_named_with_its_nodes_and_objects(scene):
    obj = add_grid("Host", 1)
    obj.data.materials.append(unknown_node("Odd"))
    (notice,) = (each for each in found(scene) if each.material == "Odd")
    assert notice.objects == ("Host",) and notice.nodes == ("Strand",) and "Strand" in notice


def test_the_panel_checks_and_selects(scene):
    lamp(scene)
    first, second = add_grid("First", 1), add_grid("Second", 1)
    second.cycles.use_camera_cull = True
    assert bpy.ops.raybatch.check_scene() == {"FINISHED"}
    assert len(missing.found_in(scene)) == 1
    first.select_set(True)
    assert bpy.ops.raybatch.select_object(number=0) == {"FINISHED"}
    assert bpy.context.view_layer.objects.active == second
    assert second.select_get() and not first.select_get()
    assert bpy.ops.raybatch.select_object(number=5) == {"CANCELLED"}


@pytest.mark.parametrize("way", ["object", "eye", "collection", "eye of a collection", "instanced"])
def test_what_the_viewport_hides_is_checked_and_stays_hidden(scene, way):
    lamp(scene)
    obj = add_grid("Host", 1)
    obj.cycles.use_camera_cull = True
    collection = bpy.data.collections.new("Kept")
    collection.objects.link(obj)
    scene.collection.objects.unlink(obj)
    if way == "instanced":
        placed = bpy.data.objects.new("Placed", None)
        placed.instance_type, placed.instance_collection = "COLLECTION", collection
        scene.collection.objects.link(placed)
    else:
        scene.collection.children.link(collection)
    layer = bpy.context.view_layer
    inside = layer.layer_collection.children.get("Kept")
    if way == "eye":
        obj.hide_set(True)
    else:
        hidden = {"collection": collection, "eye of a collection": inside}.get(way, obj)
        hidden.hide_viewport = True
    before = layer.objects.active
    assert bpy.ops.raybatch.check_scene() == {"FINISHED"}
    (notice,) = missing.found_in(scene)
    assert "culling" in notice and notice.objects == ("Host",)
    assert obj.hide_get() if way == "eye" else hidden.hide_viewport
    assert layer.objects.active == before
    obj.hide_render = True
    assert bpy.ops.raybatch.check_scene() == {"FINISHED"} and missing.found_in(scene) == []


def test_a_look_says_nothing_of_motion_that_a_render_will_have(scene):
    lamp(scene)
    scene.render.use_motion_blur = True
    assert bpy.ops.raybatch.check_scene() == {"FINISHED"} and missing.found_in(scene) == []


def test_every_view_layer_has_its_notices_and_another_file_has_none(scene, tmp_path):
    lamp(scene)
    second = scene.view_layers.new("Second")
    lost = lost_volume(scene)
    second.layer_collection.children[lost.name].exclude = True
    bpy.ops.render.render()
    assert second.use and any("nowhere.vdb" in each for each in missing.found_in(scene))
    scene.collection.children.unlink(lost)
    bpy.ops.render.render()
    assert missing.found_in(scene) == []
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other.blend"))
    assert missing.found_in(bpy.context.scene) is None


def test_what_is_rendered_is_looked_at(scene):
    for name, hidden in (("Hidden", True), ("Placed", False)):
        collection = bpy.data.collections.new(name)
        obj = add_grid(name, 1)
        scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
        obj.cycles.use_camera_cull = True
        if hidden:
            scene.collection.children.link(collection)
            collection.hide_render = True
            continue
        empty = bpy.data.objects.new("Instancer", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        scene.collection.objects.link(empty)
    taken = []
    frame.scene_listeners.append(lambda _layer, exported, _settings: taken.append(exported))
    try:
        bpy.ops.render.render()
    finally:
        frame.scene_listeners.pop()
    (exported,) = taken
    reported = [each.objects for each in exported.warnings if isinstance(each, Notice) and each.objects]
    assert reported and all(tuple(each) == ("Placed",) for each in reported)
    assert any("culling" in each for each in exported.warnings)


def test_a_mesh_needs_no_grid_of_a_principled_volume(scene):
    obj = add_grid("Host", 1)
    scene.collection.objects.link(bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke")))
    material = bpy.data.materials.new("Fog")
    material.use_nodes = True  # before Blender 5 a choice
    obj.data.materials.append(material)
    tree = material.node_tree
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], output.inputs["Volume"])
    assert not [each for each in found(scene) if "Host" in each]


def test_a_volume_without_values_is_missing_and_selected_by_its_name(scene):
    scene.collection.objects.link(bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke")))
    notice = the_one(scene, "“Smoke”")
    assert notice.weight == Weight.MISSING and notice.objects == ("Smoke",)


@pytest.mark.parametrize(
    ("strict", "refused"), [("OFF", False), ("MISSING", False), ("REPLACED", False), ("SETTING", True)]
)
def test_a_render_is_refused_by_weight(scene, strict, refused):
    lamp(scene)
    scene.cycles.use_guiding = True
    scene.raybatch_export.strict = strict
    if refused:
        with pytest.raises(RuntimeError, match="nothing may be missing"):
            bpy.ops.render.render()
    else:
        bpy.ops.render.render()
    assert reports.last().refused == refused and bool(reports.last().statistics) != refused


def test_options_behind_two_dashes_are_read():
    assert asked(["blender", "-b", "x.blend"]).strict is None
    assert asked(["blender", "--", "--raybatch-strict"]).strict == Weight.REPLACED
    read = asked(["blender", "--", "--raybatch-strict", "setting", "--raybatch-settings-from", "eevee"])
    assert (read.strict, read.settings_from) == (Weight.SETTING, "EEVEE")


def test_a_process_ends_with_a_code_of_its_own_where_a_render_is_refused(scene, tmp_path):
    lamp(scene)
    lost_volume(scene)
    file = tmp_path / "lacking.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); import bpy, raybatch_addon; raybatch_addon.register()\n"
        f"bpy.ops.wm.open_mainfile(filepath={str(file)!r}); bpy.context.scene.render.engine = 'RAYBATCH'\n"
        "try:\n    bpy.ops.render.render()\nexcept RuntimeError: pass"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--", "--raybatch-strict"], capture_output=True, text=True, check=False
    )
    assert done.returncode == exit_code.REFUSED, done.stderr
    assert "nowhere.vdb" in done.stderr
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts/render.py"), str(file), "--strict", "--json", "-"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == exit_code.REFUSED and "not rendered" in done.stderr and not done.stdout


def test_another_engines_settings_are_taken_over_on_the_command_line(scene, tmp_path):
    lamp(scene)
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.max_bounces = 3, False, 5
    file = tmp_path / "own.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    done = subprocess.run(
        [
            *(sys.executable, str(ROOT / "scripts/render.py"), str(file), "--settings-from", "cycles"),
            *("--set", "bounce_max=1", "--json", "-"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    settings = json.loads(done.stdout)["settings"]
    assert settings["sample_count"] == 3 and settings["bounce_max"] == 1
    assert "Samples: 3, as in Cycles (before: 2)" in done.stderr


def test_a_script_in_osl_is_named_and_the_sockets_own_value_stands_in(scene):
    obj = add_grid("Host", 1)
    material = bpy.data.materials.new("Scripted")
    material.use_nodes = True  # before Blender 5 a choice
    obj.data.materials.append(material)
    tree = material.node_tree
    script = tree.nodes.new("ShaderNodeScript")
    script.name = "Mine"
    script.outputs.new("NodeSocketColor", "Out")
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (0.25, 0.5, 0.75, 1.0)
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    tree.links.new(script.outputs[0], diffuse.inputs["Color"])
    notice = the_one(scene, "Open Shading Language")
    assert notice.material == "Scripted" and "“Mine”" in notice
    exported = export_scene(bpy.context.evaluated_depsgraph_get())
    (made,) = (each for each in exported.materials if each.name == "Scripted")
    assert made.closures[0].weight == (0.25, 0.5, 0.75)
