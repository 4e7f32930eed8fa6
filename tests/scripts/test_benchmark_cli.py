"""scripts/benchmark.py traversal: what it measures, what it writes, and what it says when it cannot."""

import importlib.util
import json
import re
from pathlib import Path

import benchmark
import numpy as np
import pytest
import warp as wp
from benchmarking import judge as judging
from benchmarking.judge import Judge, Verdict, faults
from benchmarking.orders import ORDERS, ordered, sort_keys
from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types
from benchmarking.scenes import SceneRequest, load_benchmark_scene, repeated
from benchmarking.timing import slices, spread
from benchmarking.tracers.interface import Hits
from benchmarking.traversal import TRACERS

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Closure, ClosureKind
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.benchmark_scenes import assert_one_error, bowl, save_bowl
from tests.support.command_line import HIDE_BPY, run_script
from tests.support.running.shares import each_of

HAS_EMBREE = importlib.util.find_spec("embreex") is not None
TYPES = "primary,bounce1,bounce2,shadow1"
SMALL = ("--device", "cpu", "--ray-count", "500", "--runs", "2", "--rays", TYPES)


@pytest.fixture(scope="module")
def geometry(tmp_path_factory) -> Path:
    """The bowl as a NumPy archive."""
    return save_bowl(tmp_path_factory.mktemp("geometry"))


@pytest.fixture(scope="module")
def bowl_scene(geometry):
    """The bowl with light and camera."""
    return load_benchmark_scene(SceneRequest(geometry), 500)


@pytest.fixture(scope="module")
def captured(bowl_scene) -> dict[str, CapturedRays]:
    """Rays of paths in the bowl."""
    found = capture_rays(bowl_scene, bowl_scene.settings, parse_ray_types(TYPES), 500, "cpu")
    return {rays.type.name: rays for rays in found}


@pytest.fixture(scope="module")
def judge(bowl_scene) -> Judge:
    """All triangles of the bowl."""
    return Judge(bowl_scene.flat, bowl_scene.scene.instances.visibility, wp.get_device("cpu"))


def distance_to_surface(points: np.ndarray) -> np.ndarray:
    """Distance of `points` to the sphere that the bowl is cut from, where its facets are [m]."""
    return 1 - np.linalg.norm(points, axis=1)


# --- rays


def test_rays_are_those_of_paths(captured, bowl_scene):
    for rays in captured.values():
        assert len(rays) == 500
        assert np.abs(np.linalg.norm(rays.direction, axis=1) - 1).max() < 1e-6
        assert (rays.t_max > 0).all() and (rays.visibility > 0).all()
    eye = bowl_scene.scene.camera.transform[:, 3]
    assert np.abs(captured["primary"].origin - eye).max() == 0
    for name in ("bounce1", "bounce2", "shadow1"):
        # facets of the sphere lie up to 1 - cos(half a step) inside of it
        inside = distance_to_surface(captured[name].origin)
        assert inside.min() > -1e-5 and inside.max() < 0.03, name
    towards_sun = captured["shadow1"].direction @ bowl_scene.scene.lights[0].transform[:, 2]
    assert towards_sun.min() > 0.999


def test_the_same_rays_are_captured_again(captured, bowl_scene):
    again = capture_rays(bowl_scene, bowl_scene.settings, parse_ray_types("bounce2,primary"), 500, "cpu")
    assert [rays.type.name for rays in again] == ["bounce2", "primary"]
    assert np.array_equal(again[1].direction, captured["primary"].direction)


def test_orders_hold_the_same_rays(captured):
    rays = captured["bounce1"]
    for order in ORDERS:
        same = ordered(rays, order)
        assert sorted(map(tuple, same.direction)) == sorted(map(tuple, rays.direction))
    assert ordered(rays, "natural") is rays
    keys = sort_keys(ordered(rays, "sorted").origin, ordered(rays, "sorted").direction)
    # keys are taken from the box of the origins, which is the same in any order
    assert (np.diff(keys.astype(np.int64)) >= 0).all()
    assert keys.max() < 2**30


def test_sort_keys_begin_with_the_octant():
    origin = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 0, 1]], np.float32)
    direction = np.array([[1, 1, 1], [1, 1, 1], [1, 1, 1], [1, 1, -1]], np.float32)
    keys = sort_keys(origin, direction)
    assert keys.tolist() == [
        0,
        2**27 - 1,
        sum(1 << (3 * bit) for bit in range(9)),
        4 * 2**27 + sum(4 << (3 * bit) for bit in range(9)),
    ]


def test_a_grid_repeats_the_mesh():
    mesh = bowl()
    grid = repeated(mesh, 3, "z")
    assert len(grid.triangles) == 9 * len(mesh.triangles)
    corners = grid.positions[grid.triangles].reshape(9, -1, 3, 3)
    shift = corners - mesh.positions[mesh.triangles]
    assert np.ptp(shift, axis=(1, 2)).max() < 1e-6  # a copy is moved as a whole
    assert np.unique(np.round(shift[:, 0, 0], 3), axis=0).shape == (9, 3) and (shift[..., 2] == 0).all()
    assert repeated(mesh, 2, "y").positions[:, 1].max() == mesh.positions[:, 1].max()


# --- judgement


def brute_force(rays: CapturedRays, flat) -> np.ndarray:
    """Distances of the closest hits in float64; infinite where there is none."""
    a, b, c = (flat.positions[flat.triangles[:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    best = np.full(len(rays), np.inf)
    for i, (o, d) in enumerate(zip(rays.origin.astype(np.float64), rays.direction.astype(np.float64))):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a - o) * normal).sum(1) / (normal @ d)
        p = o + np.where(np.isfinite(t), t, 0)[:, None] * d
        sides = [(np.cross(y - x, p - x) * normal).sum(1) for x, y in ((a, b), (b, c), (c, a))]
        hit = np.isfinite(t) & (t > 0) & (np.min(sides, 0) >= 0)
        best[i] = t[hit].min(initial=np.inf)
    return best


def test_the_judge_knows_right_from_wrong(captured, bowl_scene, judge):
    for name in ("primary", "bounce1", "shadow1"):
        rays = captured[name]
        truth = brute_force(rays, bowl_scene.flat)
        hit, t = np.isfinite(truth), truth.astype(np.float32)
        before, after = judge.certainties(rays)
        assert not faults(hit, t, before, after).any() and not faults(hit, None, before, after).any()
        # certain but for rays that pass an edge closely
        assert np.mean(np.isfinite(before) == np.isfinite(after)) > 0.99
        sure = np.isfinite(before)
        margin = np.where(sure, before, 0) - np.where(sure, after, 0)
        assert np.median(margin) < 1e-4  # [m], of a scene of 2 m
        assert faults(hit, t + 1.1 * margin, before, after)[sure].all()
        assert faults(hit, t - 1.1 * margin, before, after)[sure].all()
        assert faults(~hit, t, before, after)[sure].all()
        assert faults(~hit, None, before, after)[sure | np.isinf(after)].all()


def test_faults_are_counted_where_tracers_disagree(captured, bowl_scene, judge):
    rays = captured["bounce1"]
    truth = brute_force(rays, bowl_scene.flat)
    right = Hits(np.isfinite(truth), truth.astype(np.float32))
    inside = np.flatnonzero(right.hit)[:3]
    missed, moved = right.hit.copy(), right.t.copy()
    missed[inside[0]] = False
    moved[inside[1]] *= 2
    wrong = Hits(missed, moved)
    verdict = judge.compare(rays, wrong, right)
    assert (verdict.disagreements, verdict.judged, verdict.faults) == (2, 2, 2)
    assert judge.compare(rays, right, wrong).faults == 0
    assert judge.compare(rays, right, right).disagreements == 0


def test_instances_are_judged_in_their_places():
    ball = scenes.sphere(segments=8, rings=4)
    scene = scenes.scene([(ball, scenes.translation(x, 0, 0, 0.5), scenes.diffuse()) for x in (-2, 2)])
    judge = Judge(flatten(scene), scene.instances.visibility, wp.get_device("cpu"))
    origin = np.array([[-2, -5, 0.1], [2, -5, 0.1], [0, -5, 0.1]], np.float32)
    direction = np.tile(np.array([[0.01, 1, 0.02]], np.float32), (3, 1))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ray_type = parse_ray_types("primary")[0]
    before, after = judge.certainties(
        CapturedRays(ray_type, origin, direction, np.full(3, np.inf, np.float32), np.ones(3, np.int32))
    )
    assert np.isfinite(before).tolist() == np.isfinite(after).tolist() == [True, True, False]
    assert before[:2] == pytest.approx([4.6, 4.6], abs=0.1)


def test_of_many_rays_that_differ_some_are_judged_evenly_and_once_for_both(monkeypatch):
    scene = scenes.scene([(scenes.plane(size=40.0), scenes.translation(0, 0, 0), scenes.diffuse())])
    judge, count = Judge(flatten(scene), scene.instances.visibility, wp.get_device("cpu")), 100
    origin = np.column_stack([np.linspace(-9, 9, count), np.zeros(count), np.ones(count)]).astype(np.float32)
    down = np.tile(np.array([[0, 0, -1]], np.float32), (count, 1))
    limits, seen_by = np.full(count, np.inf, np.float32), np.ones(count, np.int32)
    rays = CapturedRays(parse_ray_types("primary")[0], origin, down, limits, seen_by)
    right = Hits(np.ones(count, bool), np.ones(count, np.float32))
    wrong = Hits(np.arange(count) < 50, np.ones(count, np.float32))
    monkeypatch.setitem(judging.PAIRS_MAX, "cpu", 10 * len(scene.meshes[0].triangles))
    asked = []
    monkeypatch.setattr(judge, "certainties", lambda rays: (asked.append(rays), Judge.certainties(judge, rays))[1])
    assert judge.compare_both(rays, wrong, right) == (
        Verdict(50, 10, 10, (50, 55, 60, 66, 71, 77, 82, 88, 93, 99)),
        Verdict(50, 10, 0),
    )
    assert len(asked) == 1 and asked[0].origin[[0, -1], 0].tolist() == origin[[50, 99], 0].tolist()


# --- the command


@pytest.mark.parametrize("tracer", each_of(2, TRACERS))
def test_every_tracer_finds_the_hits_of_a_small_scene(geometry, tracer, capfd):
    if tracer.startswith("embree") and not HAS_EMBREE:
        pytest.skip("embreex is not installed")
    names = ["reference", *([tracer] if tracer != "reference" else [])]
    assert (
        benchmark.main(
            ["traversal", "--scene", str(geometry), "--tracers", ",".join(names), "--threads", "1,2", "--json", *SMALL]
        )
        == 0
    )
    report = json.loads(capfd.readouterr().out)
    assert set(report) == {
        *("device", "versions", "scene", "triangles", "build_s", "bvh_bytes", "budget", "beyond", "trees", "results")
    }
    assert (
        report["triangles"] == len(bowl().triangles)
        and report["device"]["alias"] == "cpu"
        and report["scene"] == "bowl.npz"
    )
    assert list(report["trees"]) == names and report["build_s"] > 0
    results = report["results"]
    cases = {(r["tracer"], r["rays"], r["order"], r["threads"]) for r in results}
    assert len(cases) == len(results) == len(names) * 4 * 3 * 2
    for result in results:
        assert set(result) >= {
            "mrays_per_s",
            "spread",
            "mrays_per_s_without_sort",
            "sort_s",
            "node_steps",
            "triangle_tests",
        }
        assert (
            result["ray_count"] == 500 and result["runs"] == 2 and result["mrays_per_s"] > 0 and result["spread"] >= 0
        )
        assert result["mrays_per_s_without_sort"] >= result["mrays_per_s"]
        assert (result["sort_s"] > 0) == (result["tracer"] == "off-sorted")
        counted = result["tracer"].startswith("off")
        assert all(
            (result[name] is not None and result[name] >= 1) == counted
            for name in ("node_steps", "box_tests", "triangle_tests")
        )
        if result["tracer"] not in ("embree",):  # which is not watertight
            assert result["faults"] == 0


def test_whole_scenes_and_grids_are_measured_and_reported_in_words(geometry, tmp_path, capfd):
    archive = tmp_path / "mixed.scene.npz"
    save_scene(archive, scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    options = [*SMALL, "--tracers", "reference,off", "--orders", "natural", "--no-counters"]
    assert np.array(load_benchmark_scene(SceneRequest(archive), 500).box()) == pytest.approx(
        np.array([[-6, -6, -1], [6, 6, 2.2]]), abs=1e-5
    )
    assert benchmark.main(["traversal", "--scene", str(archive), *options]) == 0
    assert re.search(
        r"^bounce2 +natural +1 +500 +\d+\.\d\d ±\d+ % +\d+\.\d\d ±\d+ % +\d+\.\d\d$", capfd.readouterr().out, re.M
    )
    assert (
        benchmark.main(
            [
                "traversal",
                "--scene",
                str(geometry),
                "--grid",
                "2",
                "--up",
                "z",
                *options,
                "--json",
                str(tmp_path / "r.json"),
            ]
        )
        == 0
    )
    said = capfd.readouterr()
    assert f"bowl.npz 2 x 2, {4 * len(bowl().triangles):,} triangles" in said.out
    assert json.loads((tmp_path / "r.json").read_text())["triangles"] == 4 * len(bowl().triangles)


def test_scenes_without_light_or_material_get_some(tmp_path):
    black = scenes.material(Closure(ClosureKind.EMISSION, (0.0,) * 3), name="black")
    archive = tmp_path / "dark.scene.npz"
    save_scene(archive, scenes.scene([(bowl(), scenes.IDENTITY, black)], frame=scenes.Frame(8, 4)), RenderSettings())
    scene = load_benchmark_scene(SceneRequest(archive), 128).scene
    assert (scene.frame.width, scene.frame.height) == (16, 8)
    assert scene.materials[0].name == "White"
    archive = tmp_path / "unlit.scene.npz"
    save_scene(archive, scenes.scene([(bowl(), scenes.IDENTITY, scenes.diffuse())]), RenderSettings())
    assert len(load_benchmark_scene(SceneRequest(archive), 128).scene.lights) == 1


def test_standard_output_is_json_alone_and_no_blender_is_needed(geometry):
    done = run_script(
        "benchmark.py", "traversal", "--scene", geometry, *SMALL, "--tracers", "reference", "--json", before=HIDE_BPY
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scene"] == "bowl.npz"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", "{folder}/none.npz"], "no file .*none.npz"),
        (["--scene", "{folder}/a.blend"], "a.blend cannot be measured"),
        (
            ["--scene", "{bowl}", "--tracers", "of"],
            "'of' is not known: choose of off, off-plain, off-sorted, reference",
        ),
        (["--scene", "{bowl}", "--rays", "primary,bounce"], "'bounce' is not known: choose of primary"),
        (["--scene", "{bowl}", "--rays", "bounce0"], "'bounce0' is not known"),
        (["--scene", "{bowl}", "--orders", "random"], "'random' is not known: choose of natural, shuffled, sorted"),
        (["--scene", "{bowl}", "--grid", "0"], "must be 1 or more"),
        (["--scene", "{bowl}", "--grid", "100000"], "100000 makes .* triangles, more than"),
        (["--scene", "{bowl}", "--runs", "0"], "--runs 0 is not valid"),
        (["--scene", "{bowl}", "--ray-count", "-4"], "--ray-count -4 is not valid"),
        (["--scene", "{bowl}", "--threads", "two"], "--threads two is not valid"),
        (["--scene", "{bowl}", "--camera", "1,2"], "seven numbers"),
        (["--scene", "{bowl}", "--device", "cuda:99"], "no device 'cuda:99'"),
        (["--scene", "{bowl}", "--preset", "fast"], "no preset is called 'fast'; the presets are PREVIEW"),
        (["--scene", "{bowl}", "--set", "samples=3"], "no setting is called 'samples'"),
        (["--scene", "{bowl}", "--set", "resolution=8x8"], "--ray-count"),
        (["--scene", "{bowl}", "--json", "{bowl}/x.json"], "x.json cannot be written"),
        (
            ["--scene", "{sheet}", "--ray-count", "100", "--rays", "bounce2", "--tracers", "reference"],
            "no rays bounce2",
        ),
    ],
)
def test_errors_of_traversal_are_one_clear_line(geometry, tmp_path, capfd, arguments, message):
    sheet = tmp_path / "sheet.npz"
    np.savez(sheet, v=scenes.plane().positions, f=scenes.plane().triangles)
    given = [argument.format(folder=tmp_path, bowl=geometry, sheet=sheet) for argument in arguments]
    device = [] if "--device" in given else ["--device", "cpu"]
    assert benchmark.main(["traversal", *given, *device]) == 1
    assert_one_error(capfd, message)


def test_embree_that_is_not_installed_is_named(geometry, capfd, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert benchmark.main(["traversal", "--scene", str(geometry), "--device", "cpu", "--tracers", "embree"]) == 1
    assert "pip install 'raybatch[benchmark]'" in capfd.readouterr().err


# --- figures


def test_shares_and_spread():
    assert slices(10, 3) == [slice(0, 3), slice(3, 6), slice(6, 10)]
    assert slices(1, 4) == [slice(0, 1)]
    assert spread([2.0, 1.0, 4.0]) == 1.5
