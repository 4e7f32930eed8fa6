"""scripts/testing: work is cut the same way everywhere, and nothing that was run is lost."""

import json
import time
from pathlib import Path

import pytest
from testing import everything, page
from testing.gpu_report import Earlier, report_of, seconds_in, summary
from testing.outcomes import CheckOutcome, read_outcomes, share_of
from testing.run_units import BROKEN, DONE, STOPPED, UnitRun, run_units
from testing.units import FOLDERS, ROOT, Unit, all_units, part_of

from tests.stability.cases import all_cases

PYTHON_UNITS = {
    "passes": "print('well')",
    "fails without a word": "raise SystemExit(3)",
    "never ends": "import time; time.sleep(60)",
}


class PythonUnit(Unit):
    """Runs its name's code, and writes an outcome before."""

    def command(self, device: str) -> list[str]:
        write = "from testing.outcomes import *; write_outcome(CheckOutcome('a::b', 'passed', 2.0)); "
        return ["python3", "-c", write + PYTHON_UNITS[self.name]]


@pytest.fixture(scope="module")
def units():
    return all_units()


def test_units_hold_every_file_and_every_case_once(units):
    files = sorted(path.relative_to(ROOT).as_posix() for f in FOLDERS for path in (ROOT / f).rglob("test_*.py"))
    whole = [(file, unit.share) for unit in units for file in unit.files]
    assert len(set(whole)) == len(whole) and sorted({file for file, _ in whole}) == files
    tracers = {each.name: each.tracers for each in all_cases()}
    cases = [
        (name, tracer)
        for unit in units
        for name in unit.cases
        for tracer in ([unit.tracer] if unit.tracer else tracers[name])
    ]
    assert sorted(cases) == sorted((name, tracer) for name in tracers for tracer in tracers[name])
    assert any(unit.tracer for unit in units), "no case is cut by its tracers any more"


def test_shares_are_the_whole():
    for count in (0, 1, 2, 3, 7, 100):
        assert [i for n in (1, 2, 3) for i in share_of(count, f"{n}/3")] == list(range(count))


def test_parts_are_the_whole_and_take_about_as_long(units):
    for count in (1, 2, 3):
        parts = [part_of(units, number, count) for number in range(1, count + 1)]
        assert sorted(unit.name for part in parts for unit in part) == sorted(unit.name for unit in units)
        loads = [sum(unit.seconds for unit in part) for part in parts]
        assert max(loads) - min(loads) <= max(unit.seconds for unit in units)


def test_what_was_run_is_in_the_report_however_it_ended(tmp_path):
    runs = UnitRun.of([PythonUnit(name, 1.0) for name in PYTHON_UNITS], tmp_path)
    run_units(runs, "cpu", tmp_path / "kernels", 3, time.monotonic() + 6, lambda: None)
    assert [run.state for run in runs] == [DONE, BROKEN, STOPPED]
    report = report_of(runs, (1, 2), "cpu", 4.0)
    assert (report["passed"], report["failed"], report["skipped"], report["units_not_ended"]) == (3, 1, 0, 1)
    assert not report["complete"] and "1 of 3 units not ended" in summary(report)
    row = page.gpu_row(report)
    assert row["failures"] == ["fails without a word"] and "1 of 3 units did not end" in row["about"]
    path = tmp_path / "report.json"
    path.write_text(json.dumps(report))
    assert seconds_in([path]) == {"a": 2.0}, "of the unit that ended"


def test_a_run_goes_on_from_a_report(tmp_path):
    def done(name: str, outcome: str) -> UnitRun:
        run = UnitRun(Unit(name, 1.0), tmp_path / f"{name}.jsonl", tmp_path / f"{name}.txt", DONE, seconds=1.0)
        run.lines.write_text(json.dumps({"name": name, "outcome": outcome, "seconds": 1.0, "note": ""}) + "\n")
        return run

    path = tmp_path / "report.json"
    waiting = UnitRun(Unit("c", 1.0), tmp_path / "c.jsonl", tmp_path / "c.txt")
    path.write_text(json.dumps(report_of([done("a", "passed"), done("b", "failed"), waiting], (1, 2), "cpu", 4.0)))
    earlier = Earlier.of(path, (1, 2))
    assert earlier.names == {"a"}, "what failed is run again"
    report = report_of([done("b", "passed"), done("c", "passed")], (1, 2), "cpu", 2.0, earlier)
    assert report["complete"] and (report["passed"], report["failed"], report["seconds"]) == (3, 0, 6.0)
    with pytest.raises(ValueError, match="part 1/2, not of 2/2"):
        Earlier.of(path, (2, 2))
    path.write_text("{}")
    with pytest.raises(ValueError, match="no report"):
        Earlier.of(path, (1, 2))


def test_a_line_that_is_half_written_is_left_out(tmp_path):
    path = tmp_path / "lines"
    assert read_outcomes(path) == []
    path.write_text('{"name": "a", "outcome": "passed", "seconds": 1.0, "note": ""}\n{"name": "b", "outc')
    assert read_outcomes(path) == [CheckOutcome("a", "passed", 1.0)]


def test_the_page_shows_what_is_stored():
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.updated(text) == text


def test_a_check_that_leaves_no_report_failed_and_others_are_not_run_again(tmp_path, monkeypatch, capsys):
    stored, text = tmp_path / "testing.json", tmp_path / "testing.md"
    text.write_text("\n".join(page.MARKS))
    monkeypatch.setattr(page, "STORED", stored)
    monkeypatch.setattr(page, "PAGE", text)
    monkeypatch.setattr(everything, "WORK", tmp_path)
    monkeypatch.setattr(everything, "STATE", tmp_path / "state.json")
    monkeypatch.setattr(everything, "commit", lambda: "abc")
    times = tmp_path / "times"
    good = everything.Check(
        "adds a line",
        lambda work: ["-c", f"open({str(times)!r}, 'a').write('ran\\n')"],
        lambda work: {"passed": 2, "failed": 0, "skipped": 1, "failures": []},
    )
    bad = everything.Check("says nothing", lambda work: ["-c", ""], lambda work: json.loads((work / "no").read_text()))
    monkeypatch.setattr(everything, "CHECKS", {"suite": good, "parity": bad})
    assert everything.main([]) == 1 and everything.main([]) == 1
    assert times.read_text() == "ran\n"
    assert "suite: 2 passed, 0 failed, 1 skipped" in capsys.readouterr().out
    assert "| suite | adds a line |" in text.read_text() and "- parity: no report" in text.read_text()
    assert Path(stored).exists()
