"""How many workers there are, how many paths alive, and what is said of it."""

from types import SimpleNamespace

import pytest

from raybatch_addon.core.job import Job
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Method
from raybatch_addon.core.wavefront.render.steps import TileParts
from raybatch_addon.core.wavefront.render.workers import fewer_alive, launches_in_turns
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
        # a GPU may have a second worker where no number is given
        assert statistics["schedule"]["ray_count"] == alive * statistics["schedule"]["workers"]
        assert len(statistics["warnings"]) == (ray_count > alive) and all(
            "ray_count 5000: 128 are alive" in text for text in statistics["warnings"]
        )
    session.close()


def on_cuda(**changes):
    """As much of a scene on a GPU as says whether its workers launch in turns; `changes`: `waits` and `counts`."""
    found = {"waits": False, "counts": None} | changes
    tracing = SimpleNamespace(waits=found["waits"], counters=lambda settings, passes: found["counts"])
    return SimpleNamespace(
        device=SimpleNamespace(is_cuda=True), tracing=tracing, fetches=found.get("fetches"), images=found.get("images")
    )


@pytest.mark.parametrize(
    ("scene", "settings"),
    [
        ({"waits": True}, {}),
        ({"counts": "steps"}, {}),
        ({"fetches": "programs", "images": SimpleNamespace(tiled="tiles")}, {}),
        ({}, {"ray_count": 1 << 20}),
        ({}, {"schedule": "STREAMING"}),
    ],
)
def test_a_gpu_has_two_workers_unless_rays_wait_or_are_counted(scene, settings):
    frame = Frame(32, 32)
    assert launches_in_turns(on_cuda(), frame, RenderSettings())
    assert not launches_in_turns(on_cuda(**scene), frame, RenderSettings(**settings))


def test_tiles_are_rendered_in_parts_by_several_gpus():
    def parts(devices, **changes):
        changes = {"method": Method.UNBATCHED, "fetch_program": None, "sample_order": "FRAME_FIRST"} | changes
        job = SimpleNamespace(
            plan=SimpleNamespace(method=changes["method"]),
            features=SimpleNamespace(fetch_program=changes["fetch_program"]),
            settings=SimpleNamespace(sample_order=changes["sample_order"]),
        )
        return Job.tile_parts(job, [SimpleNamespace(is_cuda=each) for each in devices])

    assert isinstance(parts([True, True]), TileParts)
    assert parts([True]) is parts([False, False]) is parts([True, False]) is None
    for changes in ({"method": Method.PAGED}, {"fetch_program": "program"}, {"sample_order": "PIXEL_FIRST"}):
        assert parts([True, True], **changes) is None
