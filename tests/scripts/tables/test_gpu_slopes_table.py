"""The table of equal error on a GPU is made from reports of benchmark.py."""

import json

import pytest
from tables import gpu_slopes_table

FIXED = {"OPTIX": {"fixed_seconds": 0.25, "first_seconds": 2.0}, "CUDA": {"fixed_seconds": 0.75, "first_seconds": 6.0}}


def report(scene, slope, variance, peer="OPTIX"):
    engine = {"ms_a_sample": 2.0, "fixed_seconds": 0.5, "first_seconds": 1.25, "runs": 3}
    return {
        "scene": scene,
        "device": {"name": "a GPU"},
        "versions": {"blender": "5", "warp": "1"},
        "frame": {"width": 640, "height": 360},
        "sample_counts": [4, 16],
        "ray_tracing_cores": False,
        "raybatch": engine,
        "cycles": {kind: engine | fixed for kind, fixed in FIXED.items()},
        "peer": peer,
        "slope_raybatch_over_cycles": slope,
        "variance_raybatch_over_cycles": variance,
        "equal_error_raybatch_over_cycles": slope * variance,
        "fixed_raybatch_over_cycles": 1.0,
        "mean_ratio": 1.0,
        "settings": "not kept",
    }


def test_the_page_is_up_to_date():
    assert gpu_slopes_table.main(["--check"]) == 0, "run python scripts/tables/gpu_slopes_table.py"


def test_each_file_stands_beside_its_peer_and_the_worst_is_the_largest(tmp_path, monkeypatch):
    page, data = tmp_path / "page.md", tmp_path / "data.json"
    page.write_text("\n".join(["before", *gpu_slopes_table.MARKS, "after"]), encoding="utf-8")
    monkeypatch.setattr(gpu_slopes_table, "PAGE", page)
    monkeypatch.setattr(gpu_slopes_table, "DATA", data)
    differing = min(gpu_slopes_table.known_to_differ())  # a file whose pictures differ
    reports = [report("b.blend", 0.5, 1.0), report("A.blend", 0.25, 8.0, "CUDA"), report("c.blend", 1.0, 0.5)]
    reports[0]["export_s"] = 0.1249
    owner, name, path = differing.split("/", 2)
    asked = {"options": {"scene": f"/files/{owner}+{name}/{path}"}}
    reports.append(report(path.rpartition("/")[2], 4.0, 100.0) | {"asked": asked})
    paths = []
    for number, each in enumerate(reports):
        paths.append(tmp_path / f"{number}.json")
        paths[-1].write_text(json.dumps(each), encoding="utf-8")
    assert gpu_slopes_table.main([str(path) for path in paths]) == 0
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][2:]
    assert [line.split(" | ")[0] for line in rows] == [
        "| A.blend",
        "| b.blend",
        "| c.blend",
        "| **median**",
        "| **worst**",
        f"| {differing} (differs)",
    ]
    assert rows[0].endswith("| 0.25 | 8 | 2 | 0.50 / 0.75 | - | 1.25 / 6.00 | 1.000 |")
    assert "| 0.50 / 0.25 | 0.12 | 1.25 / 2.00 |" in rows[1]
    assert "| 0.50 (" in rows[3] and rows[4].endswith("| 1 | 8 | 2 |  |  |  |  |")
    assert "settings" not in json.loads(data.read_text(encoding="utf-8"))[0]
    assert gpu_slopes_table.main(["--check"]) == 0


def test_a_report_without_cycles_is_refused(tmp_path):
    (tmp_path / "plain.json").write_text(json.dumps({"scene": "a"}), encoding="utf-8")
    with pytest.raises(KeyError):
        gpu_slopes_table.main([str(tmp_path / "plain.json")])
