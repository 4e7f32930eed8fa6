"""What is counted on the device, against the same sums by NumPy."""

import json

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.film.layout import mean_costs
from raybatch_addon.core.measure.counters import (
    BOUNCE_BINS_MAX,
    COST_QUANTITIES,
    LANE_KINDS,
    QUANTITIES,
    RAY_BYTES_READ,
    RAY_BYTES_WRITTEN,
    RAY_KINDS,
    UNAVAILABLE,
    CounterFeatures,
    Counters,
    TreeBytes,
    count_kernel,
    counter_bytes_per_path,
)
from raybatch_addon.core.measure.timing import STAGES
from raybatch_addon.core.rays import NO_RAYS, RayKind, RayList
from tests.support.under_test import DEVICE

PATHS, PIXELS, BOUNCE_MAX = 400, 30, 3
BINS = BOUNCE_MAX + 2


class Work:
    """Paths with random bounces and pixels, and waves of rays with random work."""

    def __init__(self, features, seed=1):
        self.rng = np.random.default_rng(seed)
        self.counters = Counters(features, 2 * PATHS, BOUNCE_MAX, wp.get_device(DEVICE))
        self.cost = self.counters.begin_tile(PIXELS)
        self.sums = np.zeros((len(RAY_KINDS), BINS, len(QUANTITIES)), np.int64)
        self.pixels = {name: np.zeros(PIXELS, np.int64) for name in COST_QUANTITIES}

    def wave(self, kind, count, bound):
        rng, work = self.rng, self.counters.work[kind]
        bounce, pixel = rng.integers(0, 9, PATHS).astype(np.int32), rng.integers(0, PIXELS, PATHS).astype(np.int32)
        slots = rng.permutation(PATHS)[:bound].astype(np.int32)
        did = np.ones((2 * PATHS, len(QUANTITIES)), np.int64)
        did[:, 1:] = rng.integers(0, 2**31, (2 * PATHS, len(QUANTITIES) - 1))
        for column, name in enumerate(QUANTITIES[1:], 1):
            if name in self.counters.features.by_slot:
                getattr(work, name).assign(did[:, column].astype(np.int32))
            else:
                did[:, column] = 0
        rays = slots + PATHS * (kind != RayKind.CLOSEST)
        listed = RayList(wp.array(rays, dtype=int, device=DEVICE), wp.array([count], dtype=int, device=DEVICE), bound)
        arrays = (wp.array(each, dtype=int, device=DEVICE) for each in (bounce, pixel))
        self.counters.add(kind, listed, *arrays, self.cost)
        paths, did = slots[:count], did[rays[:count]]
        np.add.at(self.sums[kind], np.minimum(bounce[paths], BINS - 1), did)
        for name, quantity in COST_QUANTITIES.items():
            np.add.at(self.pixels[name], pixel[paths], did[:, QUANTITIES.index(quantity)])


@pytest.mark.parametrize("batches", [False, True])
@pytest.mark.parametrize(
    "passes", [(), ("Triangle Tests", "Rays"), ("Times Queued", "Treelet Visits"), tuple(COST_QUANTITIES)]
)
def test_sums_by_kind_bounce_and_pixel(passes, batches):
    work = Work(CounterFeatures(True, passes, batches))
    for kind in RayKind:
        for count, bound in ((300, 400), (0, 100), (1, 1)):
            work.wave(kind, count, bound)
    work.counters.add(0, NO_RAYS, None, None, work.cost)
    totals = work.counters.totals()
    assert np.array_equal(totals.by_bounce, work.sums) and totals.quantity("rays").sum() == 903
    cost = work.cost.numpy()
    assert cost.shape == (len(passes), PIXELS)
    for row, name in enumerate(passes):
        assert np.array_equal(cost[row], work.pixels[name]), name


def test_a_tracer_that_does_not_report_its_steps_has_its_rays_counted():
    work = Work(CounterFeatures(False, ("Rays", "Node Steps")))
    work.wave(RayKind.OCCLUSION, 200, 300)
    for each in work.counters.work:
        assert all(getattr(each, name).shape == (0,) for name in QUANTITIES[1:])
    totals = work.counters.totals()
    assert np.array_equal(totals.quantity("rays"), work.sums[..., 0])
    assert np.array_equal(work.cost.numpy(), [work.pixels["Rays"], np.zeros(PIXELS)])
    report = totals.report(TreeBytes(256, 40))
    assert report["rays"]["occlusion"] == work.sums[1, :, 0].tolist()
    assert report["node_steps"] == report["box_tests"] == report["triangle_tests"] == report["bytes"] == UNAVAILABLE


def test_counters_are_made_only_where_they_are_asked_for():
    assert CounterFeatures.choose("OFF", ("Combined", "Depth"), True) is None
    assert CounterFeatures.choose("ON", ("Combined",), False) == CounterFeatures(False, ())
    assert CounterFeatures.choose("OFF", ("Combined", "Rays"), True) == CounterFeatures(True, ("Rays",))
    assert CounterFeatures.choose("ON", ("Combined",), True, True) == CounterFeatures(True, (), True)
    assert not Counters(CounterFeatures(True, ()), 7, 1, wp.get_device(DEVICE)).mixed.queued.size
    assert Counters(CounterFeatures(True, (), True), 7, 1, wp.get_device(DEVICE)).mixed.queued.size == 7
    assert (
        counter_bytes_per_path(CounterFeatures(True, ()), False) == 20
        and counter_bytes_per_path(CounterFeatures(True, (), True), True) == 48
    )
    assert counter_bytes_per_path(None, True) == 0 and counter_bytes_per_path(CounterFeatures(False, ()), True) == 8
    assert counter_bytes_per_path(CounterFeatures(True, ()), True) == 32


def test_what_is_not_counted_is_not_compiled(tmp_path):
    def source(features):
        kernel = count_kernel(features)
        wp.compile_aot_module(kernel.module, device=DEVICE, module_dir=tmp_path)
        texts = [path for path in tmp_path.glob(f"wp_{kernel.module.name}*") if path.suffix in (".cpp", ".cu")]
        return texts[0].read_text()

    passes = tuple(COST_QUANTITIES)
    for features, count in (
        (CounterFeatures(True, passes, True), 11),
        (CounterFeatures(True, passes), 7),
        (CounterFeatures(False, ()), 1),
    ):
        assert source(features).count("= wp::atomic_add(") == count


def test_passes_that_stay_zero():
    reported = {
        features: [name for name in COST_QUANTITIES if features.is_filled(name)]
        for features in (CounterFeatures(False, ()), CounterFeatures(True, ()), CounterFeatures(True, (), True))
    }
    assert list(reported.values()) == [["Rays"], ["Rays", "Node Steps", "Triangle Tests"], list(COST_QUANTITIES)]
    steps, visits = CounterFeatures(False, ("Rays", "Node Steps", "Triangle Tests", "Times Queued")).warnings()
    assert steps.startswith("the passes Node Steps and Triangle Tests stay 0: Warp's own tree does not tell its steps")
    assert (
        visits
        == "the pass Times Queued stays 0: in this render no ray waits at a treelet; set batching to ON to see them"
    )
    assert (
        CounterFeatures(True, ("Rays", "Node Steps")).warnings()
        == CounterFeatures(True, tuple(COST_QUANTITIES), True).warnings()
        == []
    )


def test_kinds_are_numbered_like_those_of_rays():
    assert [kind.name.lower() for kind in RayKind] == list(RAY_KINDS)


def test_the_last_bin_takes_what_is_beyond():
    counters = Counters(CounterFeatures(False, ()), 0, 100_000, wp.get_device(DEVICE))
    assert counters.totals().by_bounce.shape == (3, BOUNCE_BINS_MAX, len(QUANTITIES))


def test_the_report_is_json_and_sums_bytes():
    work = Work(CounterFeatures(True, ()))
    work.wave(RayKind.CLOSEST, 300, 300)
    work.wave(RayKind.OCCLUSION, 100, 100)
    work.counters.work[RayKind.CLOSEST].lanes.assign(np.array([30, 40, 1, 4, 0, 0]))
    with work.counters.timer.stage("trace"):
        pass
    report = work.counters.totals().report(TreeBytes(80, 48), {"cycles": 5})
    assert json.loads(json.dumps(report)) == report
    nodes, triangles = 80 * work.sums[..., 1].sum(), 48 * work.sums[..., 3].sum()
    rays = 400 * RAY_BYTES_READ + 300 * RAY_BYTES_WRITTEN["closest"] + 100 * RAY_BYTES_WRITTEN["occlusion"]
    assert report["bytes"] == {"nodes": nodes, "triangles": triangles, "rays": rays, "total": nodes + triangles + rays}
    assert report["lanes_idle"] == {
        "closest": {"turns": 0.25, "nodes": 0.75},
        **dict.fromkeys(LANE_KINDS[1:], UNAVAILABLE),
    }
    assert report["treelet_visits"]["closest"] == report["queued"]["closest"] == [0] * BINS
    assert list(report["seconds"]) == list(STAGES) and report["hardware"] == {"cycles": 5}


def test_workers_are_added_up():
    one, other = Work(CounterFeatures(True, ()), 1), Work(CounterFeatures(True, ()), 2)
    for work in (one, other):
        work.wave(RayKind.CLOSEST, 300, 300)
        work.counters.work[RayKind.OCCLUSION].lanes.fill_(3)
    totals, others = one.counters.totals(), other.counters.totals()
    totals.seconds["trace"], others.seconds["trace"] = 1.0, 2.0
    both = totals.merge(others)
    assert np.array_equal(both.by_bounce, one.sums + other.sums) and both.steps
    assert both.lanes.tolist() == [[[0, 0]] * 3, [[6, 6]] * 3, [[0, 0]] * 3, [[0, 0]] * 3]
    assert both.seconds["trace"] == 3.0


def test_pictures_of_cost_are_means_over_samples():
    assert mean_costs({"Rays": np.array([6, 5, 0])}, np.array([4, 2, 0]))["Rays"].tolist() == [1.5, 2.5, 0.0]
