"""Previews of materials, worlds and lights: what they show, and what they leave alone."""

import types

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame, preview, reports, sessions
from raybatch_addon.export.meshes import kept_meshes


def shown(of) -> np.ndarray:
    """The preview of a material, a world or a light, as Blender makes it, RGBA of [0, 1]."""
    of.preview_ensure()
    of.asset_generate_preview()  # without a window it is there when this returns
    height, width = of.preview.image_size[1], of.preview.image_size[0]
    return np.array(of.preview.image_pixels_float[:]).reshape(height, width, 4)


def ball(color) -> "bpy.types.Material":
    material = bpy.data.materials.new("Ball")
    if material.node_tree is None:  # before Blender 5.0
        material.use_nodes = True
    node = next(each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    node.inputs["Base Color"].default_value = (*color, 1)
    return material


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(preview, "PREVIEW_SETTINGS", preview.PREVIEW_SETTINGS.replace(sample_count=4, time_limit=0.0))


def test_previews_are_near_those_of_cycles(scene):
    found = {}
    for engine in ("RAYBATCH", "CYCLES"):
        scene.render.engine = engine
        world, lamp = bpy.data.worlds.new("Sky"), bpy.data.lights.new("Lamp", "AREA")
        found[engine] = [shown(each) for each in (ball((0.8, 0.02, 0.02)), world, lamp)]
    for mine, theirs in zip(*found.values(), strict=True):
        assert mine.shape == theirs.shape and theirs[..., :3].max() > 0
        # pictures of 4 samples differ by noise, but not otherwise
        assert np.abs(mine - theirs).mean() < 0.03
        assert np.abs(mine.mean((0, 1)) - theirs.mean((0, 1))).max() < 0.02


def test_a_preview_shows_its_material(scene):
    red, green = shown(ball((0.8, 0.02, 0.02))), shown(ball((0.02, 0.8, 0.02)))
    middle = slice(48, 80), slice(48, 80)
    assert red[middle][..., 0].mean() > 1.3 * red[middle][..., 1].mean()
    assert green[middle][..., 1].mean() > 1.3 * green[middle][..., 0].mean()


def test_a_preview_leaves_the_last_render_and_what_is_kept_of_the_scene(scene, monkeypatch):
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: pytest.fail("a preview is no render")])
    report = reports.begin("Scene", 7)
    kept, count = dict(kept_meshes._kept), kept_meshes._export_count
    before = dict(sessions._sessions)
    shown(ball((0.5, 0.5, 0.5)))
    assert reports.last() is report and not report.statistics and not report.warnings
    assert kept_meshes._export_count == count and kept.items() <= kept_meshes._kept.items()
    mine = sessions._sessions["preview cpu"]
    assert all(session is not mine for name, session in before.items() if name != "preview cpu")


def test_a_preview_that_is_not_wanted_any_more_ends(scene, monkeypatch):
    rendered = []
    monkeypatch.setattr(sessions.Session, "render", lambda *_args, **options: rendered.append(options["cancelled"]()))
    stopped = types.SimpleNamespace(test_break=lambda: True, is_preview=True)
    with (
        sessions.session_for(preview.PREVIEW_SETTINGS),
        sessions.preview_session(preview.PREVIEW_SETTINGS, stopped.test_break) as own,
    ):
        assert own is None  # who lends the session keeps it, and nobody waits
    preview.render_preview(stopped, bpy.context.evaluated_depsgraph_get())
    assert rendered in ([], [True])


def test_an_error_gets_no_further_than_standard_error(scene, monkeypatch, capsys):
    monkeypatch.setattr(preview, "export_scene", lambda *_args, **_options: 1 / 0)
    preview.render_preview(types.SimpleNamespace(test_break=lambda: False), bpy.context.evaluated_depsgraph_get())
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert not kept_meshes._is_aside


def test_previews_never_wait_for_a_compiler():
    assert (preview.PREVIEW_SETTINGS.device, preview.PREVIEW_SETTINGS.kernel_tier) == ("cpu", "GENERAL")
