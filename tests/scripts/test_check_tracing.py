"""scripts/check_tracing.py: it finds nothing wrong where nothing is, and what is wrong where something is."""

import json
import re
from pathlib import Path

import check_tracing
import checking.check as check_module
import numpy as np
import pytest
import warp as wp
from benchmarking.judge import Judge, certainty
from benchmarking.rays import CapturedRays, RayType
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from checking import leaks
from checking.judging import BlockJudge
from checking.leaks import bumpy_ball, is_closed
from checking.placing import with_instances
from checking.rays import KINDS, PATTERN, kinds_of, make_rays_kernel, make_source
from checking.trees import TREES, aligned_vectors

from raybatch_addon.core.bvh.node import BOXES_NODE
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.wavefront.rays import allocate_rays
from tests.support import scenes

SMALL = ("--device", "cpu", "--rays", "4800", "--leak-rays", "2000")


@pytest.fixture(scope="module")
def geometry(tmp_path_factory) -> Path:
    """A sphere with a floor, not closed."""
    ball, floor = scenes.sphere(segments=24, rings=12), scenes.plane()
    path = tmp_path_factory.mktemp("geometry") / "ball.npz"
    positions = np.concatenate([ball.positions, floor.positions - np.float32([0, 0, 1])])
    np.savez(path, v=positions, f=np.concatenate([ball.triangles, floor.triangles + len(ball.positions)]))
    return path


@pytest.fixture(autouse=True)
def small_balls(monkeypatch):
    """Closed balls of 3,600 triangles instead of 102,000, whose trees take half a minute on a CPU."""
    monkeypatch.setattr(leaks, "BALL_RINGS", 30)


def made_rays(positions, triangles, count: int) -> Rays:
    source = make_source(positions, triangles, 1, wp.get_device("cpu"))
    rays = allocate_rays(count, wp.get_device("cpu"))
    pattern = wp.array(PATTERN, dtype=int, device="cpu")
    wp.launch(make_rays_kernel, count, [source, pattern, 0, rays], device="cpu")
    return rays


def run(capfd, *arguments) -> tuple[int, dict]:
    code = check_tracing.main([*map(str, arguments), "--json"])
    return code, json.loads(capfd.readouterr().out)


@pytest.mark.parametrize("instances", [0, 5])
def test_all_trees_of_a_small_scene_are_right(geometry, capfd, instances):
    code, report = run(capfd, "--scene", geometry, *SMALL, "--trees", ",".join(TREES), "--instances", instances)
    assert code == 0 and report["own_faults"] == 0 and report["instances"] == instances
    assert set(report["kinds"]) == set(KINDS) and sum(kind["rays"] for kind in report["kinds"].values()) == 4800
    assert all(kind["hits"] > 0 for kind in report["kinds"].values())
    for name in list(TREES)[1:]:
        assert report["checks"][f"tree {name}"] == {"rays": 4800, "failures": 0, "examples": []}
    assert report["checks"]["every triangle tested"]["rays"] == 4800 and report["leaks"]["rays"] == 2001
    assert report["leaks"]["escapes"] == 0


def test_the_report_in_words(geometry, capfd):
    assert check_tracing.main(["--scene", str(geometry), *SMALL, "--trees", "sah,quantised"]) == 0
    out = capfd.readouterr().out
    assert "own faults: 0" in out and "tree quantised" in out and "bumpy ball" in out


def test_a_lost_box_is_found(geometry, capfd, monkeypatch):
    """The second child of each node ends at its middle."""
    build = check_module.build_tracer

    def broken(name, *arguments):
        tracer = build(name, *arguments)
        if name == "splits":
            words = tracer.tree.nodes.numpy().copy()
            planes = words.reshape(-1).view(BOXES_NODE)["planes"]
            planes[:, 0, 1, 1] = (planes[:, 0, 0, 1] + planes[:, 0, 1, 1]) / 2
            tracer.tree.nodes = aligned_vectors(words, wp.get_device("cpu"))
        return tracer

    monkeypatch.setattr(check_module, "build_tracer", broken)
    code, report = run(capfd, "--scene", geometry, *SMALL, "--trees", "sah,splits")
    assert code == 1 and report["own_faults"] > 0 and report["checks"]["tree splits"]["failures"] > 0
    code, report = run(capfd, "--scene", geometry, *SMALL, "--trees", "splits")
    assert code == 1
    for name in ("every triangle tested", "judged in float64"):
        assert report["checks"][name]["failures"] > 0 and report["checks"][name]["examples"]
    assert report["leaks"]["escapes"] == 0  # that scene's trees are made apart


@pytest.mark.parametrize("instances", [0, 6])
def test_the_judge_of_many_rays_agrees_with_the_judge_of_few(geometry, instances):
    device, count = wp.get_device("cpu"), 600
    scene = load_benchmark_scene(SceneRequest(geometry), 1)
    scene = with_instances(scene, instances, 3) if instances else scene
    many, few = BlockJudge(scene, device), Judge(scene.flat, scene.scene.instances.visibility, device)
    many.bound.factor = 0.0
    few._instances = False  # its bound for instances is another one
    rays = made_rays(many.positions, many.triangles, count)
    captured = CapturedRays(
        RayType("any", False, 0),
        *(getattr(rays, name).numpy() for name in ("origin", "direction", "t_max", "visibility")),
    )
    for mine, theirs in zip(many.certainties(rays, np.arange(count)), few.certainties(captured), strict=True):
        finite = np.isfinite(theirs)
        assert np.array_equal(np.isfinite(mine), finite)
        np.testing.assert_allclose(mine[finite], theirs[finite], rtol=1e-6)


def certainties(corners, directions) -> np.ndarray:
    """What the judge knows of triangles, float64 [n, 3, 3], relative to the origins of rays along `directions`, [n,
    3].
    """

    @wp.kernel(**KERNEL_OPTIONS)
    def ask(corner: wp.array2d(dtype=wp.vec3d), direction: wp.array(dtype=wp.vec3d), out: wp.array2d(dtype=wp.float64)):
        i = wp.tid()
        found = certainty(
            corner[i, 0], corner[i, 1], corner[i, 2], wp.normalize(direction[i]), wp.float64(wp.inf), wp.float64(0.0)
        )
        out[i, 0] = found.hit_before
        out[i, 1] = found.hit_after

    out = wp.zeros((len(corners), 2), dtype=wp.float64, device="cpu")
    inputs = [wp.array(corners, dtype=wp.vec3d, device="cpu"), wp.array(directions, dtype=wp.vec3d, device="cpu"), out]
    wp.launch(ask, len(corners), inputs, device="cpu")
    return out.numpy()


def test_a_ray_in_the_plane_of_a_triangle_is_no_certain_hit():
    """In float64 all three volumes are noise there; they had the same sign, and the triangle counted as met."""
    corner = [[10.6005859375, 0.74102783203125, 16.3701171875], [0, 0, 32.72998046875], [0, 0, 16.3701171875]]
    assert np.isinf(
        certainties(np.array([corner]), np.array([[-10.6005859375, -0.74102783203125, 8.34033203125]]))
    ).all()


def test_small_triangles_beside_a_ray_from_afar_are_missed():
    """Volumes taken from the origin are noise in float64 there."""
    generator = np.random.default_rng(4)
    direction = generator.normal(size=(1000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction, generator.normal(size=(1000, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    corners = (1.5e4 * direction + 0.3 * side)[:, None] + 1e-7 * generator.normal(size=(1000, 3, 3))
    assert np.isinf(certainties(corners, direction)).all()
    assert np.isfinite(certainties(corners - 0.3 * side[:, None], direction)[:, 1]).all()


def test_rays_are_of_every_kind():
    ball = scenes.sphere()
    rays = made_rays(ball.positions, ball.triangles, 9600)
    kinds = kinds_of(0, 9600)
    origin, direction, t_max = rays.origin.numpy(), rays.direction.numpy(), rays.t_max.numpy()
    assert (
        np.isfinite(origin).all()
        and np.isfinite(direction).all()
        and (np.abs(direction).max(1) > 0).all()
        and (t_max > 0).all()
    )
    assert set(kinds.tolist()) == set(range(len(KINDS)))
    parallel = direction[kinds == KINDS.index("axis-parallel")]
    assert (parallel == 0).any(1).all() and np.signbit(parallel[parallel == 0]).any()
    assert (np.linalg.norm(origin[kinds == KINDS.index("from afar")], axis=1) > 1e3).all()
    tiny = np.abs(direction[kinds == KINDS.index("tiny components")])
    assert ((tiny > 0) & (tiny < 2.0**-126)).any()
    length = np.linalg.norm(direction[kinds == KINDS.index("any length")].astype(np.float64), axis=1)
    assert length.min() < 1e-4 and length.max() > 1e4
    assert 0.5 < np.isinf(t_max).mean() < 0.9


def test_closed_meshes_are_known():
    ball = bumpy_ball(1, rings=12)
    assert is_closed(ball.positions, ball.triangles) and is_closed(scenes.box().positions, scenes.box().triangles)
    assert not is_closed(ball.positions, ball.triangles[1:]) and not is_closed(
        scenes.plane().positions, scenes.plane().triangles
    )
    turned = ball.triangles.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(ball.positions, turned)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--trees", "oak"), "'oak'.*sah"),
        (("--rays", "some"), "--rays some"),
        (("--rays", "0"), "--rays 0"),
        (("--instances", "-1"), "0 to 1000"),
    ],
)
def test_errors_are_one_clear_line(geometry, capfd, arguments, message):
    assert check_tracing.main(["--scene", str(geometry), "--device", "cpu", *arguments]) == 1
    captured = capfd.readouterr()
    assert captured.out == "" and re.search(message, captured.err) and captured.err.count("\n") == 1
