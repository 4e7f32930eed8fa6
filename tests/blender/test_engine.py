"""The engine in Blender: tiles, borders, layers, passes, cancelling and failing."""

import os
import subprocess
import sys
import types

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame, reports, sessions
from raybatch_addon.blender.result import ResultWriter, register_passes
from raybatch_addon.blender.status import terminal
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.host_memory import host_memory_used
from raybatch_addon.export.passes import OWN_PASS_PROPERTIES
from tests.support.blender_builders import add_object, add_triangle, material_of, node_tree
from tests.support.blender_watch import watch_engines


@pytest.fixture
def lit(scene):
    """The scene with an emitting triangle in front of a grey world; nothing else is compiled for it."""
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.25, 0.5, 0.75)
    if scene.world.node_tree is not None:
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.25, 0.5, 0.75, 1)
    obj = add_triangle()
    obj.scale, obj.location = (3, 3, 3), (-1, -1, 0)
    tree, surface = node_tree(material_of(obj))
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1, 0.5, 0.25, 1)
    tree.links.new(emission.outputs[0], surface)
    scene.raybatch.tile_size = 16
    settings = scene.render.image_settings
    settings.file_format = "OPEN_EXR"
    settings.color_mode, settings.color_depth, settings.exr_codec = "RGBA", "32", "ZIP"
    return scene


@pytest.fixture
def films(lit):
    """(view layer, film) of every render."""
    got = []

    def listen(layer, _scene, film):
        got.append((layer, film))

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)


@pytest.fixture
def watch(monkeypatch):
    """watch(name=function, ...): replace methods of every engine; the functions get the engine first."""
    return lambda **methods: watch_engines(monkeypatch, **methods)


@pytest.fixture
def rectangles(watch):
    """x, y, width, height of every result that the engine opens."""
    got = []

    def record(engine, x, y, width, height, **options):
        got.append((x, y, width, height))
        return engine.begin_result(x, y, width, height, **options)

    watch(begin_result=record)
    return got


def render(path):
    """Render to `path`, and return the pixels of the file: float32 [height, width, 4], bottom row first."""
    scene = bpy.context.scene
    scene.render.filepath = str(path)
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    image = bpy.data.images.load(str(path) + ".exr")
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    pixels = pixels.reshape(height, width, 4)
    bpy.data.images.remove(image)
    return pixels


def test_the_file_holds_the_film_and_tiles_cover_the_frame(films, rectangles, tmp_path):
    pixels = render(tmp_path / "picture")
    ((layer, film),) = films
    assert layer == "ViewLayer"
    assert np.array_equal(pixels, film.passes["Combined"])
    assert pixels[0, 0, :3] == pytest.approx([0.25, 0.5, 0.75], rel=1e-5)
    assert pixels[12, 16, :3] == pytest.approx([1, 0.5, 0.25], rel=1e-5)
    covered = np.zeros((24, 32), int)
    for x, y, width, height in rectangles:
        covered[y : y + height, x : x + width] += 1
    assert len(set(rectangles)) >= 4
    assert (covered > 0).all()


@pytest.mark.parametrize("crop", [True, False])
def test_a_border_equals_that_part_of_the_frame(films, crop, tmp_path):
    full = render(tmp_path / "full")
    settings = bpy.context.scene.render
    settings.use_border, settings.use_crop_to_border = True, crop
    settings.border_min_x, settings.border_max_x, settings.border_min_y, settings.border_max_y = 0.3, 0.8, 0.15, 0.7
    part = render(tmp_path / "part")
    x0, y0, x1, y1 = films[1][1].region
    assert (x0, y0, x1, y1) == (9, 3, 25, 16)
    if crop:
        assert np.array_equal(part, full[y0:y1, x0:x1])
    else:
        assert part.shape == full.shape
        assert np.array_equal(part[y0:y1, x0:x1], full[y0:y1, x0:x1])
        outside = np.ones(part.shape[:2], bool)
        outside[y0:y1, x0:x1] = False
        assert not part[outside].any()


def test_a_percentage_scales_the_picture(lit, films, tmp_path):
    lit.render.resolution_percentage = 150
    assert render(tmp_path / "large").shape == (36, 48, 4)


def test_a_transparent_film_has_no_world(lit, films, tmp_path):
    lit.render.film_transparent = True
    pixels = render(tmp_path / "cut out")
    assert pixels[0, 0].tolist() == [0, 0, 0, 0]
    assert pixels[12, 16] == pytest.approx([1, 0.5, 0.25, 1], rel=1e-5)


def test_every_pass_that_is_asked_for_is_written(lit, films, watch, tmp_path):
    layer = lit.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_position = True
    layer.raybatch.use_pass_rays = layer.raybatch.use_pass_node_steps = layer.raybatch.use_pass_triangle_tests = True
    layer.raybatch.use_pass_sample_count = True
    seen = {}

    def record(engine, result, **options):
        for target in result.layers[0].passes:
            values = np.empty((len(target.rect), target.channels), np.float32)
            target.rect.foreach_get(values.reshape(-1))
            seen.setdefault(target.name, []).append(values)
        return engine.end_result(result, **options)

    watch(end_result=record)
    render(tmp_path / "passes")
    seen = {name: np.concatenate(parts) for name, parts in seen.items()}
    own = dict.fromkeys(("Depth", "Rays", "Node Steps", "Triangle Tests", "Sample Count"), 1)
    channels = {name: values.shape[1] for name, values in seen.items()}
    assert channels == {"Combined": 4, "Position": 3, "Normal": 3, **own}
    film = films[0][1]
    for name in seen:  # tiles come in any order
        assert np.array_equal(np.sort(seen[name], axis=None), np.sort(film.passes[name], axis=None)), name
    assert film.statistics["counters"]["rays"]["closest"][0] == 32 * 24 * 2 and seen["Rays"].min() >= 1
    assert 0 == seen["Triangle Tests"].min() < seen["Triangle Tests"].max()
    inside = seen["Depth"][:, 0] < 100
    assert inside.any() and not inside.all()
    assert seen["Depth"][inside] == pytest.approx(10, rel=1e-4)
    assert seen["Position"][inside][:, 2] == pytest.approx(0, abs=1e-4)
    assert seen["Normal"].max(axis=0) == pytest.approx([0, 0, 1], abs=1e-4)


def test_cost_is_counted_for_those_who_ask_alone(films, tmp_path):
    """Toggles are each view layer's own, and the registered passes follow them; nothing else in the file changes."""
    scene = bpy.context.scene
    second = scene.view_layers.new("Costly")
    second.raybatch.use_pass_node_steps = True
    registered = {}
    for layer in scene.view_layers:
        engine = types.SimpleNamespace(
            register_pass=lambda _scene, layer, *about: registered.setdefault(layer.name, []).append(about)
        )
        register_passes(engine, scene, layer)
    assert registered["ViewLayer"] == [("Combined", 4, "RGBA", "COLOR")]
    assert registered["Costly"] == [("Combined", 4, "RGBA", "COLOR"), ("Node Steps", 1, "X", "VALUE")]
    render(tmp_path / "two")
    (_, plain), (_, costly) = films
    assert plain.statistics["counters"] is None and list(plain.passes) == ["Combined"]
    assert costly.statistics["counters"] and list(costly.passes) == ["Combined", "Node Steps"]
    assert np.array_equal(plain.passes["Combined"], costly.passes["Combined"])


def test_adaptive_sampling_reports_who_got_how_many_samples(lit, films, tmp_path):
    lit.raybatch.adaptive_sampling, lit.raybatch.noise_threshold = "ON", 0.001
    lit.raybatch.sample_count, lit.raybatch.adaptive_samples_min = 12, 4
    lit.view_layers[0].raybatch.use_pass_sample_count = True
    lit.view_layers[0].cycles.pass_debug_sample_count = True  # the same, as Cycles has it
    render(tmp_path / "adaptive")
    counts, reported = films[0][1].passes["Sample Count"], films[0][1].statistics["adaptive"]
    assert reported["threshold"] == 0.001 and counts.min() == 4
    assert counts.mean() == pytest.approx(reported["samples_mean"], rel=1e-5)
    share = films[0][1].made["Debug Sample Count"]
    assert np.allclose(share, counts / counts.max()) and counts.max() > 4


def test_the_compositor_has_a_socket_for_each_pass(lit):
    layer = lit.view_layers[0]
    if bpy.app.version < (5, 0):
        lit.use_nodes = True
        tree = lit.node_tree
    else:
        tree = lit.compositing_node_group = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    node = tree.nodes.new("CompositorNodeRLayers")

    def sockets():
        return {socket.name for socket in node.outputs if socket.enabled}

    for prop, name in OWN_PASS_PROPERTIES.items():
        assert name not in sockets()
        setattr(layer.raybatch, prop, True)
        assert name in sockets()
        setattr(layer.raybatch, prop, False)
        assert name not in sockets()


def test_every_view_layer_is_rendered_with_its_own_objects(lit, films, tmp_path):
    lit.view_layers.new("Empty").layer_collection.exclude = True
    lit.view_layers["Empty"].use_solid = False
    render(tmp_path / "layers")
    assert [layer for layer, _ in films] == ["ViewLayer", "Empty"]
    centres = [film.passes["Combined"][12, 16, :3] for _, film in films]
    assert centres[0] == pytest.approx([1, 0.5, 0.25], rel=1e-5)
    assert centres[1] == pytest.approx([0.25, 0.5, 0.75], rel=1e-5)
    assert set(reports.last().statistics) == {"ViewLayer", "Empty"}


def test_frames_of_an_animation_share_one_session(lit, films, tmp_path):
    obj = bpy.data.objects["Triangle"]
    for number, x in ((1, -1), (3, 50)):
        obj.location[0] = x
        obj.keyframe_insert("location", frame=number)
    lit.frame_start, lit.frame_end = 1, 3
    lit.render.filepath = str(tmp_path / "frame")
    sessions.close_all()  # those of tests before, and of previews
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    assert sorted(os.listdir(tmp_path)) == ["frame0001.exr", "frame0002.exr", "frame0003.exr"]
    assert len(sessions._sessions) == 1
    assert np.abs(films[0][1].passes["Combined"] - films[2][1].passes["Combined"]).max() > 0.1


def test_a_cancelled_render_keeps_what_is_done(lit, monkeypatch, watch, films):
    written = []
    write = ResultWriter.write
    monkeypatch.setattr(ResultWriter, "write", lambda self, tile: (written.append(tile), write(self, tile)))
    watch(test_break=lambda engine: len(written) > 0)
    lit.raybatch.thread_count = 1
    lit.raybatch.sample_count = 4096
    bpy.ops.render.render()
    ((_, film),) = films
    assert not film.complete
    assert 0 < len(written) < 4
    assert reports.last().errors == []


def failing(error):
    def fail(*_args, **_options):
        raise error

    return fail


def file_formats():
    return ["PNG", "OPEN_EXR_MULTILAYER"]


def set_format(scene, file_format):
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # from 5.0 on
        settings.media_type = "MULTI_LAYER_IMAGE" if file_format == "OPEN_EXR_MULTILAYER" else "IMAGE"
    settings.file_format = file_format


@pytest.mark.parametrize("file_format", file_formats())
@pytest.mark.parametrize("animation", [False, True])
@pytest.mark.parametrize("stage", ["export", "core", "result"])
def test_a_failed_render_saves_nothing_and_says_why(lit, monkeypatch, tmp_path, capfd, file_format, animation, stage):
    error = SceneError("the moon is missing;\nbring it back") if stage == "export" else ValueError("a bug")
    if stage == "export":
        monkeypatch.setattr(frame, "export_scene", failing(error))
    elif stage == "core":
        monkeypatch.setattr("raybatch_addon.core.session.Session.render", failing(error))
    else:
        # within an open result
        monkeypatch.setattr(
            "raybatch_addon.blender.result.np",
            types.SimpleNamespace(ascontiguousarray=failing(error), float32=np.float32),
        )
    set_format(lit, file_format)
    lit.frame_start, lit.frame_end = 1, 2
    lit.render.filepath = str(tmp_path / "frame")
    said = "the moon is missing; bring it back" if stage == "export" else "ValueError: a bug"
    with pytest.raises(RuntimeError, match=f"RayBatch: .*{said}" if stage != "export" else f"RayBatch: {said}"):
        bpy.ops.render.render(write_still=not animation, animation=animation)
    monkeypatch.undo()
    assert os.listdir(tmp_path) == []
    (line,) = reports.last().errors
    assert said in line and "\n" not in line
    assert ("Traceback" in capfd.readouterr().err) == (stage != "export"), "a bug's traceback goes to the terminal"


def test_a_tile_that_cannot_be_written_is_closed_as_cancelled(lit, watch, monkeypatch):
    opened, closed = [], []

    def end(engine, result, **options):
        closed.append(options)
        return engine.end_result(result, **options)

    watch(
        begin_result=lambda engine, *args, **options: (opened.append(args), engine.begin_result(*args, **options))[1],
        end_result=end,
    )
    monkeypatch.setattr(
        "raybatch_addon.blender.result.np",
        types.SimpleNamespace(ascontiguousarray=failing(ValueError("no")), float32=np.float32),
    )
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert len(opened) == 1
    assert closed == [{"cancel": True}]


def test_a_render_after_a_failed_one_works(lit, monkeypatch, films, tmp_path):
    monkeypatch.setattr(frame, "export_scene", failing(SceneError("no")))
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    monkeypatch.undo()
    assert render(tmp_path / "again").shape == (24, 32, 4)
    assert reports.last().errors == []


def test_after_an_error_the_other_view_layers_are_left_alone(lit, monkeypatch):
    lit.view_layers.new("Second")
    called = []
    monkeypatch.setattr(
        frame, "export_scene", lambda *_args, **_options: called.append(1) or failing(SceneError("no"))()
    )
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert len(called) == 1


def test_an_unknown_device_is_an_error_that_lists_what_there_is(lit):
    lit.raybatch.device = "cuda:99"
    with pytest.raises(RuntimeError, match="cuda:99.*AUTO, cpu"):
        bpy.ops.render.render()


def test_a_camera_that_is_nowhere_is_an_error(lit):
    lit.camera.scale = (0, 0, 0)
    with pytest.raises(RuntimeError, match="“Camera”"):
        bpy.ops.render.render()


def test_warnings_are_reported_and_the_render_goes_on(lit, films):
    add_triangle("Flat").scale = (0, 0, 0)
    add_object("Smoke", bpy.data.volumes.new("Smoke"))
    assert bpy.ops.render.render() == {"FINISHED"}
    text = "\n".join(reports.last().warnings)
    assert "“Flat”" in text and "“Smoke”" in text
    assert films[0][1].statistics["warnings"] == reports.last().warnings


def test_statistics_count_the_export(lit, films):
    bpy.ops.render.render()
    seconds = reports.last().statistics["ViewLayer"]["seconds"]
    assert 0 < seconds["export"] < seconds["total"]


def test_the_status_line_shows_stage_speed_and_time_left(lit, monkeypatch, watch):
    monkeypatch.setattr(terminal, "PLAIN_SECONDS", 0.0)
    lines, fractions, memory = [], [], []
    watch(
        update_stats=lambda engine, stats, info: lines.append(info),
        update_memory_stats=lambda _, **both: memory.append("M, Peak: ".join(f"{each:.0f}" for each in both.values())),
        update_progress=lambda engine, value: fractions.append(value),
    )
    lit.raybatch.sample_count = 64
    bpy.ops.render.render()
    assert lines[:2] == ["Reading the scene", "Starting the device"]
    assert any("/64" in line and "Mrays/s" in line and "left" in line for line in lines)
    tier = reports.last().statistics["ViewLayer"]["kernels"]["tier"].lower()
    assert lines[-2].endswith(f" | {tier} kernels")
    assert [part[5:-1] for line in lines for part in line.split(" | ") if part.startswith("Mem: ")] == memory
    assert lines[-1] == "Sample 64/64 | Finished" and bool(memory) == (host_memory_used() > 0)
    assert fractions == sorted(fractions) and fractions[-1] == 1


def test_the_engine_in_a_fresh_process_starts_warp_only_when_it_renders():
    code = (
        "import sys, bpy, raybatch_addon; raybatch_addon.register(); bpy.context.scene.render.engine = 'RAYBATCH'; "
        "assert 'warp' not in sys.modules; print('fine')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=os.getcwd())
    assert "fine" in done.stdout, done.stderr
