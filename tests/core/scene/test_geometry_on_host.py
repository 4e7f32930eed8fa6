"""Geometry that holds the corners of each triangle, as in host memory, is shaded to the same bits."""

import numpy as np

from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene import scene_cache
from tests.support import scenes


def test_corners_instead_of_indices_change_no_film(session, monkeypatch):
    settings = RenderSettings(sample_count=2, bounce_max=4)
    frame = scenes.Frame(24, 18, passes=("Combined", "Normal", "Position", "Depth"))
    expected = session.render(scenes.mixed(frame), settings).passes
    session.close()
    upload, seen, corners = scene_cache.upload_geometry, [], []

    def upload_corners(flat, scene, device, on_host=False):
        geometry = upload(flat, scene, device, on_host=True)
        seen.append((geometry.triangles.size, geometry.positions.size - 3 * len(flat.triangles)))
        corners.append(geometry)
        return upload(flat, scene, device)  # trees are built from indices

    monkeypatch.setattr(scene_cache, "upload_geometry", upload_corners)
    get = scene_cache.SceneCache.get

    def get_corners(self, scene, request, device):
        kept = get(self, scene, request, device)
        kept.geometry = corners[-1]
        return kept

    monkeypatch.setattr(scene_cache.SceneCache, "get", get_corners)
    film = session.render(scenes.mixed(frame), settings)
    assert seen == [(0, 0)]
    for name, values in expected.items():
        assert np.array_equal(film.passes[name].view(np.int32), values.view(np.int32)), name
