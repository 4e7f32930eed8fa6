"""The tables of all cases in docs/stability.md; that they are up to date is tested in test_stability_cli.py."""

from stability_report.manual import cases_tables, merged, read_results, results_of

from tests.stability.case import Case
from tests.stability.cases import all_cases
from tests.support.command_line import ROOT


def test_stored_results_are_of_cases_that_are_there_and_passed():
    tracers = {each.name: each.tracers for each in all_cases()}
    for run in read_results(ROOT):
        assert run["tracer"] in tracers[run["name"]] and run["passed"], run["name"]


def test_tables_are_short_and_say_each_passage_once():
    shared = "Each of the many rays is traced once, and all that it meets is compared with a sum in float64."
    texts = {"one | half": "Rays. " + shared, "two": shared + " Then they go back."}
    cases = [Case(name, "made", about, "None.", None, True, False) for name, about in texts.items()]
    report = {"device": "CPU", "cases": []}
    for tracer, measured in (("off", 1.25), ("on", 1.5)):
        numbers = {"measured": measured, "expected": 1.0, "tolerance": 1.0}
        report["cases"].append({"name": "two", "tracer": tracer, "passed": True, **numbers})
    runs = results_of(report)
    assert merged(runs, runs) == runs
    text = cases_tables(cases, runs)
    assert "| one \\| half | off, on |  | not stored |  |" in text and "| two | off, on |  | 0.5 | 1 |" in text
    assert " ".join(text.split()).count(shared) == 1 and "- **two.** (a) Then they go back." in text
    assert max(map(len, text.splitlines())) <= 120
