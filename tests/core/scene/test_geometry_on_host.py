"""Geometry that holds the corners of each triangle, as in host memory, is shaded to the same bits."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device import bulk, locked
from raybatch_addon.core.scene import geometry as scene_geometry
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import host_array, upload_geometry, uploaded
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene import scene_cache
from tests.support import scenes, schedule_scenes
from tests.support.schedule_scenes import living_scene

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.mark.parametrize("made", [scenes.mixed, living_scene])
def test_corners_instead_of_indices_change_no_film(session, monkeypatch, made):
    """Corners are those of triangles, of segments of curves, and of both at several steps."""
    settings = RenderSettings(sample_count=2, bounce_max=4)
    frame = scenes.Frame(24, 18, passes=("Combined", "Normal", "Position", "Depth"))
    scene = replace(made(), frame=frame)
    expected = session.render(scene, settings).passes
    session.close()
    upload, still, seen, corners = scene_cache.upload_geometry, [], [], []

    def remember(flat):
        still.append(flat)
        return with_motion(flat)

    def upload_corners(flat, scene, device, on_host=False, in_place=False):
        behind = with_motion(still[-1], corners=True)
        geometry = upload(behind, scene, device, on_host=True)
        seen.append((geometry.triangles.size, geometry.positions.size - 3 * len(behind.triangles)))
        corners.append(geometry)
        return upload(flat, scene, device)  # trees are built from indices

    monkeypatch.setattr(scene_cache, "with_motion", lambda flat, corners: remember(flat))
    monkeypatch.setattr(scene_cache, "upload_geometry", upload_corners)
    get = scene_cache.SceneCache.get

    def get_corners(self, scene, request, device):
        kept = get(self, scene, request, device)
        kept.geometry = corners[-1]
        return kept

    monkeypatch.setattr(scene_cache.SceneCache, "get", get_corners)
    film = session.render(scene, settings)
    assert seen == [(0, 0)]
    for name, values in expected.items():
        assert np.array_equal(film.passes[name].view(np.int32), values.view(np.int32)), name


@pytest.mark.parametrize("locked_least", [0, 1 << 26])
def test_large_arrays_reach_the_device_whole(locked_least, device, monkeypatch):
    monkeypatch.setattr(locked, "OWN_PAGES_LEAST", locked_least)
    monkeypatch.setattr(scene_geometry, "OWN_PAGES_LEAST", locked_least)
    device = wp.get_device(device)
    values = np.random.default_rng(1).random((100_001, 3), np.float32)
    for each in (values, values[::2], values[:0]):
        found = uploaded(each, wp.vec3, device)
        assert found.device == device and np.array_equal(found.numpy(), each)
        values[0] += 1  # it is a copy
        assert len(each) == 0 or not np.array_equal(found.numpy(), each)
    if device.is_cuda:
        assert np.array_equal(wp.clone(host_array(values, wp.vec3, device)).numpy(), values)


def test_where_no_array_holds_all_corners_there_are_indices(session, device, monkeypatch):
    settings = schedule_scenes.ESTIMATOR.replace(geometry_budget=schedule_scenes.least_budget(device) + 1000)
    made = schedule_scenes.SCENES["mixed"]()
    expected = session.render(made, settings)
    session.close()
    monkeypatch.setattr(scene_geometry, "CORNERS_MOST", 10)
    found = session.render(made, settings)
    assert np.array_equal(found.passes["Combined"].view(np.int32), expected.passes["Combined"].view(np.int32))
    flat = flatten(made)
    geometry = upload_geometry(flat, made, wp.get_device(device), on_host=True)
    assert (geometry.triangles.size, geometry.positions.size) == (len(flat.triangles), len(flat.positions))


def test_slices_of_threads_make_no_difference(device, monkeypatch):
    """To the arrays of a scene of several meshes, and to the corners in host memory."""
    made = scenes.mixed(scenes.Frame(8, 8))
    expected = flatten(made)
    monkeypatch.setattr(bulk, "_SLICE_ROWS", 7)
    found = flatten(made)
    for name in ("positions", "triangles", "corner_normals", "triangle_slot"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    geometry = upload_geometry(found, made, wp.get_device(device), on_host=True)
    corners = geometry.positions if geometry.positions.device.is_cpu else wp.clone(geometry.positions)
    assert np.array_equal(corners.numpy(), expected.positions[expected.triangles.ravel()])
