"""The README's table of real files is made of kept figures."""

from tables import readme_table


def file_row(variance, time, same=True):
    """Of two repeats, of which the second is twice as bad."""
    equal = variance * time
    return {"variance": [variance] * 2, "time": [time] * 2, "equal error": [equal, 2 * equal], "same": same}


def test_the_page_is_up_to_date():
    assert readme_table.main(["--check"]) == 0, "run python scripts/tables/readme_table.py"


def test_files_that_differ_do_not_count_and_the_worst_is_named():
    files = {
        "a/one.blend": file_row(0.5, 1.0),
        "a/two.blend": file_row(2.0, 3.0),
        "a/b.blend": file_row(9.0, 9.0, False),
    }
    runs = [{"files": files, "request": {"width": 160, "samples": 32, "defaults": False}}]
    figures = {
        "variance_raybatch_over_cycles": 0.5,
        "slope_raybatch_over_cycles": 0.25,
        "equal_error_raybatch_over_cycles": 0.125,
    }
    report = {"scene": "c.blend", "device": {"name": "NVIDIA X"}, "sample_counts": [4, 16], **figures}
    differing = {**report, "scene": min(readme_table.known_to_differ())}
    rows = readme_table.table(runs, [report, {**differing, "equal_error_raybatch_over_cycles": 7.0}]).splitlines()[2:]
    assert rows == [
        "| two cores, 32 samples | 1.25 | 2.00 | 4.88 | 12.00 (two) | 2 |",
        "| X, a sample, surfaces alone | 0.50 | 0.25 | 0.12 | 0.12 (c) | 1 |",
    ]
