"""Studies: their registry, what the thesis's combinations become, rows that are resumed, pages, and bad input."""

import itertools
import json
import math
from pathlib import Path

import pytest
from lib.command import UsageError
from studies import pages, rows, runner, scenes
from studies.adaptive import bias
from studies.curves import points_of, slope_of
from studies.registry import STUDIES, study_named
from studies.study import Case, Options, Study, groups_of, part_of
from studies.thesis import results
from studies.thesis.cases import PARAMETERS, initial_cases, settings_of
from studies.thesis.cases import cases as thesis_cases

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import under_test
from tests.support.command_line import error_line, run_script
from tests.support.scripts_here import call_script


def test_ticks_are_plain_numbers_that_do_not_touch():
    pytest.importorskip("matplotlib")
    from converging.ticks import tick_text, ticks

    assert [tick_text(tick) for tick in ticks(0.02, 0.6, 0.1)] == ["0.02", "0.03", "0.05", "0.1", "0.2", "0.3", "0.5"]
    assert [tick_text(tick) for tick in ticks(1, 2.6, 0.08)] == ["1", "1.2", "1.5", "2", "2.5"]
    assert [tick_text(tick) for tick in ticks(1e-4, 1e6, 0.2)] == ["10$^{-4}$", "0.01", "1", "100", "10000", "10$^{6}$"]
    for low, high, room in ((1e-30, 1e30, 0.07), (0.9, 70, 0.1), (3, 3.1, 0.1), (1e-6, 2e-6, 0.1)):
        places = [math.log10(tick / low) / math.log10(high / low) for tick in ticks(low, high, room)]
        assert all(-1e-6 <= place <= 1 + 1e-6 for place in places)
        assert all(b - a >= room - 1e-6 for a, b in itertools.pairwise(places))


def test_more_rays_than_the_tiles_have_are_reported():
    def report(*alive):
        rows = [
            {"table": "ray_count", "ray_count": 2**n, "rays_alive": each}
            for n, each in zip((8, 16, 20), alive, strict=True)
        ]
        return {"device_kind": "cpu", "rows": [*rows, {"table": "control"}]}

    assert results.most_alive(report(2**8, 2**16, 2**20)) is None
    assert results.most_alive(report(2**8, 2**16, 2**16)) == 2**16


PAGES = Path(__file__).resolve().parents[2] / "docs/studies"
DEVICE = {"alias": "cpu", "name": "CPU", "memory": 1, "cores": 2}


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("is_cuda", [False, True])
def test_cases_are_distinct_and_split_into_parts_by_whole_groups(name, quick, is_cuda):
    cases = STUDIES[name].cases(Options(quick=quick, is_cuda=is_cuda))
    assert cases and len({case.key for case in cases}) == len(cases)
    parts = [part_of(cases, k, 3) for k in (1, 2, 3)]
    assert sorted(case.key for part in parts for case in part) == sorted(case.key for case in cases)
    for part in parts:
        for group, mine in groups_of(part).items():
            assert mine == groups_of(cases)[group]
    json.dumps([case.what for case in cases])


def test_the_96_combinations_of_the_thesis_are_valid_distinct_settings_that_it_has_figures_of():
    initial = initial_cases()
    assert len(initial) == 96
    settings = {
        (case.what["scene"], settings_of({n: case.what[n] for n in PARAMETERS if n in case.what})) for case in initial
    }
    assert len(settings) == 96
    tables = results.figures()
    assert {results.key_of(case.what, results.COLUMNS["initial"]) for case in initial} == {
        results.key_of(r, results.COLUMNS["initial"]) for r in tables["initial"]["rows"]
    }
    for name, count in (("ray_count", 28), ("queue_size", 28)):
        ours = {
            results.key_of(c.what, results.COLUMNS[name]) for c in thesis_cases(Options()) if c.what["table"] == name
        }
        assert ours == {results.key_of(r, results.COLUMNS[name]) for r in tables[name]["rows"]} and len(ours) == count
    some = settings_of({"sample_order": "PIXEL_FIRST", "ray_storage": "DIRECT", "treelet_size": 200, "ray_count": 1024})
    assert (
        some.batching,
        some.bucket_selection,
        some.register_cap,
        some.warp_count,
        some.bounce_max,
        some.sample_count,
    ) == ("ON", "MOST_FULL", 64, 0, 7, 2)


def test_settings_of_light_sampling_exist():
    from studies.light_sampling import VARIANTS

    assert len({RenderSettings(**change) for change in VARIANTS.values()}) == 3
    with pytest.raises(SettingsError):
        RenderSettings(mis="SOMETIMES")


class NotedBench:
    """Renders nothing, and notes what it was to render."""

    def __init__(self, options):
        self.options, self.geometry_bytes, self.noted = options, None, []

    def scene(self, key, make):
        return scenes.plates(8, 8)

    def timed(self, scene, settings, warm=None, cap=None):
        self.noted.append(settings)
        return {"tree_bytes": 1000}

    def curve(self, scene, settings, reference, warm=None):
        self.noted.append(settings)
        return {}

    def compared(self, scene, settings, reference, warm=None):
        return self.timed(scene, settings)

    def reference(self, key, scene, settings, samples):
        self.noted.append(settings)


# Studies that measure other things than errors of renders, or do so by others
NOT_RENDERED = ("cycles", "textures", "trees-over-time", "many-workers", "hardware", "top-level", "schedulers")


@pytest.mark.parametrize("name", [name for name in STUDIES if name not in NOT_RENDERED])
@pytest.mark.parametrize("is_cuda", [False, True])
def test_no_render_of_a_study_clamps_light_or_ends_by_itself(name, is_cuda, monkeypatch):
    """Errors are compared, and references are what a picture should be: nothing but noise may be in either."""
    monkeypatch.setattr(bias, "PICTURES", 2)  # that are simulated, not rendered
    bench = NotedBench(Options(is_cuda=is_cuda))
    for case in STUDIES[name].cases(bench.options):
        STUDIES[name].measure(case, 0, bench)
    assert len(bench.noted) >= len(STUDIES[name].cases(bench.options))
    for settings in bench.noted:
        assert settings.clamp_direct == settings.clamp_indirect == settings.time_limit == settings.error_target == 0


def test_textures_are_compared_without_clamping():
    from studies.images.textures import VARIANTS, settings_of

    for settings in (each for variant in VARIANTS for each in settings_of(variant)):
        assert settings.clamp_direct == settings.clamp_indirect == settings.time_limit == settings.error_target == 0


def test_cycles_is_compared_at_equal_error(monkeypatch, tmp_path):
    """`--equal-error` is what takes a file's clamping away (tests/blender/benchmarks/test_benchmark_blend.py)."""
    from studies import cycles

    ran = []
    reported = {
        "raybatch": {"seconds": 1.0},
        "cycles": {},
        "triangles": 1,
        "rays": {"total": 1},
        "invalid_samples": 0,
        "equal_error": {},
    }
    monkeypatch.setattr(cycles, "blend_of", lambda name, options: tmp_path / name)
    monkeypatch.setattr(cycles, "_run", lambda command: ran.append(command) or json.dumps(reported))
    for case in cycles.cases(Options()):
        cycles.measure(case, 0, NotedBench(Options()))
    assert len(ran) == 5 and all("--equal-error" in command and "--set" not in command for command in ran)


# --- runs


def counting_study(seen, fails_at=None):
    """A study that renders nothing."""

    def measure(case, turn, bench):
        if (case.key, turn) == fails_at:
            raise KeyboardInterrupt
        seen.append((case.key, turn))
        return {"seconds": 1.0 + turn, "complete": True, "share": 1.0, "film": "same"}

    cases = [Case("a", "one", {"n": 1}), Case("b", "one", {"n": 2}), Case("c", "two", {"n": 3})]
    return Study(
        "counting",
        "a test",
        lambda options: cases,
        measure,
        lambda reports: f"{len(reports)} report",
        lambda reports, folder: None,
    ), cases


@pytest.fixture(autouse=True)
def no_device(monkeypatch):
    class NoBench:
        def __init__(self, options):
            pass

        def close(self):
            pass

    monkeypatch.setattr(runner, "Bench", NoBench)


def test_turns_are_interleaved_and_a_study_cut_short_goes_on(tmp_path):
    seen = []
    study, cases = counting_study(seen, fails_at=("b", 1))
    options, header = Options(), runner.header_of(STUDIES["budgets"], Options(), DEVICE) | {"study": "counting"}
    path = runner.rows_path(tmp_path, study, "cpu", None)
    with pytest.raises(KeyboardInterrupt):
        runner.measure(study, cases, 2, rows.RowFile(path, header), options)
    assert seen == [("a", 0), ("b", 0), ("a", 1)]
    with path.open("a") as file:
        file.write('{"case": "b", "tu')  # as a machine that was taken away leaves it
    study, cases = counting_study(seen)
    file = rows.RowFile(path, header)
    assert not runner.measure(study, cases, 2, file, options, seconds=0.0)
    assert runner.measure(study, cases, 2, file, options)
    assert seen == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("c", 0), ("c", 1)]
    assert runner.measure(study, cases, 2, rows.RowFile(path, header), options) and len(seen) == 6

    report_path = runner.publish(study, [path], tmp_path)
    report = json.loads(report_path.read_text())
    assert report["study"] == "counting" and len(report["rows"]) == 6
    assert f"(core {report['rows'][0]['core']}), Warp" in pages.machine(report), "by what code rows were measured"
    assert (
        rows.medians(report["rows"]) == {"a": 1.5, "b": 1.5, "c": 1.5}
        and rows.differing_films(report["rows"], ("device",)) == []
    )
    page = runner.write_page(study, tmp_path)
    assert "1 report" in page.read_text()


def test_slopes_are_judged_anew_where_a_page_is_made(tmp_path):
    name = "sequences-cuda.json"
    data = PAGES / runner.DATA
    report = rows.read_report(data / name)
    wanted = json.dumps(report["rows"])
    for row in report["rows"]:
        row["slope"]["says"] = "what an earlier state said"
    rows.write_report(tmp_path / runner.DATA / name, report)
    runner.write_page(STUDIES["sequences"], tmp_path, plots=False)
    assert json.dumps(rows.read_report(tmp_path / runner.DATA / name)["rows"]) == wanted
    assert (tmp_path / runner.DATA / name).read_bytes() == (data / name).read_bytes()


def test_published_slopes_are_judged_as_their_points_are_now():
    judged = 0
    for path in sorted((PAGES / runner.DATA).glob("*-c*.json")):
        for row in rows.read_report(path)["rows"]:
            if row.get("slope") and row.get("points"):
                now = slope_of(points_of(row))
                assert (now["says"], now["flattens"]) == (row["slope"]["says"], row["slope"]["flattens"]), (
                    f"{path.name}, {row['case']}: scripts/study.py {path.stem.rpartition('-')[0]} --draw judges it anew"
                )
                judged += 1
    assert judged > 100


def test_rows_of_another_kind_are_refused(tmp_path):
    header = {
        "study": "a",
        "device_kind": "cpu",
        "quick": False,
        "device": DEVICE,
        "versions": {"raybatch": "1", "warp": "1.19"},
    }
    rows.RowFile(tmp_path / "a.jsonl", header).add({"case": "x", "turn": 0})
    rows.RowFile(tmp_path / "b.jsonl", header | {"quick": True}).add({"case": "x", "turn": 0})
    with pytest.raises(UsageError, match="quick.*--fresh"):
        rows.RowFile(tmp_path / "a.jsonl", header | {"quick": True})
    with pytest.raises(UsageError, match="device = 'CPU', and this is 'H200'"):
        rows.RowFile(tmp_path / "a.jsonl", header | {"device": DEVICE | {"name": "H200"}})
    with pytest.raises(UsageError, match="warp = '1.19'"):
        rows.RowFile(tmp_path / "a.jsonl", header | {"versions": {"raybatch": "1", "warp": "1.20"}})
    with pytest.raises(UsageError, match="do not go together"):
        rows.gathered([tmp_path / "a.jsonl", tmp_path / "b.jsonl"])
    (tmp_path / "c.jsonl").write_text("no rows\n")
    with pytest.raises(UsageError, match="damaged"):
        rows.read_rows(tmp_path / "c.jsonl")
    assert len(rows.gathered([tmp_path / "a.jsonl"] * 2)["rows"]) == 1
    rows.write_report(tmp_path / "a.json", rows.gathered([tmp_path / "a.jsonl"]))
    assert rows.read_report(tmp_path / "a.json")["rows"] == [{"case": "x", "turn": 0}]
    for text in ("", "[]", "{}", (tmp_path / "a.json").read_text()[:90]):
        (tmp_path / "b.json").write_text(text)
        with pytest.raises(UsageError, match="no figures of a study"):
            rows.read_report(tmp_path / "b.json")


@pytest.mark.usefixtures("general_kernels")
def test_a_bench_measures_renders(tmp_path):
    """What rows hold, against the session's own statistics; references are kept."""
    from studies.bench import Bench, row_of, whole_seconds

    bench = Bench(Options(under_test.DEVICE, cache=tmp_path))
    try:
        scene, settings = (
            scenes.plates(16, 16),
            RenderSettings(sample_count=8, bounce_max=1, sample_sequence="INDEPENDENT"),
        )
        row = bench.timed(scene, settings.replace(batching="OFF"), "warm")
        assert (row["complete"], row["share"], row["invalid_samples"], row["method"]) == (True, 1.0, 0, "OFF") and row[
            "rays"
        ] >= 16 * 16 * 8
        waiting = bench.timed(scene, settings.replace(batching="ON"))
        assert waiting["film"] == row["film"] and waiting["method"] == "ON" and waiting["treelets"] >= 1
        assert bench.timed(scene, settings.replace(seed=1))["film"] != row["film"]
        ended = bench.timed(scene, settings.replace(sample_count=1 << 20), cap=0.3)
        assert not ended["complete"] and ended["film"] is None and 0 <= ended["share"] < 1
        assert whole_seconds(ended) is None or whole_seconds(ended) > ended["seconds"]
        reference = bench.reference("plates", scene, settings, 64)
        assert reference.samples == 64 and len(list(tmp_path.iterdir())) == 1
        row = bench.curve(scene, settings, reference)
        assert [each["samples"] for each in row["points"]] == [1, 2, 4, 8] and row["slope"]["slope"] < 0 < row["floor"][
            "rmse"
        ]
        json.dumps(row, allow_nan=False)
        again = Bench(Options(under_test.DEVICE, cache=tmp_path))
        again.session = None  # nothing is rendered
        assert (again.reference("plates", scene, settings, 64).picture == reference.picture).all()
        film = bench.session.render(scene, settings)
        assert row_of(film, settings)["film"] == row["film"]
    finally:
        bench.close()


def test_films_that_differ_are_found():
    reported = [
        {"case": k, "turn": 0, "scene": s, "film": f, "complete": c}
        for k, s, f, c in (
            ("a", "x", "1", True),
            ("b", "x", "1", True),
            ("c", "y", "2", True),
            ("d", "y", "3", True),
            ("e", "y", "4", False),
        )
    ]
    assert rows.differing_films(reported, ("scene",)) == ["d"]


# --- pages


def test_a_fragment_replaces_only_what_is_between_its_marks(tmp_path):
    page = tmp_path / "page.md"
    pages.put_fragment(page, "x", "Title", pages.table(["a", "b"], [[1, None]]))
    assert page.read_text().startswith("# Title\n") and "| 1 |  |" in page.read_text()
    page.write_text("By hand.\n\n" + page.read_text() + "\nMore \\1 by hand.\n")
    pages.put_fragment(page, "x", "Title", "new \\1")
    text = page.read_text()
    assert text.startswith("By hand.") and text.endswith("by hand.\n") and "new \\1" in text and "| 1 |" not in text
    page.write_text("no marks")
    with pytest.raises(UsageError, match="has not one place"):
        pages.put_fragment(page, "x", "Title", "new")
    assert page.read_text() == "no marks"


def test_numbers_are_written_to_be_read():
    assert [pages.number(v) for v in (None, 0.12345, 1234567.0, 12.0, 1e-3)] == [
        "",
        "0.123",
        "1,234,567",
        "12",
        "0.001",
    ]
    assert pages.number(3.0, estimate=True) == "~3"


# --- the command line


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["thesos"], "did you mean thesis"),
        ([], "no study was named"),
        (["thesis", "--part", "3/2"], "--part 3/2"),
        (["thesis", "--turns", "0"], "--turns 0"),
        (
            ["budgets", "--device", "cpu", "--scenes", "/nowhere"],
            "the scene dragon (dragon.npz) was not found (/nowhere)",
        ),
        (["top-level", "--device", "cpu", "--scenes", "/nowhere"], "half.npz), san_miguel (san_miguel.npz or "),
        (["budgets", "--draw"], "measure it first"),
        (["budgets", "--gather", "/nowhere/rows.jsonl"], "cannot be read"),
    ],
)
def test_bad_input_is_reported_in_one_line(tmp_path, arguments, words):
    assert words in error_line(call_script("study.py", *arguments, "--out", tmp_path / "new"))
    assert not (tmp_path / "new").exists()


def test_studies_are_listed():
    done = run_script("study.py", "--list")
    assert done.returncode == 0 and [line.split()[0] for line in done.stdout.splitlines()] == list(STUDIES)
    assert study_named("thesis") is STUDIES["thesis"]
