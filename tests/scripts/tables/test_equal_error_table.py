"""The tables of times to equal error are made from results of compare.py."""

import json

from tables import equal_error_table


def report(samples, defaults=False, **files):
    rows = [
        {
            "name": f"a/{name}.blend",
            "verdict": verdict,
            "left_out": [],
            "seconds": {"RAYBATCH": {"all-2": 2.0}, "CYCLES": {"all-2": 1.0}},
            "repeats": {"variance": variances, "equal error": [2 * each for each in variances]},
        }
        for name, (verdict, variances) in files.items()
    ]
    failed = {"name": "a/black.blend", "verdict": "not compared", "left_out": [], "seconds": {}, "repeats": {}}
    request = {"width": 160, "samples": samples, "repeats": 3, "defaults": defaults, "threads": 0}
    return {"request": request, "versions": {}, "note": "a busy machine", "files": [*rows, failed]}


def test_the_page_is_up_to_date():
    assert equal_error_table.main(["--check"]) == 0, "run python scripts/tables/equal_error_table.py"


def test_medians_are_of_files_that_are_the_same_picture_and_the_worst_of_all_repeats(tmp_path, monkeypatch):
    page, data = tmp_path / "page.md", tmp_path / "data.json"
    page.write_text("\n".join(["before", *equal_error_table.MARKS, "after"]), encoding="utf-8")
    monkeypatch.setattr(equal_error_table, "PAGE", page)
    monkeypatch.setattr(equal_error_table, "DATA", data)
    one = {
        "first": ("same", [0.5, 0.25, 0.75]),
        "second": ("same", [1.0, 1.0, 4.0]),
        "third": ("differs", [9.0, 9.0, 9.0]),
    }
    for name, made in (("a", report(32, **one)), ("b", report(32, True, first=("same", [1.0, 1.0, 1.0])))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "results.json").write_text(json.dumps(made), encoding="utf-8")
    assert equal_error_table.main([str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    rows = {
        line.split(" | ")[0]: line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| ")
    }
    # medians 0.5 and 1, the worst repeat of the second file
    cells = rows["| 32 samples: same picture"].split(" | ")[1:]
    assert cells[0].startswith("0.75 (") and cells[1] == "4.00 (second.blend)" and cells[2].startswith("2.00 (")
    assert cells[4].startswith("1.50 (") and cells[5] == "8.00 (second.blend)" and cells[6] == "2 |"
    assert rows["| 32 samples: differ"].split(" | ")[1:2] == ["9.00 (9.00 to 9.00)"]
    assert "| a/third.blend (differs)" in rows and "| a/black.blend" not in rows
    assert rows["| a/first.blend"].endswith(
        "| 0.5 (to 0.75) | 2 (to 2) | 1 (to 1.5) | 1 (to 1) | 2 (to 2) | 2 (to 2) |"
    )
    assert "32 samples, own defaults: a busy machine" in page.read_text(encoding="utf-8")
    assert equal_error_table.main(["--check"]) == 0


def test_a_file_known_to_differ_is_apart_where_noise_hides_it(tmp_path, monkeypatch):
    name = min(equal_error_table.known_to_differ())
    made = report(32, known=("same", [1.0]), other=("same", [1.0]))
    made["files"][0]["name"] = name
    monkeypatch.setattr(equal_error_table, "DATA", tmp_path / "data.json")
    equal_error_table.DATA.write_text(json.dumps([equal_error_table.kept(made)]), encoding="utf-8")
    files = equal_error_table.known()[0]["files"]
    assert not files[name]["same"] and files["a/other.blend"]["same"]


def test_what_was_rendered_is_said_in_words():
    request = {"width": 160, "samples": 32, "defaults": False}
    assert equal_error_table.asked(request) == "32 samples"
    assert equal_error_table.asked(request | {"kernels": "SPECIALISED"}) == "32 samples, kernels of the file compiled"
    assert equal_error_table.asked(request | {"width": 480, "defaults": True}) == (
        "32 samples, 480 pixels wide, own defaults"
    )
