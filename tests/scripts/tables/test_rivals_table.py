"""The tables of docs/experiments/rivals.md are made from reports of benchmark.py."""

from tables import rivals_table


def report(scene: str, rates: dict[str, float]) -> dict:
    """Of one kind of rays."""
    case = {"rays": "primary", "order": "natural", "threads": 1}
    results = [case | {"tracer": name, "mrays_per_s": rate} for name, rate in rates.items()]
    return {"scene": scene, "results": results}


def test_the_page_is_up_to_date():
    assert rivals_table.main(["--check"]) == 0, "run python scripts/tables/rivals_table.py"


def test_the_best_parameters_stand_beside_the_control_of_their_own_run():
    reports = {
        "a": report("a.npz", {"off": 4.0, "on": 1.0, "packet:rays=8": 8.0, "packet:rays=16": 2.0}),
        "b": report("a.npz", {"off": 2.0, "slow": 0.01}),
        "c": report("b.npz", {"off": 1.0, "packet:rays=16": 0.5}),
    }
    found = rivals_table.ratios(reports)
    assert rivals_table.best_table(found, "natural").splitlines() == [
        "|  | A, camera | B, camera |",
        "| --- | --- | --- |",
        "| on | 0.25 |  |",
        "| packet | **2.00** | 0.50 |",
        "| slow | 0.005 |  |",
    ]
    assert rivals_table.all_table(found, "natural").splitlines()[3:5] == [
        "| `packet:rays=8` | **2.00** |  |",
        "| `packet:rays=16` | 0.50 | 0.50 |",
    ]
    assert rivals_table.best_table(found, "shuffled").splitlines()[2:] == []


def test_beyond_memory_a_cell_has_the_rate_and_what_was_brought_in():
    reported = report("a.npz", {"off": 4.0, "on": 10.0})
    for result, brought in zip(reported["results"], (8e6, 5e5), strict=True):
        result |= {"bytes_copied": brought, "ray_count": 1000}
    assert rivals_table.beyond_table({"a": reported}, "natural").splitlines() == [
        "|  | A, camera |",
        "| --- | --- |",
        "| off | 1.00 (8) |",
        "| on | **2.50** (0.5) |",
    ]
