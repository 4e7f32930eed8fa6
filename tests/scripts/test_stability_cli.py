"""scripts/stability.py: what it runs, what it writes, and what it says when it cannot."""

import ast
import json

import pytest

from tests.stability.cases import chosen_cases
from tests.support.command_line import HIDE_BPY, ROOT, error_line, run_python, run_script
from tests.support.scripts_here import call_script

# two runs of one case that needs a tracer, and two cases that need none
FEW = ("--only", "far hits keep their bits,sums of", "--device", "cpu")


def stability(*arguments, **environment):
    """Run the script here."""
    return call_script("stability.py", *arguments, **environment)


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A run with all that is written, in a process where there is no Blender."""
    folder = tmp_path_factory.mktemp("report") / "made"
    written = ("--json", folder / "report.json", "--html", folder / "report.html")
    done = run_script("stability.py", *FEW, *written, before=HIDE_BPY)
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0, done.stderr
    return done, json.loads((folder / "report.json").read_text()), (folder / "report.html").read_text(encoding="utf-8")


def test_the_report_has_every_run_with_what_was_measured(reported):
    _, report, _ = reported
    assert isinstance(report["device"], str) and report["failed"] == 0 and report["passed"] == len(report["cases"]) == 4
    runs = {(each["name"], each["tracer"]) for each in report["cases"]}
    assert runs == {
        ("far hits keep their bits", "off"),
        ("far hits keep their bits", "on"),
        ("sums of all of float32", "-"),
        ("sums of 2^31 samples", "-"),
    }
    for each in report["cases"]:
        assert {"name", "tracer", "passed", "measured", "expected", "tolerance", "invalid_samples"} <= each.keys()
        assert each["passed"] is True and each["invalid_samples"] == 0
        assert abs(each["measured"] - each["expected"]) <= each["tolerance"]


def test_the_table_and_progress_are_for_people(reported):
    done, _, _ = reported
    assert "far hits keep their bits" in done.stdout and "4 passed, 0 failed, 0 skipped; 3 cases" in done.stdout
    assert "[1/4" in done.stderr and "[1/4" not in done.stdout


def test_the_page_stands_alone(reported):
    _, report, page = reported
    assert page.startswith("<!doctype html>") and "prefers-color-scheme: dark" in page
    assert not any(each in page for each in ("http://", "https://", "<script", "<link", "src="))
    assert all(each["name"] in page for each in report["cases"]) and report["versions"]["warp"] in page


def test_json_alone_on_standard_output():
    done = stability("--only", "sums of 2^31", "--device", "cpu", "--json")
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    assert done.returncode == 0 and [each["name"] for each in json.loads(done.stdout)["cases"]] == [
        "sums of 2^31 samples"
    ]


def test_a_case_that_fails_is_reported_and_is_the_exit_code(tmp_path):
    """One case's bound is made impossible, another raises; both are in the report."""
    before = HIDE_BPY + (
        f"\nimport sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "from tests.stability.case import Outcome, case\n"
        "case('made to fail', 'made', 'About the case that is made to fail.', 'no bound at all')(lambda bench: "
        "Outcome(float('nan'), 1.0, 0.5, 'as intended'))\n"
        "case('made to raise', 'made', 'About the case that is made to raise.', 'no bound at all', "
        "traces=False)(lambda bench: 1 / 0)\n"
    )
    done = run_script("stability.py", "--only", "made", "--device", "cpu", "--json", tmp_path / "r.json", before=before)
    assert done.returncode == 1
    assert "0 passed, 3 failed" in done.stdout and "as intended" in done.stdout and "ZeroDivisionError" in done.stdout
    cases = json.loads((tmp_path / "r.json").read_text())["cases"]
    assert [(each["tracer"], each["passed"], each["measured"]) for each in cases] == [
        ("off", False, None),
        ("on", False, None),
        ("-", False, None),
    ]


def test_cases_are_listed_without_being_run():
    done = stability("--list", "--quick")
    assert done.returncode == 0
    assert [line.split("  ")[1] for line in done.stdout.splitlines()] == [
        each.name for each in chosen_cases(quick=True)
    ]


def test_what_cannot_be_is_one_line(tmp_path):
    assert "no case is called 'no such case'" in error_line(stability("--only", "no such case"))
    assert "cannot be written" in error_line(stability(*FEW, "--json", tmp_path))
    folder = tmp_path / "new"
    assert "device" in error_line(stability("--only", "sums of", "--device", "cuda:99", "--html", folder / "page.html"))
    assert not folder.exists()


def test_rays_of_leaks_are_as_many_as_are_asked_for(tmp_path):
    done = stability(
        "--only",
        "leaks: icosphere",
        "--tracer",
        "off",
        "--device",
        "cpu",
        "--leak-rays",
        "1e5",
        "--json",
        tmp_path / "r.json",
    )
    if "wp_compile_cpp" in done.stderr:
        pytest.skip("this machine cannot compile kernels for the CPU")
    (result,) = json.loads((tmp_path / "r.json").read_text())["cases"]
    assert done.returncode == 0 and result["passed"] and result["note"].startswith("100,000 rays")
    assert "family leaks" in error_line(stability(*FEW, "--leak-rays", "1000"))
    for wrong in ("0", "1.5", "many", "1e12", "nan"):
        assert "not a whole number from 1" in stability(*FEW, "--leak-rays", wrong).stderr


def test_a_missing_folder_of_scenes_is_a_skip(tmp_path):
    done = stability("--only", "hotel room", "--device", "cpu", "--json", tmp_path / "r.json", RAYBATCH_SCENES=tmp_path)
    assert done.returncode == 0 and "0 passed, 0 failed, 2 skipped" in done.stdout and "RAYBATCH_SCENES" in done.stdout
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["cases"] == [] and {each["name"] for each in report["skipped"]} == {"hotel room"}


def test_the_manual_is_up_to_date():
    from stability_report.manual import manual, with_table

    from tests.stability.cases import all_cases

    path = manual(ROOT)
    text = path.read_text(encoding="utf-8")
    assert with_table(text, all_cases()) == text, "run python scripts/stability.py --table"


def test_no_script_stands_for_a_package_of_the_tests():
    """Both folders are in pytest's path: a name in both would be whichever was imported first."""
    at_root = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert not at_root & {path.stem for path in (ROOT / "scripts").iterdir()}


def test_cases_are_found_whichever_files_are_named_first():
    """The other order is that of the whole suite."""
    files = ("tests/stability/test_cases.py", "tests/scripts/test_stability_cli.py")
    done = run_python("import pytest, sys; sys.exit(pytest.main(sys.argv[1:]))", "--collect-only", "-q", *files)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"{file}: " in done.stdout for file in files)


def test_no_test_changes_the_path():
    """pyproject.toml says where pytest looks."""
    for path in (ROOT / "tests").rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        changed = [
            node.lineno
            for node in nodes
            if isinstance(node, ast.Attribute) and ast.unparse(node) in ("sys.path.insert", "sys.path.append")
        ]
        assert not changed, f"{path} changes sys.path in line {changed[0]}"
