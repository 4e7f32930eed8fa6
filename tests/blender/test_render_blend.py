"""scripts/render.py on Blender's files: the same render as Blender's own, whatever other options are given."""

import json

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from tests.support.command_line import error_line, run_python, run_script
from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.passes import GUIDE_PASSES

# the steps of a person: open the file, render, save
RENDER_BY_HAND = """
import sys
import bpy
import raybatch_addon
raybatch_addon.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
scene.render.engine = "RAYBATCH"
scene.frame_set(3)
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
"""


def make_scene(path, *words):
    """Write a small scene: a cube that rises a metre a frame, two view layers of which one lacks it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "RAYBATCH"
    scene.render.resolution_x, scene.render.resolution_y, scene.frame_current = 24, 16, 2
    scene.raybatch.device, scene.raybatch.sample_count = "cpu", 2
    hidden = bpy.data.collections.new("hidden")
    scene.collection.children.link(hidden)
    bpy.ops.mesh.primitive_cube_add(size=2)
    cube = bpy.context.object
    scene.collection.objects.unlink(cube)
    hidden.objects.link(cube)
    for frame in (1, 4):
        cube.location.z = frame - 1
        cube.keyframe_insert("location", frame=frame)
    subdivision = cube.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 0, 3
    if "no camera" not in words:
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.location, camera.rotation_euler = (0, -8, 0.5), (1.5707963, 0, 0)
        scene.collection.objects.link(camera)
        scene.camera = camera
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.2, 0.4, 0.6)
    scene.render.image_settings.color_mode = "RGBA"
    if "layers" in words:
        layer = scene.view_layers.new("Empty")
        layer.layer_collection.children["hidden"].exclude = True
        layer.use_pass_z = True
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture(scope="module")
def blend(addon, tmp_path_factory):
    """A scene of one view layer."""
    return make_scene(tmp_path_factory.mktemp("blend") / "one.blend")


def run(*arguments, by=call_script):
    done = by("render.py", *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_one_frame_with_everything(blend, tmp_path):
    out = tmp_path / "out"
    run(
        blend,
        "--frame",
        "3",
        "-o",
        out / "a.png",
        "--film",
        out / "a.npz",
        "--json",
        out / "a.json",
        "--save-scene",
        out / "a.scene.npz",
        by=run_script,
    )
    assert names(out) == ["a.json", "a.npz", "a.png", "a.scene.npz"]
    statistics = json.loads((out / "a.json").read_text())
    assert (statistics["frame"]["number"], statistics["frame"]["view_layer"]) == (3, "ViewLayer")
    assert statistics["seconds"]["export"] > 0 and statistics["versions"]["blender"]

    # the same as by hand, and not the same as another frame
    done = run_python(RENDER_BY_HAND, blend, tmp_path / "hand.png")
    assert done.returncode == 0, done.stderr
    by_hand = np.array(Image.open(tmp_path / "hand.png"))
    assert by_hand.shape == (16, 24, 4)
    assert (np.array(Image.open(out / "a.png")) == by_hand).all()

    # the saved scene gives the same bits; it has the modifiers' levels of a render
    run(out / "a.scene.npz", "--film", tmp_path / "b.npz", "--device", "cpu")
    with np.load(out / "a.npz") as a, np.load(tmp_path / "b.npz") as b:
        assert a.files == b.files == ["Combined"]
        assert a["Combined"].shape == (16, 24, 4)
        assert a["Combined"].tobytes() == b["Combined"].tobytes()
    assert statistics["triangles"] == 12 * 4**3


def test_frames_are_numbered_as_blender_does(blend, tmp_path):
    run(
        blend, "--frames", "1..2", "-o", tmp_path / "f_", "--film", tmp_path / "film.npz", "--json", tmp_path / "j.json"
    )
    assert names(tmp_path) == ["f_0001.png", "f_0002.png", "film0001.npz", "film0002.npz", "j.json"]
    pictures = [np.array(Image.open(tmp_path / f"f_000{n}.png")) for n in (1, 2)]
    assert (pictures[0] != pictures[1]).any()
    assert [entry["frame"]["number"] for entry in json.loads((tmp_path / "j.json").read_text())] == [1, 2]


def test_passes_that_no_file_will_hold_are_named(blend, tmp_path):
    """A film or a multilayer file holds them, a heat map its own."""
    depth = ["-o", tmp_path / "a.png", "--passes", "depth,normal", "--heat-map", f"depth={tmp_path / 'depth.png'}"]
    done = call_script("render.py", blend, *depth)
    assert done.returncode == 0 and "Normal: rendered, but written nowhere; give --film" in done.stderr
    done = call_script("render.py", blend, *depth, "--film", tmp_path / "a.npz")
    assert done.returncode == 0 and "written nowhere" not in done.stderr


def test_openexr_has_the_picture_or_all_layers_and_passes(addon, tmp_path):
    """Of a file that is set to PNG: what a .exr leaves out is said, and with --multilayer nothing is; nor is a picture
    by the file's own format silent.
    """
    blend = make_scene(tmp_path / "two.blend", "layers")
    for out, more in (("a.exr", ()), ("b.exr", ["--multilayer"]), ("c_", ["--multilayer"])):
        done = call_script("render.py", blend, "-o", tmp_path / out, *more, "--passes", "normal")
        assert done.returncode == 0, done.stderr
        assert ("Normal, Depth: rendered, but written nowhere" in done.stderr) == (not more)
    channels = {}
    for name in ("a.exr", "b.exr", "c_0002.exr"):
        with OpenEXR.File(str(tmp_path / name), separate_channels=True) as file:
            channels[name] = {channel for part in file.parts for channel in part.channels}
    assert channels["a.exr"] <= set("RGBA") and channels["b.exr"] == channels["c_0002.exr"]
    assert {"ViewLayer.Normal.X", "Empty.Normal.X", "Empty.Depth.Z", "Empty.Combined.R"} <= {
        each.replace("Depth.V", "Depth.Z") for each in channels["b.exr"]
    }
    assert "--multilayer writes OpenEXR files" in error_line(
        call_script("render.py", blend, "-o", tmp_path / "d.png", "--multilayer")
    )
    bpy.context.scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.ops.wm.save_mainfile()
    done = call_script("render.py", blend, "-o", tmp_path / "e_")
    assert done.returncode == 0 and "Depth: rendered, but written nowhere" in done.stderr


def test_a_png_of_a_file_that_is_set_to_openexr_has_eight_bits(addon, tmp_path):
    blend = make_scene(tmp_path / "one.blend")
    image = bpy.context.scene.render.image_settings
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    bpy.ops.wm.save_mainfile()
    run(blend, "-o", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[24] == 8  # of IHDR


def test_what_is_taken_over_is_not_said_of_settings_of_the_command_line(addon, tmp_path):
    blend = make_scene(tmp_path / "one.blend")
    bpy.context.scene.cycles.samples, bpy.context.scene.cycles.max_bounces = 123, 5
    bpy.ops.wm.save_mainfile()
    done = call_script(
        "render.py", blend, "-o", tmp_path / "a.png", "--settings-from", "cycles", "--set", "sample_count=2"
    )
    assert done.returncode == 0 and "123" not in done.stderr and "5, as in Cycles" in done.stderr


def test_settings_of_the_schedule_and_passes_that_show_cost(blend, tmp_path):
    """All settings by name, from the command line; the picture is the same."""
    out = tmp_path / "out"
    run(blend, "--film", tmp_path / "plain.npz")
    arguments = [
        argument
        for pair in (
            "ray_sort=OFF",
            "counters=ON",
            "spatial_splits=ON",
            "treelet_bytes=7MiB",
            "geometry_budget=1500000001",
        )
        for argument in ("--set", pair)
    ]
    run(
        blend,
        *arguments,
        "--passes",
        "normal, Triangle Tests, Denoising Depth",
        "--heat-map",
        f"node steps={out / 'steps.png'}",
        "--film",
        out / "a.npz",
        "--json",
        out / "a.json",
    )
    assert names(out) == ["a.json", "a.npz", "steps.png"]
    with np.load(out / "a.npz") as film, np.load(tmp_path / "plain.npz") as plain:
        assert set(film.files) == {"Combined", "Normal", "Node Steps", "Triangle Tests", *GUIDE_PASSES}
        assert film["Combined"].tobytes() == plain["Combined"].tobytes()
        steps = film["Node Steps"][..., 0]
    picture = np.array(Image.open(out / "steps.png")).astype(int).sum(-1)[::-1]
    assert picture.shape == steps.shape
    order = np.argsort(steps, axis=None)
    assert (np.diff(picture.ravel()[order]) >= 0).all() and picture.max() > 600
    statistics = json.loads((out / "a.json").read_text())
    assert statistics["settings"]["ray_sort"] == "OFF" and statistics["ray_sort"] is None
    assert statistics["settings"]["spatial_splits"] == statistics["settings"]["counters"] == "ON"
    assert (statistics["settings"]["treelet_bytes"], statistics["settings"]["geometry_budget"]) == (
        7 << 20,
        1_500_000_001,
    )
    assert statistics["counters"]["seconds"]["trace"] > 0
    again = tmp_path / "frames"
    run(blend, "--frames", "1..2", "--heat-map", f"Rays={again / 'rays.png'}")
    assert names(again) == ["rays0001.png", "rays0002.png"]


def test_view_layers_size_and_format(addon, tmp_path):
    blend = make_scene(tmp_path / "two.blend", "layers")
    out = tmp_path / "out"
    run(
        blend,
        "-o",
        out / "x##.exr",
        "--film",
        out / "all.npz",
        "--json",
        out / "all.json",
        "--set",
        "resolution=12x10",
        "--set",
        "sample_count=1",
    )
    run(
        blend,
        "--film",
        out / "one.npz",
        "--view-layer",
        "Empty",
        "--set",
        "resolution=12x10",
        "--set",
        "sample_count=1",
    )
    assert names(out) == ["all.json", "all.npz", "one.npz", "x02.exr"]
    assert (out / "x02.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
    layers = [entry["frame"]["view_layer"] for entry in json.loads((out / "all.json").read_text())]
    assert layers == ["ViewLayer", "Empty"]
    with np.load(out / "all.npz") as both, np.load(out / "one.npz") as one:
        assert both.files == ["Combined", "Empty/Combined", "Empty/Depth"]
        assert both["Empty/Depth"].shape == (10, 12, 1)
        assert (both["Combined"] != both["Empty/Combined"]).any()
        assert one["Combined"].tobytes() == both["Empty/Combined"].tobytes()


def test_saving_the_scene_alone(blend, tmp_path):
    run(blend, "--save-scene", tmp_path / "s.scene.npz", "--set", "sample_count=1000000000")
    assert names(tmp_path) == ["s.scene.npz"]


@pytest.mark.parametrize(
    ("words", "arguments", "message"),
    [
        (["no camera"], [], "camera"),
        (["layers"], ["--view-layer", "Nope"], "no view layer 'Nope'; there is ViewLayer, Empty"),
        (["layers"], ["--save-scene", "{folder}/s.scene.npz"], "one picture"),
        ([], ["--device", "cuda:99"], "no device 'cuda:99'"),
        ([], ["--set", "ray_low_water=0.9", "--set", "ray_high_water=0.5"], "ray_low_water"),
        ([], ["--camera", "0,0,1,0,0,0,40"], "has a camera of its own"),
        ([], ["-o", "{folder}/x.gif"], "Blender writes no .gif"),
        ([], ["-o", "{folder}/x.pgn"], ".pgn is no picture's extension; did you mean .png?"),
    ],
)
def test_errors_leave_no_picture(blend, tmp_path, words, arguments, message):
    source = make_scene(tmp_path / "bad.blend", *words) if words else blend
    out = tmp_path / "out"
    line = error_line(
        call_script("render.py", source, "-o", out / "x.png", *[argument.format(folder=out) for argument in arguments])
    )
    assert message in line.replace("Cannot render, no camera", "camera")
    assert not out.exists()


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".gltf"])
def test_imported_geometry_looks_like_the_same_arrays(tmp_path, suffix):
    """A tent, read from a file of each kind and from arrays, seen by the same camera in the same default light."""
    v = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1.5]], np.float32)
    f = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    up = "z" if suffix == ".ply" else "y"
    if up == "y":
        v = v[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    write = {".obj": write_obj, ".ply": write_ply, ".gltf": write_gltf}[suffix]
    write(tmp_path / f"tent{suffix}", v, f)
    np.savez(tmp_path / "tent.npz", v=v, f=f)
    eye = "3,-4,2,0,0,0.5,40" if up == "z" else "3,2,4,0,0.5,0,40"
    for name in (f"tent{suffix}", "tent.npz"):
        run(
            tmp_path / name,
            "--film",
            tmp_path / f"{name}.film.npz",
            "--camera",
            eye,
            "--up",
            up,
            "--device",
            "cpu",
            "--set",
            "resolution=40x30",
            "--set",
            "sample_count=64",
        )
    with np.load(tmp_path / f"tent{suffix}.film.npz") as a, np.load(tmp_path / "tent.npz.film.npz") as b:
        imported, arrays = a["Combined"], b["Combined"]
    assert imported.shape == (30, 40, 4)
    difference = np.abs(imported - arrays)[..., :3].mean(-1)
    # noise, and the importer's material, which is a Principled one: its coat reflects a few per cent
    assert np.median(difference) < 0.05
    sky = arrays[-1, 0]
    assert ((imported == sky).all(-1) == (arrays == sky).all(-1)).mean() > 0.97  # the same outline


def write_obj(path, v, f):
    lines = [f"v {x} {y} {z}" for x, y, z in v] + [f"f {a} {b} {c}" for a, b, c in f + 1]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path, v, f):
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(v)}",
        "property float x",
        "property float y",
        "property float z",
        f"element face {len(f)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    lines = head + [f"{x} {y} {z}" for x, y, z in v] + [f"3 {a} {b} {c}" for a, b, c in f]
    path.write_text("\n".join(lines) + "\n")


def write_gltf(path, v, f):
    import base64

    data = v.tobytes() + f.astype(np.uint32).tobytes()
    path.write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "scene": 0,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
                "accessors": [
                    {
                        "bufferView": 0,
                        "componentType": 5126,
                        "count": len(v),
                        "type": "VEC3",
                        "min": v.min(0).tolist(),
                        "max": v.max(0).tolist(),
                    },
                    {"bufferView": 1, "componentType": 5125, "count": f.size, "type": "SCALAR"},
                ],
                "bufferViews": [
                    {"buffer": 0, "byteOffset": 0, "byteLength": v.nbytes},
                    {"buffer": 0, "byteOffset": v.nbytes, "byteLength": 4 * f.size},
                ],
                "buffers": [
                    {
                        "byteLength": len(data),
                        "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
                    }
                ],
            }
        )
    )
