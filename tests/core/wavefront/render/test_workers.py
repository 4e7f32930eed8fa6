"""Reports of the number of paths alive."""

import pytest

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.render.workers import fewer_alive
from tests.support import scenes


@pytest.mark.parametrize(
    ("ray_count", "workers", "areas", "samples", "reported"),
    [
        (0, 2, [3600] * 4, 1, None),
        (7200, 2, [3600] * 4, 1, None),
        (7201, 2, [3600] * 4, 1, None),  # a worker has 3600
        (100_000, 2, [3600] * 4, 16, None),
        (
            100_000,
            2,
            [3600, 3600, 1800, 1800],
            1,
            "ray_count 100000: 7,200 are alive at most, because a tile of 3,600 pixels has 3,600 at 1 sample, and 2 "
            "tiles are rendered at once; "
            "raise tile_size",
        ),
        (
            9000,
            1,
            [1024] * 3,
            4,
            "ray_count 9000: 4,096 are alive at most, because a tile of 1,024 pixels has 4,096 at 4 samples; raise "
            "tile_size",
        ),
        # there is nothing to be raised
        (
            9000,
            1,
            [1024],
            4,
            "ray_count 9000: 4,096 are alive at most, because the picture's 1,024 pixels have no more at 4 samples",
        ),
        (
            9000,
            2,
            [1024, 500],
            1,
            "ray_count 9000: 1,524 are alive at most, because the picture's 1,524 pixels have no more at 1 sample",
        ),
        (
            9000,
            2,
            [1024] * 2,
            4,
            "ray_count 9000: 8,192 are alive at most, because the picture's 2,048 pixels have no more at 4 samples",
        ),
    ],
)
def test_a_number_of_paths_that_tiles_do_not_have(ray_count, workers, areas, samples, reported):
    assert fewer_alive(ray_count, workers, areas, samples) == reported


def test_a_render_reports_it_once(device):
    session = Session(device)
    scene = scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse())], frame=Frame(32, 32), world=1.0)
    settings = RenderSettings(sample_count=2, tile_size=8, thread_count=1)
    for ray_count, alive in ((0, 128), (128, 128), (5000, 128), (64, 64)):
        statistics = session.render(scene, settings.replace(ray_count=ray_count)).statistics
        assert statistics["schedule"]["ray_count"] == alive
        assert len(statistics["warnings"]) == (ray_count > alive) and all(
            "ray_count 5000: 128 are alive" in text for text in statistics["warnings"]
        )
    session.close()
