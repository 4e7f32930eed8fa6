"""A viewport from Blender's callbacks to the picture that is drawn."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import sessions
from raybatch_addon.blender.viewport import viewport as viewports
from raybatch_addon.core.live.render import LiveState
from raybatch_addon.export.live.settings import left_out, live_settings, pixel_side
from tests.blender.viewport.regions import region_context
from tests.blender.viewport.shown import Shown, edit


def test_what_is_drawn_last_is_the_render_of_the_scene(shown):
    shown.until(shown.is_finished)
    last = shown.drawn[-1]
    assert last.samples == 4 and last.box == (0, 0, 48, 32)
    with sessions.session_for(last.request.settings) as session:
        film = session.render(last.request.scene, last.request.settings)
    assert last.pixels.tobytes() == film.passes["Combined"].tobytes()
    assert last.pixels[..., :3].max() > 0.5
    assert shown.viewport.status() == ("RayBatch", "Sample 4/4")


def test_a_new_view_reads_nothing(shown):
    shown.until(shown.is_finished)
    counts, number = dict(shown.viewport.live.counts), shown.request.number
    shown.context.region.data.view_perspective = "PERSP"
    moved = shown.context.region.data.view_matrix.copy()
    moved.translation.x += 1
    shown.context.region.data.view_matrix = moved
    shown.draw()
    shown.until(shown.is_finished)
    assert shown.request.number == number + 1 and dict(shown.viewport.live.counts) == counts
    shown.draw()
    assert shown.request.number == number + 1


def test_an_edit_is_shown(shown):
    shown.until(shown.is_finished)
    before = shown.drawn[-1]
    emission = bpy.data.materials["Material"].node_tree.nodes["Emission"]
    edit(lambda: setattr(emission.inputs["Strength"], "default_value", 3.0))
    shown.until(lambda: shown.is_finished() and shown.request.number > before.request.number)
    assert shown.drawn[-1].pixels[..., 0].max() > 2 * before.pixels[..., 0].max()
    assert shown.request.scene.meshes[0].positions is before.request.scene.meshes[0].positions


def test_a_final_render_goes_first_and_the_viewport_goes_on(shown, lit, tmp_path):
    lit.raybatch_viewport.samples = 100_000
    shown.until(lambda: shown.drawn and shown.drawn[-1].request.settings.sample_count == 100_000)
    lit.render.filepath = str(tmp_path / "final")
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    assert (tmp_path / "final.png").exists()
    lit.raybatch_viewport.samples = 2
    shown.until(lambda: shown.is_finished() and shown.drawn[-1].samples == 2)
    assert not shown.viewport.render.state.error


def test_two_viewports_take_turns(shown, lit):
    lit.raybatch_viewport.samples = 300
    second = Shown(region_context(40, 30))
    second.drawn = shown.drawn  # drawn by one function
    second.update(bpy.context.evaluated_depsgraph_get())
    both = [shown.viewport.render, second.viewport.render]
    try:
        shown.until(lambda: second.draw() or all(each.picture for each in both))
        assert not any(each.picture.samples == 300 for each in both)
        shown.until(lambda: second.draw() or (shown.is_finished() and second.is_finished()))
    finally:
        second.viewport.close()
    assert {each.samples for each in (shown.viewport.render.picture, second.viewport.render.picture)} == {300}
    assert second.viewport.render.join(60)


def test_settings_that_do_not_go_together_are_reported_in_the_view(shown, lit):
    lit.raybatch.ray_low_water, lit.raybatch.ray_high_water = 0.9, 0.2
    shown.draw()
    assert "ray_low_water" in shown.viewport.status()[1]
    lit.raybatch.ray_low_water, lit.raybatch.ray_high_water = 0.1, 0.9
    shown.until(shown.is_finished)
    assert "Sample" in shown.viewport.status()[1]


def test_a_device_that_is_not_there_is_reported_in_the_view(shown, lit):
    lit.raybatch.device = "cuda:7"
    shown.until(lambda: shown.viewport.render.state.error)
    assert "cuda:7" in shown.viewport.status()[1]


def test_deleted_objects_and_cameras_and_new_files_are_safe(shown, lit):
    shown.until(shown.is_finished)
    edit(lambda: bpy.data.objects.remove(bpy.data.objects["Grid"]))
    shown.until(shown.is_finished)
    assert len(shown.request.scene.instances) == 0
    edit(lambda: bpy.data.objects.remove(lit.camera))
    shown.until(shown.is_finished)
    assert "could not" not in shown.viewport.status()[1]


def test_what_goes_wrong_is_reported_in_the_view_and_not_raised(shown, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(viewports, "live_camera", broken)
    shown.draw()
    assert "ZeroDivisionError" in shown.viewport.status()[1]
    shown.update(bpy.context.evaluated_depsgraph_get())


def test_all_viewports_end_together(shown):
    shown.until(lambda: shown.drawn)
    viewports.close_viewports()
    assert shown.viewport.render.join(0.0)
    shown.draw()  # Blender may draw once more


def test_settings_of_viewports(lit):
    lit.raybatch.time_limit, lit.raybatch.adaptive_sampling, lit.raybatch.sample_count = 3.0, "ON", 99
    lit.render.use_motion_blur, lit.raybatch.tile_order = True, "PROGRESSIVE"
    found = live_settings(lit)
    assert found.tile_order == "TILE_FIRST"
    assert (found.sample_count, found.time_limit, found.adaptive_sampling, found.denoise) == (4, 0, "OFF", "OFF")
    assert left_out(lit) == ["motion blur", "adaptive sampling", "time limit"]
    lit.render.preview_pixel_size = "4"
    assert pixel_side(lit) == 4
    lit.render.preview_pixel_size = "AUTO"
    assert (pixel_side(lit), pixel_side(lit, 2.0)) == (1, 2)


@pytest.mark.parametrize(
    "state, text",
    [
        (LiveState(), ""),
        (LiveState(samples=4, samples_total=4), "Sample 4/4"),
        (LiveState(stage="Rendering", samples=1.7, samples_total=4, memory_bytes=3 << 20), "Sample 1/4 | Memory 3 MB"),
        (
            LiveState(stage="Rendering", samples=1, samples_total=4, compiles=True),
            "Sample 1/4 | compiling specialised kernels",
        ),
        (LiveState(stage="Building the tree"), "Building the tree"),
    ],
)
def test_states_in_words(state, text):
    assert viewports.live_status(state) == text
