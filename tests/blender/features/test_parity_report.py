"""Figures, the list of features, and the report of scripts/parity.py; nothing is rendered."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version < (5, 2):
    pytest.skip("features are compared with the Cycles of Blender 5.2", allow_module_level=True)

import numpy as np
from parity_report.page import counts, earlier_results, json_report, page, together
from parity_report.sheets import CELL, read_sheet, write_sheets
from parity_report.workers import groups_of, read_results, write_results

from tests.blender.features.compare import Picture, figures_of
from tests.blender.features.known import KNOWN, THOROUGH
from tests.blender.features.registry import FAMILIES, all_features, chosen_features
from tests.blender.features.runner import DIFFERENT, OK, UNSUPPORTED, Result, _reasons, sheets

ROOT = Path(__file__).resolve().parents[3]


def test_what_is_known_to_fail_is_quick():
    assert {*KNOWN, *THOROUGH} <= {each.name for each in chosen_features(quick=True)}


def test_every_family_has_features_and_names_lead_to_them():
    assert {each.family for each in all_features()} == set(FAMILIES)
    assert [each.name for each in chosen_features(["Magic Texture"])] == ["Magic Texture"]
    assert {each.family for each in chosen_features(["World"])} == {"World"}
    with pytest.raises(LookupError, match="nothing of that name"):
        chosen_features(["nothing of that name"])


def test_every_feature_is_in_one_group():
    features = all_features()
    names = [each.name for group in groups_of(features) for each in group]
    assert sorted(names) == sorted(each.name for each in features)
    for sheet in sheets([each for each in features if each.kind == "node"]):
        assert len({(each.family, each.samples) for each in sheet}) == 1


def _picture(mean, noise, seed):
    random = np.random.default_rng(seed)
    return Picture(*(mean + noise * random.standard_normal(mean.shape) for _ in range(2)))


def test_noise_is_taken_away_and_differences_are_not():
    mean = np.full((64, 64, 3), 0.5) + np.linspace(0, 0.5, 64)[None, :, None]
    same = figures_of(_picture(mean, 0.02, 1), _picture(mean, 0.04, 2))
    assert (
        abs(same.rel_mse) < 4 * same.rel_mse_noise
        and same.mean_error < 4 * same.noise
        and np.abs(same.deviations).max() < 4
    )
    brighter = figures_of(_picture(1.02 * mean, 0.02, 1), _picture(mean, 0.04, 2))
    assert abs(brighter.mean_error - 0.02) < 4 * brighter.noise and np.abs(brighter.deviations).min() > 4
    # a pattern that does not change the mean
    wavy = figures_of(
        _picture(mean * (1 + 0.1 * (-1) ** np.arange(64)[:, None, None]), 0.02, 1), _picture(mean, 0.04, 2)
    )
    assert abs(wavy.rel_mse - 0.01 * np.mean(mean**2 / (mean**2 + 1e-2))) < 4 * wavy.rel_mse_noise


def test_a_black_channel_of_both_is_alike():
    black = np.zeros((8, 8, 3)) + (0.5, 0.5, 0.0)
    assert figures_of(_picture(black, 0.0, 1), _picture(black, 0.0, 2)).mean_error == 0


def test_warnings_lose_what_they_are_about():
    warnings = [
        "material “A: b” of “A: b”: node “X” is not supported",
        "material “A: b.001” of “A: b.001” and 2 more: node “X” is not supported",
    ]
    assert _reasons(warnings) == ["node “X” is not supported"]


@pytest.fixture
def results():
    node, picture, other = chosen_features(["Magic Texture", "Diffuse BSDF: Oren-Nayar", "Blackbody"])
    if node.kind != "node":
        node, picture = picture, node
    grey = np.full((40, 40, 3), 0.25)
    figures = {
        "mean": 0.02,
        "mean's noise": 0.001,
        "deviations": 20.0,
        "relMSE": 0.004,
        "relMSE's noise": 1e-4,
        "samples": 192.0,
    }
    return [
        Result(picture, DIFFERENT, figures, "", grey, 1.02 * grey, 1.5),
        Result(node, OK, {"error": 1e-6}, "", grey[:32, :32], grey[:32, :32]),
        Result(other, UNSUPPORTED, {"error": 1.0}, "node | is not supported"),
    ]


def test_results_come_back_from_their_file(results, tmp_path):
    write_results(results, tmp_path / "r.npz")
    back = list(read_results(tmp_path / "r.npz", {each.feature.name: each.feature for each in results}))
    for one, other in zip(results, back, strict=True):
        assert (one.feature, one.status, one.note, one.seconds) == (
            other.feature,
            other.status,
            other.note,
            other.seconds,
        )
        assert one.figures == pytest.approx(other.figures)
        assert (one.ours is None) == (other.ours is None) and (one.ours is None or np.allclose(one.ours, other.ours))


def test_the_page_has_a_row_for_each(results, tmp_path):
    numbers = write_sheets(results, tmp_path)
    assert len(numbers) == 2 and all(path.stat().st_size < 20_000 for path in tmp_path.glob("*.png"))
    text = page(results, numbers, {"Blender": "5.2"})
    rows = [line for line in text.splitlines() if any(f"| {each.feature.name} |" in line for each in results)]
    assert len(rows) == 3 and "node | is not supported" in text and "| all | 1 | 3 | 33% |" in text
    assert all(line.startswith(f"| {numbers.get(line.split(' | ')[1], '')} |") for line in rows)
    assert max(len(line) for line in text.splitlines()) < 160
    for file in {path.name for path in tmp_path.glob("*.png")}:
        assert f"](parity/{file})" in text
    report = json_report(results, {}, 1.0)
    (tmp_path / "results.json").write_text(json.dumps(report))
    mended = Result(results[0].feature, OK, results[0].figures)
    rows = together(earlier_results(tmp_path / "results.json"), [mended])
    assert {row.feature.name: row.status for row in rows} == {mended.feature.name: OK} | {
        each.feature.name: each.status for each in results[1:]
    }
    assert write_sheets(rows, tmp_path) == numbers  # pictures stay
    assert report["counts"]["all"] == {"ok": 1, "total": 3} and counts(results)["Textures"] == (1, 1)
    assert [each["status"] for each in report["features"]] == [each.status for each in results]


def test_pictures_are_found_on_their_sheet_again(tmp_path):
    features = chosen_features(["Shaders"])[:6]
    random = np.random.default_rng(1)

    def result(feature):
        return Result(feature, OK, {}, "", random.random((40, 40, 3)), random.random((40, 40, 3)))

    write_sheets([result(each) for each in features], tmp_path)
    (sheet,) = tmp_path.glob("*.png")
    first = read_sheet(sheet)
    assert list(first) == [each.name for each in features]
    assert all(each.shape == (CELL[1], CELL[0], 3) for each in first.values())
    # one is gone, one is new, the others move up
    kept = [Result(each, OK, {}) for each in features[1:5]] + [result(features[5])]
    assert write_sheets(kept, tmp_path) == {each.name: number for number, each in enumerate(features[1:], 1)}
    second = read_sheet(sheet)
    assert all((second[each.name] == first[each.name]).all() for each in features[1:5])
    assert (second[features[5].name] != first[features[5].name]).any()


def _run(*arguments):
    return subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "parity.py"), *arguments], capture_output=True, text=True
    )


def test_the_script_names_features_and_says_what_it_does_not_know():
    listed = _run("--list", "--only", "Textures")
    assert listed.returncode == 0 and "Magic Texture" in listed.stdout and "Glass BSDF" not in listed.stdout
    unknown = _run("--list", "--only", "nothing of that name")
    assert (
        unknown.returncode == 1
        and "no feature is called 'nothing of that name'" in unknown.stderr
        and not unknown.stdout
    )
