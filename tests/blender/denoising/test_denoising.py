"""Denoised renders in Blender, and the passes that guide the denoiser."""

import bpy
import numpy as np
import pytest

from raybatch_addon.blender import frame, sessions
from raybatch_addon.blender.denoise_library import why_not
from raybatch_addon.blender.reports import last
from raybatch_addon.blender.status import terminal
from raybatch_addon.core.measure.parts import PARTS
from tests.blender.features.compare import add_world
from tests.support.blender_watch import watch_engines

OpenEXR = pytest.importorskip("OpenEXR")
needs_library = pytest.mark.skipif(bool(why_not("")), reason="this Blender has no Open Image Denoise")
DIFFUSE, MIRROR, LEFT, TINT = (0.5, 0.4, 0.3), 0.5, 0.25, (0.8, 0.4, 0.2)


@pytest.fixture
def room(scene):
    """Seen from straight above, from left to right: a tilted diffuse plane, a mirror, tinted glass without refraction
    over the plane's colour, and the world.
    """
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    scene.camera.location, scene.camera.data.clip_start = (0, 0, 5), 0.5
    scene.render.resolution_x, scene.render.resolution_y = 16, 8
    scene.raybatch.pixel_filter, scene.raybatch.sample_count = "BOX", 4
    scene.raybatch.kernel_tier = "SPECIALISED"
    add_world(scene, 1.0, TINT)
    diffuse = material("ShaderNodeBsdfDiffuse", Color=(*DIFFUSE, 1))
    add_plane(-1.5, 0.0, diffuse, tilt=LEFT)
    add_plane(-0.5, 0.0, material("ShaderNodeBsdfAnisotropic", Color=(MIRROR,) * 3 + (1,), Roughness=0.0))
    add_plane(0.5, 1.0, material("ShaderNodeBsdfTransparent", Color=(0.5,) * 3 + (1,)))
    add_plane(0.5, 0.0, diffuse)
    return scene


def material(kind: str, **inputs) -> bpy.types.Material:
    made = bpy.data.materials.new(kind)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def add_plane(x: float, z: float, of: bpy.types.Material, tilt: float = 0.0) -> None:
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-0.5, -4, 0), (0.5, -4, 0), (0.5, 4, 0), (-0.5, 4, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(of)
    made = bpy.data.objects.new("Plane", mesh)
    made.location, made.rotation_euler = (x, 0, z), (tilt, 0, 0)
    bpy.context.scene.collection.objects.link(made)


def rendered_film(scene):
    films = []

    def listen(_layer, _exported, film):
        films.append(film)

    frame.film_listeners.append(listen)
    try:
        bpy.ops.render.render()
    finally:
        frame.film_listeners.remove(listen)
    assert not last().errors
    return films[0]


def test_guides_are_those_of_cycles_through_mirrors_and_transparent_surfaces(room):
    bpy.context.view_layer.cycles.denoising_store_passes = True
    passes = rendered_film(room).passes
    albedo, normal, depth = (passes[f"Denoising {name}"][4] for name in ("Albedo", "Normal", "Depth"))
    quarters = [slice(1, 3), slice(5, 7), slice(9, 11), slice(13, 15)]
    # Cycles 5.2 gives the same numbers for these surfaces; only its depth of the world is not 0
    expected_albedo = [DIFFUSE, np.multiply(MIRROR * MIRROR, TINT), np.multiply(0.5, DIFFUSE), TINT]
    expected_normal = [(0, -np.sin(LEFT), -np.cos(LEFT)), (0, 0, 0), (0, 0, -0.5), (0, 0, 0)]
    for quarter, color, direction in zip(quarters, expected_albedo, expected_normal, strict=True):
        assert albedo[quarter] == pytest.approx(np.tile(color, (2, 1)), abs=2e-6)
        assert normal[quarter] == pytest.approx(np.tile(direction, (2, 1)), abs=2e-6)
    # each part of the way counts by what is left; the camera's rays begin at its near plane
    assert depth[quarters[1]] == pytest.approx(4.5, abs=1e-5)
    assert depth[quarters[2]] == pytest.approx(3.5 + 0.5 * 1.0, abs=1e-5)
    assert np.all(depth[quarters[3]] == 0)


def test_guides_leave_the_picture_as_it_is_and_no_schedule_changes_them(room):
    plain = rendered_film(room)
    bpy.context.view_layer.cycles.denoising_store_passes = True
    guided = rendered_film(room)
    assert np.array_equal(plain.passes["Combined"], guided.passes["Combined"])
    room.raybatch.tile_size, room.raybatch.thread_count, room.raybatch.error_estimate = 8, 2, "OFF"
    again = rendered_film(room)
    assert all(np.array_equal(values, again.passes[name]) for name, values in guided.passes.items())
    assert np.array_equal(guided.sums.sums(), again.sums.sums())


@needs_library
def test_a_denoised_render_keeps_the_noisy_picture_and_leaves_the_film_alone(room, tmp_path):
    plain = rendered_film(room).passes["Combined"]
    room.raybatch.denoise, room.raybatch.error_estimate = "ON", "OFF"
    image = room.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    room.render.filepath = str(tmp_path / "passes.exr")
    films = []
    frame.film_listeners.append(lambda _layer, _exported, film: films.append(film))
    try:
        bpy.ops.render.render(write_still=True)
    finally:
        frame.film_listeners.pop()
    film = films[0]
    assert np.array_equal(film.passes["Combined"], plain) and np.array_equal(film.made["Noisy Image"], plain)
    assert not np.array_equal(film.made["Combined"], plain)
    assert film.statistics["denoise"]["inputs"] == "ALBEDO_NORMAL"
    with OpenEXR.File(room.render.filepath, separate_channels=True) as file:
        found = {name.split(".", 1)[1]: c.pixels[::-1] for part in file.parts for name, c in part.channels.items()}
    for name in ("Combined", "Noisy Image"):
        pixels = np.stack([found[f"{name}.{letter}"] for letter in "RGBA"], -1)
        assert np.array_equal(pixels, film.made[name])


@needs_library
def test_a_cancel_ends_denoising_and_keeps_the_noisy_picture(room, monkeypatch):
    plain = rendered_film(room).passes["Combined"]
    room.raybatch.denoise, room.raybatch.error_estimate = "ON", "OFF"
    monkeypatch.setattr(terminal, "PLAIN_SECONDS", 0.0)  # each line is seen
    lines = []
    watch_engines(
        monkeypatch,
        update_stats=lambda _engine, _layer, line: lines.append(line),
        test_break=lambda _engine: "Denoising" in lines,
    )
    film = rendered_film(room)
    assert film.complete and "denoise" not in film.statistics
    assert list(film.made) == ["Noisy Image"] and np.array_equal(film.made["Noisy Image"], plain)
    monkeypatch.undo()
    assert "Combined" in rendered_film(room).made, "the next one is denoised"


@needs_library
def test_all_parts_of_a_denoised_render_are_reported_and_add_up(room):
    room.raybatch.denoise, room.raybatch.error_estimate = "ON", "OFF"
    sessions.close_all()  # nothing of the scene is there yet
    reported = rendered_film(room).statistics["seconds"]
    named = [part for part in PARTS if part in reported]
    assert named == [part for part in PARTS if part not in ("checkpoint", "displacement", "wait", "volumes")]
    assert reported["total"] == pytest.approx(sum(reported[part] for part in named), abs=1e-5)
    assert min(reported["export"], reported["render"], reported["denoise"]) > 0


@needs_library
def test_each_frame_of_an_animation_is_denoised(room, tmp_path):
    """Files hold the denoised picture of their own frame: the film's of each, and that of the frame alone."""
    room.raybatch.denoise, room.raybatch.error_estimate = "ON", "OFF"
    plane = next(each for each in room.objects if each.type == "MESH")
    for number, x in ((1, -1.5), (2, 1.5)):
        plane.location.x = x
        plane.keyframe_insert("location", frame=number)
    image = room.render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "32", "ZIP"
    room.frame_start, room.frame_end, room.render.filepath = 1, 2, str(tmp_path / "frame_")
    films = []
    frame.film_listeners.append(lambda _layer, _exported, film: films.append(film))
    try:
        bpy.ops.render.render(animation=True)
    finally:
        frame.film_listeners.pop()
    assert len(films) == 2 and not last().errors
    for number, film in enumerate(films, 1):
        with OpenEXR.File(str(tmp_path / f"frame_{number:04d}.exr")) as file:
            (pixels,) = (channel.pixels for part in file.parts for channel in part.channels.values())
        assert np.array_equal(pixels[::-1], film.made["Combined"])
        assert not np.array_equal(film.made["Combined"], film.passes["Combined"])
        room.frame_set(number)
        assert np.array_equal(rendered_film(room).made["Combined"], film.made["Combined"])
    assert not np.array_equal(films[0].made["Combined"], films[1].made["Combined"])


def test_a_library_that_is_missing_ends_the_render_before_it_begins(room):
    room.raybatch.denoise, room.raybatch.denoise_library = "ON", "/nowhere/lib.so"
    with pytest.raises(RuntimeError, match="there is no file /nowhere/lib.so"):
        bpy.ops.render.render()
    assert not last().statistics
