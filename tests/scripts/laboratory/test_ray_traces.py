"""Traces of rays: what a recorded one holds, that it is traced again, and that bad files and wrong hits are found."""

import dataclasses
import json
from pathlib import Path

import benchmark
import numpy as np
import pytest
from benchmarking.rays import capture_rays, parse_ray_types, pixel_samples
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from benchmarking.traces import compare, record
from benchmarking.traces.file import FORMAT, HIT_ARRAYS, RAY_ARRAYS, geometry_digest, read_trace
from lib.command import UsageError

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Closure, ClosureKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.stages.work import TileWork
from tests.support import scenes
from tests.support.benchmark_scenes import assert_one_error, save_bowl
from tests.support.command_line import ROOT

KINDS = "primary,bounce1,bounce2,shadow1"
COUNT = 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The bowl, and a scene with instances, each with the trace of a render."""
    made = tmp_path_factory.mktemp("traces")
    save_bowl(made)
    save_scene(made / "mixed.scene.npz", scenes.mixed(scenes.Frame(16, 12)), RenderSettings())
    for name in ("bowl.npz", "mixed.scene.npz"):
        stem = name.partition(".")[0]
        command = [
            "record-rays",
            made / name,
            "--out",
            made / f"{stem}.rays.npz",
            "--hits-of",
            "off",
            "--device",
            "cpu",
        ]
        command += ["--triangles", made / f"{stem}.triangles.npz", "--rays", KINDS, "--ray-count", COUNT]
        assert benchmark.main([str(each) for each in [*command, "--set", "pixel_filter=BOX"]]) == 0
    return made


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def run(*arguments) -> int:
    return benchmark.main([str(each) for each in arguments])


# --- recorded


@pytest.mark.usefixtures("general_kernels")
def test_shadow_rays_of_no_length_are_no_rays_of_a_trace(tmp_path):
    """Of a lamp that reflects, too: some paths that it begins aim at a point of its own triangle."""
    glowing = scenes.material(Closure(ClosureKind.DIFFUSE, (0.8,) * 3), Closure(ClosureKind.EMISSION, (1.0,) * 3))
    lamp = scenes.sphere("lamp", segments=8, rings=5, radius=0.5), scenes.IDENTITY, glowing
    floor = scenes.plane("floor", 4.0), scenes.translation(0, 0, -1), scenes.diffuse()
    made = scenes.scene([lamp, floor], view=scenes.camera(eye=(0, -3, 1)))
    save_scene(tmp_path / "lamp.scene.npz", made, RenderSettings())
    command = ["record-rays", tmp_path / "lamp.scene.npz", "--out", tmp_path / "rays.npz", "--device", "cpu"]
    assert run(*command, "--rays", "shadow1", "--ray-count", 2000) == 0
    trace = read_trace(tmp_path / "rays.npz")  # refuses them
    assert len(trace) == 2000 and trace.arrays["t_max"].min() > 0


def test_a_trace_holds_the_rays_of_a_render_in_their_order(folder):
    scene = load_benchmark_scene(SceneRequest(folder / "bowl.npz"), COUNT)
    trace = read_trace(folder / "bowl.rays.npz")
    assert set(trace.arrays) == {*RAY_ARRAYS, *HIT_ARRAYS}
    assert [each.name for each in trace.types()] == KINDS.split(",") and len(trace) == 4 * COUNT
    settings = scene.settings.replace(pixel_filter="BOX")
    for rays in capture_rays(scene, settings, parse_ray_types(KINDS), COUNT, "cpu"):
        (stored,) = trace.captured([rays.type])
        for name in ("origin", "direction", "t_max", "visibility"):
            assert np.array_equal(getattr(stored, name), getattr(rays, name)), rays.type.name
    header = trace.header
    assert header["scene"]["geometry"] == geometry_digest(scene.scene) and header["scene"]["name"] == "bowl.npz"
    assert header["settings"]["pixel_filter"] == "BOX" and header["hits"] == {"tracer": "RayBatch, off"}
    # rays of one kind are handed over together, and numbers of what is not in the file are left out
    arrays = trace.arrays
    assert (np.diff(arrays["sequence"]) > 0).all() and (np.diff(arrays["wave"]) >= 0).all()
    for wave in np.unique(arrays["wave"]):
        assert len(np.unique(arrays["kind"][arrays["wave"] == wave])) == 1


def test_rays_name_their_pixels_and_samples(folder):
    """A camera ray with a filter that is a box passes through the pixel that it names."""
    trace = read_trace(folder / "bowl.rays.npz")
    scene = load_benchmark_scene(SceneRequest(folder / "bowl.npz"), COUNT).scene
    (rays,) = trace.captured(parse_ray_types("primary"))
    camera, frame = scene.camera, scene.frame
    local = rays.direction.astype(np.float64) @ np.asarray(camera.transform, np.float64)[:, :3]
    place = local[:, :2] / -local[:, 2:]
    left, right, bottom, top = camera.window
    place = (place - [left, bottom]) / [right - left, top - bottom] * [frame.width, frame.height]
    assert np.abs(place - (rays.places.pixel + 0.5)).max() < 0.5 + 1e-3
    pairs = np.column_stack([rays.places.pixel, rays.places.sample])
    assert len(np.unique(pairs, axis=0)) == COUNT and (rays.places.sample == 0).all()
    # a path's later rays name the pixels of its first
    (later,) = trace.captured(parse_ray_types("bounce2"))
    hit = {tuple(each) for each in pairs[trace.hits(rays.type).hit]}
    mine = {tuple(each) for each in np.column_stack([later.places.pixel, later.places.sample]) if each[2] == 0}
    assert mine and mine <= hit


@pytest.mark.parametrize("pixel_first", [0, 1])
def test_every_pixel_and_sample_of_a_tile_has_one_number(pixel_first):
    work = TileWork()
    work.x, work.y, work.width, work.height = 5, 7, 19, 13
    work.sample_first, work.sample_count, work.pixel_first, work.item_base = 2, 3, pixel_first, 10
    pixel, sample = pixel_samples(work, np.arange(19 * 13 * 3 - 10, dtype=np.uint32))
    found = {(*p, s) for p, s in zip(pixel.tolist(), sample.tolist(), strict=True)}
    assert len(found) == 19 * 13 * 3 - 10
    assert found <= {(5 + x, 7 + y, 2 + s) for x in range(19) for y in range(13) for s in range(3)}
    if not pixel_first:  # blocks of 8 x 8, row by row
        assert pixel[: 64 - 10].tolist() == [[5 + i % 8, 7 + i // 8] for i in range(10, 64)]


@pytest.mark.parametrize("name", ["bowl.npz", "mixed.scene.npz"])
def test_hits_name_triangles_on_which_they_lie(folder, name):
    """By the scene's own meshes and instances, and by the triangles that are written beside the trace."""
    stem = name.partition(".")[0]
    rays, triangles = arrays_of(folder / f"{stem}.rays.npz"), arrays_of(folder / f"{stem}.triangles.npz")
    scene = load_benchmark_scene(SceneRequest(folder / name), COUNT).scene
    told = np.isfinite(rays["t"])
    assert (rays["hit"] == told)[rays["kind"] == 0].all() and told.sum() > COUNT / 2
    assert (rays["instance"][~told] == -1).all()
    point = (rays["origin"] + rays["t"][:, None].astype(np.float64) * rays["direction"])[told]
    weights = np.column_stack([1 - rays["u"] - rays["v"], rays["u"], rays["v"]])[told].astype(np.float64)
    assert weights.min() > -1e-3
    corners = []
    for instance, primitive in zip(rays["instance"][told], rays["primitive"][told], strict=True):
        mesh = scene.meshes[scene.instances.mesh[instance]]
        matrix = np.asarray(scene.instances.transform[instance], np.float64)
        corners.append(mesh.positions[mesh.triangles[primitive]].astype(np.float64) @ matrix[:, :3].T + matrix[:, 3])
    assert np.abs((weights[..., None] * np.array(corners)).sum(1) - point).max() < 1e-4

    place = {pair: k for k, pair in enumerate(zip(triangles["instance"], triangles["primitive"], strict=True))}
    assert len(place) == len(triangles["f"]) == sum(len(scene.meshes[i].triangles) for i in scene.instances.mesh)
    rows = [place[pair] for pair in zip(rays["instance"][told], rays["primitive"][told], strict=True)]
    written = triangles["v"][triangles["f"][rows]]
    assert np.abs(written - np.array(corners)).max() < 1e-4
    assert (triangles["visibility"][rows] & rays["visibility"][told]).all()


def test_tracers_that_name_no_triangles_store_distances_alone(folder):
    trace = read_trace(folder / "bowl.rays.npz")
    captured = trace.captured(trace.types())
    hits = [dataclasses.replace(trace.hits(rays.type), instance=None, primitive=None) for rays in captured]
    arrays = record.arrays_of(captured, hits)
    assert set(arrays) == {*RAY_ARRAYS, "hit", "t"}
    assert all(np.array_equal(arrays[name], trace.arrays[name]) for name in arrays)
    assert sum(each[0].nbytes for each in trace.arrays.values()) == 79  # as the page says
    assert sum(trace.arrays[name][0].nbytes for name in RAY_ARRAYS) == 58


# --- traced again, and compared


def test_a_trace_is_checked_and_traced_in_place_of_captured_rays(folder, tmp_path, capfd):
    trace, scene = folder / "bowl.rays.npz", folder / "bowl.npz"
    assert run("check-rays", trace, "--scene", scene) == 0
    said = capfd.readouterr().out
    assert "as it should be" in said and "its geometry is that of the scene" in said and "bounce2" in said
    options = ["--runs", "1", "--device", "cpu", "--orders", "natural", "--no-counters", "--tracers", "off,reference"]
    assert run("traversal", "--scene", scene, "--rays-file", trace, "--ray-count", 300, "--json", *options) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["rays_file"] == "bowl.rays.npz"
    assert [(each["rays"], each["ray_count"]) for each in report["results"][::2]] == [
        (k, 300) for k in KINDS.split(",")
    ]
    assert all(each["faults"] == 0 for each in report["results"])


def test_hits_of_another_tracer_are_judged(folder, tmp_path, capfd):
    trace, scene = folder / "mixed.rays.npz", folder / "mixed.scene.npz"
    arrays = arrays_of(trace)
    header = {"format": FORMAT, "version": 1, "hits": {"tracer": "theirs"}}
    hits = {name: arrays[name].copy() for name in ("hit", "t", "instance", "primitive")}
    where = np.flatnonzero(arrays["hit"] & (arrays["kind"] == 0) & (arrays["bounce"] == 0))
    hits["hit"][where[0]] = False  # missed
    hits["t"][where[1]] *= 0.5  # too near
    hits["primitive"][where[2]] += 1 if arrays["primitive"][where[2]] == 0 else -1

    def save(path: Path) -> Path:
        np.savez(path, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **hits)
        return path

    mine = save(tmp_path / "hits.npz")
    assert run("compare-hits", trace, "--scene", scene, "--hits", mine, "--json", "--device", "cpu") == 0
    report = json.loads(capfd.readouterr().out)
    assert report["hits_of"] == "theirs" and report["own_faults"] == 0
    primary, *others = report["results"]
    assert primary["theirs"] == {"disagreements": 2, "judged": 2, "faults": 2} and primary["ours"]["faults"] == 0
    assert primary["faulty_rays"] == where[:2].tolist()
    assert 1 - 3 / len(where) < primary["same_triangle"] < 1
    assert all(each["theirs"]["disagreements"] == 0 for each in others)
    assert run("compare-hits", trace, "--scene", scene, "--hits", mine, "--device", "cpu") == 0
    assert f"their faults are of the rays {where[0]:,}, {where[1]:,} of the file" in capfd.readouterr().out
    hits["instance"][where[3]] = 10_000
    assert run("compare-hits", trace, "--scene", scene, "--hits", save(tmp_path / "far.npz"), "--device", "cpu") == 1
    assert_one_error(capfd, "array instance names no instance of mixed.scene.npz")


def test_faults_of_our_own_end_with_an_error(folder, monkeypatch, capfd):
    def blind(tracer, rays):
        found = record.traced(tracer, rays)
        return dataclasses.replace(found, hit=np.zeros_like(found.hit))

    monkeypatch.setattr(compare, "traced", blind)
    command = ["compare-hits", folder / "bowl.rays.npz", "--scene", folder / "bowl.npz", "--rays", "primary"]
    assert run(*command, "--device", "cpu", "--tracer", "reference") == 1
    said = capfd.readouterr()
    assert "of RayBatch's own hits are wrong; see the report" in said.err and "faults ours" in said.out


# --- what cannot be


def spoilt(change) -> dict[str, np.ndarray]:
    """Two rays that are as they should be, but for `change`."""
    header = {"format": FORMAT, "version": 1}
    arrays = {
        "origin": np.zeros((2, 3), np.float32),
        "direction": np.tile(np.array([[0, 0, 1]], np.float32), (2, 1)),
        "t_max": np.full(2, np.inf, np.float32),
        "kind": np.zeros(2, np.uint8),
        "bounce": np.zeros(2, np.uint8),
        "visibility": np.ones(2, np.int32),
    }
    change(arrays, header)
    return {"header": np.frombuffer(json.dumps(header).encode(), np.uint8)} | arrays


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda a, h: a.pop("t_max"), "has no array t_max: only hits nearer"),
        (lambda a, h: a.update(origin=a["origin"].astype(float)), "array origin is float64; it must be float32"),
        (lambda a, h: a.update(kind=a["kind"][:1]), r"array kind has the shape \[1\], and it must be \[2\]"),
        (lambda a, h: a["origin"].__setitem__(1, np.nan), r"origin is not finite in 1 of 2 rays \(the first is 1"),
        (lambda a, h: a["direction"].__imul__(1.001), "array direction has not unit length in 2 of 2 rays"),
        (lambda a, h: a["t_max"].__setitem__(0, 0), "array t_max is not above 0"),
        (lambda a, h: a["kind"].__setitem__(0, 2), "array kind is neither 0"),
        (lambda a, h: a["kind"].__setitem__(0, 1), "array bounce is 0, and shadow rays leave a hit"),
        (lambda a, h: a["visibility"].__setitem__(0, 3), "array visibility is not one bit"),
        (lambda a, h: a.update(sequence=np.array([4, 4])), "array sequence does not rise in 1 of 2 rays"),
        (lambda a, h: a.update(hit=np.ones(2, bool), t=a["t_max"]), "array t is not finite and 0 or more where hit"),
        (lambda a, h: h.update(version=2), "version 2, and this RayBatch reads version 1: record it again"),
        (lambda a, h: h.update(format="other"), "its header says format 'other'"),
        (lambda a, h: a.update({n: e[:0] for n, e in a.items()}), "has no rays"),
    ],
)
def test_bad_traces_are_named(tmp_path, change, words):
    path = tmp_path / "bad.npz"
    np.savez(path, **spoilt(change))
    with pytest.raises(UsageError, match=words):
        read_trace(path)


def test_files_that_are_no_traces_are_named(folder, tmp_path, capfd):
    np.savez(tmp_path / "good.npz", **spoilt(lambda arrays, header: None))
    assert len(read_trace(tmp_path / "good.npz")) == 2
    whole = (folder / "bowl.rays.npz").read_bytes()
    (tmp_path / "short.npz").write_bytes(whole[: len(whole) // 2])
    for path, words in (
        (tmp_path / "short.npz", "damaged or cut short"),
        (folder / "bowl.npz", "it has no array header"),
        (tmp_path / "none.npz", "there is no file"),
    ):
        with pytest.raises(UsageError, match=words):
            read_trace(path)
    bowl, mixed = folder / "bowl.npz", folder / "mixed.scene.npz"
    for command, words in (
        (["check-rays", folder / "bowl.rays.npz", "--scene", mixed], "whose geometry is not that of mixed.scene.npz"),
        (["check-rays", folder / "bowl.rays.npz", "--scene", bowl, "--grid", "2"], "with the same --grid"),
        (["check-rays", folder / "bowl.rays.npz", "--grid", "2"], "give --scene too"),
        (["check-rays", folder / "bowl.rays.npz", "--device", "cpu"], "--device has no use for check-rays"),
        (["compare-hits", tmp_path / "good.npz", "--scene", bowl, "--device", "cpu"], "no hits to compare with"),
        (["traversal", "--scene", bowl, "--rays-file", tmp_path / "good.npz", "--rays", "bounce3"], "no rays bounce3"),
        (["record-rays", bowl, "--out", bowl], "is no place for what is recorded"),
        (["record-rays", bowl, "--out", tmp_path / "o.npz", "--hits-of", "of"], "'of' is not known: choose of off"),
    ):
        assert run(*command) == 1
        assert_one_error(capfd, words)
    assert not (tmp_path / "o.npz").exists()


def test_scenes_that_move_are_refused(tmp_path, capfd):
    """A trace has no times of rays."""
    from studies.motion.moving import flying

    save_scene(tmp_path / "flying.scene.npz", flying(2, 4), RenderSettings())
    assert run("record-rays", tmp_path / "flying.scene.npz", "--out", tmp_path / "o.npz", "--device", "cpu") == 1
    assert_one_error(capfd, "flying.scene.npz has rays that traces do not hold: things move")


def test_the_page_describes_every_array():
    page = (ROOT / "docs/ray-traces.md").read_text(encoding="utf-8")
    for name, info in (RAY_ARRAYS | HIT_ARRAYS).items():
        shape = ", ".join(map(str, ("n", *info.parts)))
        assert f"| `{name}` | {info.dtype} | [{shape}] |" in page and info.about in page, name
