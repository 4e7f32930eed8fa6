"""How many workers there are, how many paths alive, and what is said of it."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from raybatch_addon.core.job import Job
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.plan.plan import Method
from raybatch_addon.core.wavefront.render import workers
from raybatch_addon.core.wavefront.render.steps import TileParts, TileSteps
from raybatch_addon.core.wavefront.render.workers import fewer_alive, launches_in_turns
from raybatch_addon.core.wavefront.scheduler import CUDA_RAYS, CUDA_RAYS_MOST
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
        ({}, {"ray_count": 2 * CUDA_RAYS - 1}),
        ({}, {"schedule": "STREAMING"}),
    ],
)
def test_a_gpu_has_two_workers_unless_rays_wait_or_are_counted(scene, settings):
    frame = Frame(32, 32)
    assert launches_in_turns(on_cuda(), frame, RenderSettings())
    assert launches_in_turns(on_cuda(), frame, RenderSettings(ray_count=2 * CUDA_RAYS))
    assert not launches_in_turns(on_cuda(**scene), frame, RenderSettings(**settings))


def test_tiles_are_rendered_in_parts_by_several_gpus():
    def parts(devices, **changes):
        usual = {"method": Method.UNBATCHED, "fetch_program": None, "sample_order": "FRAME_FIRST", "steps": None}
        changes = usual | changes
        job = SimpleNamespace(
            steps=changes["steps"],
            plan=SimpleNamespace(method=changes["method"]),
            features=SimpleNamespace(fetch_program=changes["fetch_program"]),
            settings=SimpleNamespace(sample_order=changes["sample_order"]),
        )
        job._serves_many = lambda device: Job._serves_many(job, device)
        return Job.tile_parts(job, [SimpleNamespace(is_cuda=each) for each in devices])

    assert isinstance(parts([True, True]), TileParts)
    assert parts([True]) is parts([False, False]) is parts([True, False]) is None
    others = {"method": Method.PAGED}, {"fetch_program": "program"}, {"sample_order": "PIXEL_FIRST"}
    for changes in (*others, {"steps": TileSteps()}):
        assert parts([True, True], **changes) is None


def full(monkeypatch, times):
    """The device has no memory for so many integrators; how many were tried."""
    tried, make = [], TileIntegrator.__init__

    def made(self, *inputs):
        tried.append(inputs[3].path_count)
        if len(tried) <= times:
            raise RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'")
        make(self, *inputs)

    monkeypatch.setattr(TileIntegrator, "__init__", made)
    return tried


SCENE = scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse())], frame=Frame(32, 32), world=1.0)


def test_where_memory_runs_out_there_are_fewer_paths(device, monkeypatch):
    tried = full(monkeypatch, 2)
    settings = RenderSettings(sample_count=2, tile_size=32, thread_count=1)
    film = Session(device).render(SCENE, settings)
    assert tried == [2048, 1024, 512] and film.complete
    assert film.statistics["schedule"]["ray_count"] == 512
    assert any("reduced from 2,048 to 512" in text for text in film.statistics["warnings"])


def test_where_memory_runs_out_for_two_workers_there_is_one(device, monkeypatch):
    monkeypatch.setattr(workers, "launches_in_turns", lambda *_: True)
    tried = full(monkeypatch, 2)
    film = Session(device).render(SCENE, RenderSettings(sample_count=2, tile_size=16, thread_count=1))
    assert tried == [512, 256, 128] and film.complete  # one of them has 512 too, and that did not fit
    assert film.statistics["schedule"]["workers"] == 1


def test_other_errors_are_no_want_of_memory(device, monkeypatch):
    tried = []

    def made(self, *_):
        tried.append(1)
        raise RuntimeError("an illegal memory access was encountered")

    monkeypatch.setattr(TileIntegrator, "__init__", made)
    with pytest.raises(RuntimeError, match="illegal memory access"):
        Session(device).render(SCENE, RenderSettings(sample_count=2))
    assert len(tried) == 1


@pytest.mark.parametrize(
    ("free", "expected"),
    [
        (1 << 40, (2, CUDA_RAYS_MOST)),
        (16 * 3 * CUDA_RAYS * 300, (2, 2 * CUDA_RAYS)),
        (16 * CUDA_RAYS * 300, (2, CUDA_RAYS)),
        (16 * CUDA_RAYS * 300 - 16, None),
    ],
)
def test_two_workers_have_what_an_eighth_of_the_memory_holds(monkeypatch, free, expected):
    room = workers._Room(2, CUDA_RAYS, CUDA_RAYS, 300, other_bytes=0, budget=1 << 50, slots=0)
    monkeypatch.setattr(workers, "_room", lambda *_: room)
    monkeypatch.setattr(workers, "free_memory", lambda _: free)
    scene = SimpleNamespace(device=None)
    found = workers._room_in_turns(scene, Frame(8192, 8192), RenderSettings(), [1 << 24] * 4, 64)
    assert (found and (found.workers, found.paths)) == expected
    assert workers._room_in_turns(scene, Frame(8192, 8192), RenderSettings(), [1 << 24], 64) is None, "one tile"
    found = workers._room_in_turns(scene, Frame(8192, 8192), RenderSettings(ray_count=1 << 25), [1 << 24] * 4, 64)
    assert found is room, "as asked for"
    room = replace(room, paths=CUDA_RAYS // 2)
    found = workers._room_in_turns(scene, Frame(8192, 8192), RenderSettings(ray_count=1 << 25), [1 << 24] * 4, 64)
    assert found is None, "few paths are faster together"
