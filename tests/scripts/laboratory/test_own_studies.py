"""Studies of one's own: what a file says, what is measured of it, its page, and what is said of a file with faults."""

import json

import numpy as np
import pytest
import study as script
from lib.command import UsageError
from studies import pages, rows, runner
from studies.own.definition import definition_of, read_definition
from studies.own.measures import MEASURES
from studies.own.page import asked_for, page_fragment
from studies.own.plots import plot_names
from studies.own.sources import BUILT, NAMES
from studies.own.study import cases_of, estimator_digest, own_study, run_study
from studies.study import Options

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.benchmark_scenes import save_bowl
from tests.support.command_line import ROOT, error_line
from tests.support.scripts_here import call_script

SMALL = {
    "scenes": ["room"],
    "size": [16, 12],
    "turns": 2,
    "devices": ["cpu"],
    "measures": ["seconds", "rays_queued_per_ray"],
    "control": {"batching": "OFF"},
    "common": {"sample_count": 2, "bounce_max": 1},
    "vary": {"batching": ["OFF", "ON"], "ray_count": [256, 512]},
}


def defined(**changes):
    return definition_of(SMALL | changes, "small")


# --- what a file says


def test_cases_are_all_combinations_and_the_named_ones(tmp_path):
    found = defined(cases=[{"name": "Warp's tree", "batching": "REFERENCE"}])
    assert [case.label for case in found.cases] == [
        "batching OFF, ray_count 256",
        "batching OFF, ray_count 512",
        "batching ON, ray_count 256",
        "batching ON, ray_count 512",
        "Warp's tree",
    ]
    # each combination is compared with the one that differs in what the control names alone
    assert [case.control for case in found.cases[:4]] == [case.label for case in found.cases[:2]] * 2
    assert found.cases[4].control is None
    whole = defined(control={"batching": "ON", "ray_count": 512}, cases=[{"name": "own"}])
    assert {case.control for case in whole.cases} == {"batching ON, ray_count 512"}
    assert {case.control for case in defined(cases=[{"name": "own"}], control="own").cases} == {"own"}
    assert cases_of(defined(), Options())[0].key == "room 16x12: batching OFF, ray_count 256"
    assert plot_names(defined()) == {"ray-count": "Measures by ray_count"}


def test_files_are_found_beside_the_study_and_known_by_what_is_in_them(tmp_path):
    bowl = save_bowl(tmp_path)
    save_scene(tmp_path / "mixed.scene.npz", scenes.mixed(scenes.Frame(8, 6)), RenderSettings(sample_count=3))
    path = tmp_path / "my-study.toml"
    path.write_text(
        'scenes = ["mixed.scene.npz", "./bowl.npz", '
        '{ file = "bowl.npz", name = "grid", grid = 2, up = "z", camera = [0, -9, 6, 0, 0, 0, 40] }]\n'
        '[vary]\ngeometry_budget = ["1.5K", "1Mi"]\n'
    )
    found = read_definition(path)
    assert (found.name, found.title, found.turns, found.devices) == ("my-study", "My study", 3, ("AUTO",))
    assert found.axes == {"geometry_budget": (1500, 1 << 20)}
    mixed, plain, grid = found.scenes
    scene, settings = mixed.open(Options())
    assert (scene.frame.width, scene.frame.height, settings.sample_count) == (8, 6, 3)
    assert (plain.open(Options())[0].frame.width, len(grid.open(Options())[0].meshes[0].triangles)) == (320, 4 * 312)
    bowl.write_bytes(bowl.read_bytes() + b" ")
    assert [a.key == b.key for a, b in zip(found.scenes, read_definition(path).scenes)] == [True, False, False]


@pytest.mark.parametrize("name", BUILT)
def test_scenes_that_studies_build_are_opened_by_name(name):
    found = defined(scenes=[{"file": name, "size": [9, 5]}])
    scene, settings = found.scenes[0].open(Options())
    assert (scene.frame.width, scene.frame.height, settings) == (9, 5, RenderSettings())


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"varry": {}}, r"the study: there is no key 'varry'; did you mean vary\?"),
        ({"title": ""}, "title: '' is not valid"),
        ({"scenes": None}, "scenes: none is named"),
        ({"scenes": []}, r"scenes: \[\] is not valid: write a list of scenes"),
        ({"scenes": ["rom"]}, r"scenes: there is no scene 'rom'; did you mean room\?"),
        ({"scenes": ["nowhere/a.npz"]}, "scenes: there is no file .*nowhere/a.npz"),
        ({"scenes": ["a.png"]}, "scenes: .*a.png: what kind of file is this"),
        ({"scenes": [{"file": "room", "grid": 2}]}, "scenes: room: name, grid, camera and up are for files"),
        ({"scenes": [{"name": "room"}]}, "names no file"),
        ({"size": [16]}, r"size: \[16\] is not valid: write \[width, height\]"),
        ({"size": [16, True]}, "size: "),
        ({"vary": {"raycount": [1]}}, r"vary: raycount: no setting is called 'raycount'; did you mean ray_count"),
        ({"vary": {"ray_count": 256}}, "vary: ray_count: 256 is not valid: write a list of values"),
        ({"vary": {"batching": ["OFF", "SOMETIMES"]}}, "vary: batching: .* must be one of AUTO, ON, OFF"),
        ({"vary": {"sample_count": [1, 2]}}, r"vary: sample_count: it is in \[common\] too"),
        ({"vary": {"ray_count": [256, "256"]}}, "two of .* are the same value"),
        ({"vary": {"ray_low_water": [0.5], "ray_high_water": [0.1]}, "control": None}, "case ray_low_water 0.5"),
        ({"vary": {}}, "there are no cases"),
        ({"common": {"device": "cpu"}}, "common: device has no place in a study: name where to measure with devices"),
        ({"common": {"denoise": "ON"}}, "what is measured is not denoised"),
        ({"common": {"resolution": "8x8"}}, r"write size = \[width, height\] at the top"),
        ({"common": {"sample_count": 0}}, "common: sample_count = 0 is not valid: it must be 1 to"),
        ({"cases": [{"batching": "ON"}]}, "has no name"),
        ({"cases": [{"name": "a"}, {"name": "a", "nee": "OFF"}]}, "two cases are called 'a'"),
        ({"control": {"nee": "ON"}}, "control: there is no axis 'nee'"),
        ({"control": {"batching": "AUTO"}}, r"control: batching: 'AUTO' is not among the values .*\['OFF', 'ON'\]"),
        (
            {"control": "batching OFF"},
            r"control: there is no case 'batching OFF'; did you mean batching OFF, ray_count",
        ),
        ({"measures": ["second"]}, r"measures: there is no measure 'second'; did you mean seconds\?"),
        ({"measures": ["relmse"]}, r"measures: relmse is an error, .*add \[reference\] with samples"),
        ({"reference": {"samples": 64}}, "reference: no measure needs it"),
        ({"measures": ["rmse"], "reference": {}}, "reference: it has no samples"),
        ({"turns": 0}, "turns: 0 is not valid: write a whole number, 1 to 1,000"),
        ({"devices": ["gpu"]}, "devices: 'gpu' is no device"),
        ({"devices": ["cuda:0", "cuda:1"]}, "one CPU and one GPU at most"),
    ],
)
def test_faults_are_named_with_the_key_and_the_remedy(changes, words):
    values = {key: value for key, value in (SMALL | changes).items() if value is not None}
    with pytest.raises(UsageError, match=words):
        definition_of(values, "small")


def test_files_with_faults_are_reported_in_one_line_before_anything_is_measured(tmp_path):
    path = tmp_path / "bad.toml"
    for text, words in (("scenes = [", "bad.toml is not TOML"), ('scenes = ["room"]', "bad.toml: there are no cases")):
        path.write_text(text)
        assert words in error_line(call_script("study.py", path, "--out", tmp_path / "new"))
    assert "there is no file" in error_line(call_script("study.py", tmp_path / "none.toml"))
    (tmp_path / "a.npz").write_bytes(b"no archive")
    np.savez(tmp_path / "b.npz", v=np.zeros((3, 3)))
    np.savez(tmp_path / "c.scene.npz", v=np.zeros((3, 3)))
    for name, words in (
        ("a.npz", "scenes: a.npz: it cannot be read as a NumPy archive; is it damaged?"),
        ("b.npz", "scenes: b.npz: it is not geometry: it has no array f"),
        ("c.scene.npz", "scenes: c.scene.npz: it is not a saved scene: it has no array header"),
    ):
        path.write_text(f'scenes = ["{name}"]\n[vary]\nnee = ["ON", "OFF"]\n')
        assert words in error_line(call_script("study.py", path))
    path.write_text('scenes = ["room"]\n[vary]\nnee = ["ON", "OFF"]\n')
    assert "--quick is for the studies" in error_line(call_script("study.py", path, "--quick"))
    assert not (tmp_path / "new").exists() and not (tmp_path / "bad").exists()


# --- runs


def test_a_study_is_measured_and_goes_on_where_more_is_asked_for(tmp_path, capfd):
    """Films that only the schedule tells apart are equal, ratios are taken to the control, and rows stay."""
    path, out = tmp_path / "mine.toml", tmp_path / "out"
    text = (ROOT / "docs/studies/own.toml").read_text(encoding="utf-8")
    for old, new in (
        ('["room", "plates"]', '["room"]'),
        ("[320, 240]", "[16, 12]"),
        ("sample_count = 16\nbounce_max = 4", "sample_count = 2\nbounce_max = 1"),
        ("[4096, 16384, 65536]", "[256, 512]"),
        ("turns = 3", 'turns = 1\ndevices = ["cpu"]'),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    options = [str(path), "--out", str(out)]
    pytest.importorskip("matplotlib")
    assert script.main(options) == 0
    header, first = rows.read_rows(out / "data/mine-cpu.jsonl")
    assert len(first) == 4 and header["definition"] == read_definition(path).digest
    assert len({row["film"] for row in first}) == 1 and {row["method"] for row in first} == {"OFF", "ON"}
    page = (out / "mine.md").read_text(encoding="utf-8")
    assert page.startswith("# Batching by rays alive\n") and "Whether more rays alive" in page and text.strip() in page
    assert "All 4 films are equal bit for bit where the schedule alone differs: 1 group of 4 cases at most." in page
    assert (out / "mine-ray-count.svg").is_file() and "(mine-ray-count.svg)" in page
    lines = [line for line in page.splitlines() if line.startswith(("| OFF", "| ON"))]
    assert [line.split(" | ")[3] for line in lines[:2]] == ["1", "1"]  # the controls over themselves

    page_by_hand = page + "\nBy hand.\n"
    (out / "mine.md").write_text(page_by_hand, encoding="utf-8")
    path.write_text(text.replace("[256, 512]", "[256, 1024]"))
    assert script.main(options) == 0
    _, second = rows.read_rows(out / "data/mine-cpu.jsonl")
    assert second[:4] == first and [row["settings"]["ray_count"] for row in second[4:]] == [1024, 1024]
    page = (out / "mine.md").read_text(encoding="utf-8")
    assert "| 512 |" not in page and "| 1024 |" in page and page.endswith("By hand.\n") and "All 4 films" in page
    capfd.readouterr()
    path.write_text(text.replace("bounce_max = 1", "bounce_max = 2"))
    assert script.main(options) == 1
    assert "measured with other common settings" in capfd.readouterr().err
    assert script.main([*options, "--draw"]) == 1
    assert "measured with other common settings" in capfd.readouterr().err


def test_errors_are_measured_over_time_and_refusals_stand_in_the_table(tmp_path):
    study = {
        "scenes": ["room"],
        "size": [12, 8],
        "turns": 2,
        "devices": ["cpu"],
        "measures": ["relmse", "efficiency", "bytes_copied_per_ray"],
        "common": {"sample_count": 4, "bounce_max": 1},
        "cases": [{"name": "plain"}, {"name": "queued", "batching": "ON"}, {"name": "tiny", "geometry_budget": 1}],
        "control": "plain",
        "reference": {"samples": 16},
    }
    page, found = run_study(study, tmp_path, name="noise", plots=False)
    plain, queued, tiny = ([row for row in found if row["variant"] == name] for name in ("plain", "queued", "tiny"))
    assert [a["film"] == b["film"] for a, b in zip(plain, queued, strict=True)] == [True, True]
    assert plain[0]["film"] != plain[1]["film"]  # each turn has a seed of its own
    assert [len(row["points"]) for row in plain] == [3, 3] and MEASURES["relmse"].value(plain[0]) > 0
    assert all("too small" in row["refused"] for row in tiny)
    text = page.read_text(encoding="utf-8")
    assert "refused: a geometry budget of 1 bytes is too small" in text and "seconds to it" in text
    assert ".svg" not in text and "2 groups of 2 cases at most" in text


# --- the page


def made_rows(definition, seconds, film="same"):
    """A row for each case and turn."""
    cases = cases_of(definition, Options())
    return [
        {
            "case": case.key,
            "turn": turn,
            "seconds": seconds[number][turn],
            "rays": 1000,
            "complete": True,
            "share": 1.0,
            "film": film if number < 3 else "same",
            "estimator": "e",
            "width": 16,
            "height": 12,
            **case.what,
        }
        for number, case in enumerate(cases)
        for turn in range(2)
    ]


def report_of(found):
    header = {"study": "small", "device_kind": "cpu", "quick": False, "versions": {"raybatch": "1", "warp": "2"}}
    return {**header, "device": {"alias": "cpu", "name": "CPU", "cores": 2}, "rows": found}


def test_the_table_has_medians_spreads_and_ratios_of_turns():
    definition = defined(measures=["seconds", "mrays_per_second"])
    found = made_rows(definition, [(1.0, 3.0), (2.0, 2.0), (2.0, 9.0), (4.0, 4.0)])
    stale = {**found[0], "case": "room 16x12: batching AUTO, ray_count 256", "film": "another"}
    text = page_fragment(definition, True, {"cpu": report_of([*found, stale])})
    # the ratio is taken within turns: 2 and 3, where that of medians is 2.75
    assert "| batching | ray_count | seconds | over control | Mrays/s | over control |" in text
    assert "| ON | 256 | 5.5 ± 64 % | 2.5 |" in text and "| OFF | 512 | 2 | 1 | 0.0005 | 1 |" in text
    assert "All 8 films are equal" in text and "room: 16 x 12 pixels." in text
    assert len(asked_for(definition, report_of([*found, stale]))["rows"]) == 8


def test_films_that_differ_by_the_schedule_are_named():
    definition = defined()
    found = made_rows(definition, [(1.0, 1.0)] * 4, film="other")
    text = page_fragment(definition, True, {"cpu": report_of(found)})
    assert "**Films differ where the schedule alone does**" in text and "batching ON, ray_count 512" in text
    for row in found:
        row["estimator"] = row["variant"]
    assert "No two cases differ in their schedule alone" in page_fragment(definition, True, {"cpu": report_of(found)})


def test_films_are_compared_where_the_schedule_alone_differs():
    settings = RenderSettings(batching="OFF")
    same = estimator_digest(settings)
    assert estimator_digest(settings.replace(batching="ON", ray_count=512, tile_size=64)) == same
    for other in ({"seed": 1}, {"bounce_max": 1}, {"batching": "REFERENCE"}):  # whose tree is Warp's
        assert estimator_digest(settings.replace(**other)) != same


def test_figures_of_another_definition_are_not_drawn(tmp_path):
    definition = defined()
    study = own_study(definition, plots=False)
    report = report_of(made_rows(definition, [(1.0, 1.0)] * 4)) | {"definition": "another"}
    path = tmp_path / runner.DATA / "small-cpu.json"
    rows.write_report(path, report)
    with pytest.raises(UsageError, match="measured with other common settings"):
        runner.write_page(study, tmp_path, plots=False)
    rows.write_report(path, report | {"definition": definition.digest})
    assert pages.marks_of("small")[0] in runner.write_page(study, tmp_path, plots=False).read_text(encoding="utf-8")


def test_the_page_of_documents_names_all_keys_measures_and_scenes():
    from studies.own.definition import KEYS

    page = (ROOT / "docs/studies/own.md").read_text(encoding="utf-8")
    for name, measure in MEASURES.items():
        assert f"| `{name}` | {measure.about}" in page
    assert all(f"`{name}`" in page for name in NAMES)
    assert all(f"| `{name}` |" in page or f"| `[{name}]` |" in page or f"| `[[{name}]]` |" in page for name in KEYS)
    assert read_definition(ROOT / "docs/studies/own.toml").turns == 3
    json.dumps([case.what for case in cases_of(read_definition(ROOT / "docs/studies/own.toml"), Options())])
