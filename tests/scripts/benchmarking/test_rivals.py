"""Rivals of batching in scripts/benchmark.py traversal: they find the hits of `off`, and say what is wrong with what
they are given.
"""

import dataclasses

import benchmark
import numpy as np
import pytest
import warp as wp
from benchmarking.judge import Judge
from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from benchmarking.tracers.interface import MeasuredTracer
from benchmarking.tracers.rivals.native_stage import octant_orders
from benchmarking.tracers.rivals.registry import RIVALS, make_rivals, parse_rivals
from benchmarking.tracers.rivals.simplified import simplified_mesh
from benchmarking.tracers.stages import SceneTrees, StageTracer
from lib.command import UsageError

from raybatch_addon.core.bvh.node import BOXES_NODE, EMPTY_CHILD
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.benchmark_scenes import assert_one_error, bowl, save_bowl

# Rays are captured in renders whose kernels do not matter
pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
CPU = wp.get_device("cpu")
COUNT = 333  # no multiple of a packet
TYPES = "primary,bounce2,shadow1"
# each rival, with parameters that fit the rays badly
VARIANTS = {
    "packet": ["packet:rays=1", "packet:rays=13", "packet:rays=500"],
    "partition": ["partition:rays=8", "partition:rays=100", "partition:rays=500"],
    "drst": ["drst:rays=7,alone=0", "drst:rays=500", "drst:rays=100,alone=30"],
    "orst": ["orst:rays=7,alone=0", "orst:rays=500", "orst:rays=100,alone=30"],
    "mbvh-rs": ["mbvh-rs:rays=1", "mbvh-rs:rays=500"],
    "hit-point": ["hit-point", "hit-point:cells=2,traversal=plain"],
    "sorted": [
        "sorted:key=origin",
        "sorted:key=origin-direction",
        "sorted:key=direction-origin",
        "sorted:key=two-point,reach=5",
    ],
    "breadth-first": ["breadth-first", "breadth-first:rays=5,origin=0,direction=1"],
    "raycrawler": ["raycrawler:treelet=2,rays=50,queue=7", "raycrawler:storage=indirect"],
}
# whose kernels differ from those of packets by what rays are together
LIKE_PACKETS = ("partition", "drst", "orst", "mbvh-rs")


@dataclasses.dataclass
class Measured:
    """A scene with rays of its paths, and what finds their hits."""

    scene: object
    rays: dict[str, CapturedRays]
    trees: SceneTrees
    off: StageTracer
    judge: Judge


def measured(path, types: str = TYPES) -> Measured:
    """The scene at `path`, with rays of these types."""
    scene = load_benchmark_scene(SceneRequest(path), COUNT)
    rays = capture_rays(scene, scene.settings, parse_ray_types(types), COUNT, "cpu")
    trees = SceneTrees(CPU, RenderSettings())
    off = StageTracer("off", trees, CPU, "OFF")
    off.build(scene)
    return Measured(
        scene,
        {each.type.name: each for each in rays},
        trees,
        off,
        Judge(scene.flat, scene.scene.instances.visibility, CPU),
    )


@pytest.fixture(scope="module")
def geometry(tmp_path_factory):
    """The bowl as a NumPy archive."""
    return save_bowl(tmp_path_factory.mktemp("geometry"))


@pytest.fixture(scope="module")
def known(geometry, tmp_path_factory) -> dict[str, Measured]:
    """One tree in world space, and instances."""
    mixed = tmp_path_factory.mktemp("mixed") / "mixed.scene.npz"
    save_scene(mixed, scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    found = {"bowl": measured(geometry), "mixed": measured(mixed)}
    assert [each.scene.instancing for each in found.values()] == [False, True]
    return found


@pytest.fixture(scope="module")
def doubled(tmp_path_factory) -> Measured:
    """Every triangle of a ball twice, and the ball twice in one place."""
    ball = scenes.sphere(segments=8, rings=4)
    twice = dataclasses.replace(ball, triangles=np.concatenate([ball.triangles, ball.triangles]))
    path = tmp_path_factory.mktemp("doubled") / "doubled.scene.npz"
    save_scene(path, scenes.scene([(twice, scenes.IDENTITY, scenes.diffuse())] * 2), RenderSettings())
    return measured(path, "primary")


def rival(text: str, trees: SceneTrees) -> MeasuredTracer:
    """The rival that the command line would name so."""
    (tracer,) = make_rivals(parse_rivals([text]), trees, CPU, RenderSettings())
    return tracer


def assert_same_hits(case: Measured, tracer: MeasuredTracer, rays: CapturedRays, threads: int = 1) -> None:
    """That `tracer` finds what `off` does."""
    for each in (case.off, tracer):
        each.load(rays, threads)
        assert each.trace().seconds > 0
    right, found = case.off.hits(), tracer.hits()
    # other arithmetic, of triangles and of rays in instances: its roundings are judged
    if tracer.name.startswith("breadth-first"):
        verdict = case.judge.compare(rays, found, right)
        assert verdict.judged == verdict.disagreements and verdict.faults == 0
        return
    assert np.array_equal(found.hit, right.hit), tracer.name
    if right.t is not None:
        assert np.array_equal(found.t, right.t), tracer.name


def test_every_rival_is_tested():
    assert set(VARIANTS) == set(RIVALS)


@pytest.mark.parametrize("name", VARIANTS)
def test_rivals_find_the_hits_of_off(known, name, pytestconfig):
    cases = known.values()
    if name in LIKE_PACKETS and not pytestconfig.option.thorough:  # one tree is traced by packets in any run
        cases = [known["mixed"]]
    for text in VARIANTS[name]:
        for case in cases:
            tracer = rival(text, case.trees)
            assert tracer.name == text
            tracer.build(case.scene)
            for rays in case.rays.values():
                assert_same_hits(case, tracer, rays)
                assert_same_hits(case, tracer, rays.taken(np.arange(1)))
            if name != "raycrawler":
                assert_same_hits(case, tracer, case.rays["bounce2"], threads=3)


@pytest.mark.parametrize("name", VARIANTS)
def test_of_equal_hits_the_lowest_counts(doubled, name):
    tracer = rival(name, doubled.trees)
    tracer.build(doubled.scene)
    for each in (doubled.off, tracer):
        each.load(doubled.rays["primary"], 1)
        each.trace()
    hit = doubled.off.hits().hit
    assert hit.any()
    for array in ("hit_instance", "hit_primitive"):
        right, found = (getattr(each._rays, array).numpy()[hit] for each in (doubled.off, tracer))
        assert np.array_equal(found, right), array
    assert (right < doubled.scene.triangle_count // 4).all()


def test_rays_that_cannot_be_traced_miss(known):
    case = known["bowl"]
    rays = case.rays["primary"].taken(np.arange(20))
    rays.origin[3], rays.direction[5], rays.direction[7] = np.nan, 0, np.inf
    rays.t_max[9], rays.t_max[11] = 0, np.nan
    for name in ("packet", "partition", "drst", "orst", "mbvh-rs"):
        tracer = rival(name, case.trees)
        tracer.build(case.scene)
        assert_same_hits(case, tracer, rays)


def test_work_is_counted(known):
    case = known["bowl"]
    tracer = rival("mbvh-rs:rays=500", case.trees)
    tracer.build(case.scene)
    tracer.load(case.rays["primary"], 1)
    tracer.trace()
    work = tracer.work()
    assert 0 < work["nodes_read"] < work["node_steps"]


def test_children_are_ordered_by_octant():
    node = np.zeros(1, BOXES_NODE)
    node["planes"][:, :, 0], node["planes"][:, :, 1] = np.inf, -np.inf
    node["child"] = EMPTY_CHILD
    for slot, x in ((2, 5.0), (4, -5.0)):
        node["planes"][0, :, :, slot] = np.array([[x, x + 1], [0, 1], [0, 1]])
        node["child"][0, slot] = slot
    orders = octant_orders(node.view(np.float32))
    assert orders.shape == (1, 8)
    for octant in range(8):
        assert [int(orders[0, octant]) >> (4 * k) & 7 for k in range(2)] == ([2, 4] if octant & 1 else [4, 2])
        assert sorted(int(orders[0, octant]) >> (4 * k) & 15 for k in range(8)) == list(range(8))


def test_simplified_meshes_are_small_and_near():
    mesh = bowl()
    simple = simplified_mesh(mesh, 6)
    assert 0 < len(simple.triangles) < len(mesh.triangles) / 2
    assert (simple.positions.min(0) >= mesh.positions.min(0)).all()
    assert (simple.positions.max(0) <= mesh.positions.max(0)).all()
    assert simplified_mesh(scenes.plane(), 4096).triangles.shape == scenes.plane().triangles.shape
    one = dataclasses.replace(mesh, positions=mesh.positions * 0)
    assert simplified_mesh(one, 6) is one


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pocket", "--rival 'pocket' is not known: choose of packet, partition, drst"),
        ("packet:ray=3", "--rival packet:ray is not known: packet has rays"),
        ("packet:rays", "--rival packet:rays has no value: write rays=VALUE"),
        ("packet:rays=", "has no value"),
        ("packet:rays=0", "--rival packet:rays=0 is not valid: give a whole number from 1 to 16,384"),
        ("drst:rays=many", "rays=many is not valid"),
        ("drst:rays=5,rays=6", "--rival drst:rays is given twice"),
        ("sorted:key=hash", "--rival sorted:key=hash is not known: choose of origin, origin-direction"),
    ],
)
def test_errors_of_rivals_are_one_clear_line(geometry, capfd, text, message):
    assert benchmark.main(["traversal", "--device", "cpu", "--scene", str(geometry), "--rival", text]) == 1
    assert_one_error(capfd, message)


def test_rivals_that_a_gpu_cannot_run_are_named(known):
    with pytest.raises(UsageError, match="orst runs on the CPU alone"):
        make_rivals(parse_rivals(["sorted", "orst"]), known["bowl"].trees, _Cuda(), RenderSettings())


class _Cuda:
    """As far as is asked."""

    is_cuda = True
