"""scripts/testing/headless.py sees what is wrong: a program that stands in for Blender's has a fault."""

import json
import sys

import pytest
from testing import headless

PROGRAM = """#!{python}
import json, os, sys, time
FAULT = {fault!r}
end = sys.argv.index("--")
given, own = sys.argv[1:end], sys.argv[end + 1:]
if "--factory-startup" in given:
    for name in ("plain", "shared", "lacking", "blind"):
        open(own[-1] + "/" + name + ".blend", "w").close()
    print("MADE 9.9.9")
    raise SystemExit
option = lambda name, other: given[given.index(name) + 1] if name in given else other
if "-a" in given:
    frames = range(int(option("-s", 1)), int(option("-e", 3)) + 1, int(option("-j", 1)))
else:
    asked = option("-f", "1")
    first, _, last = asked.partition("..")
    frames = range(int(first), int(last) + 1) if last else [int(each) for each in asked.split(",")]
error = next((each for each in own if each in ("cuda:99", "sample_cuont=7")), "")
if not error:
    for frame in frames if FAULT != "the step" else range(frames[0], frames[-1] + 1):
        ending = ".png" if option("-x", "1") == "1" or FAULT == "the extension" else ""
        with open(option("-o", "").replace("####", "%04d" % frame) + ending, "wb") as file:
            file.write(b"\\x89PNG\\r\\n\\x1a\\n" if FAULT != "the picture" else b"")
    print("Fra: 1 | Sample 2/2 | Finished")
    if FAULT == "the lines":
        print("Fra: 2 | Sample 2/2 | Finished\\nFra: 30 | Sample 2/2 | Finished")
workers = int(option("-t", 0)) or os.cpu_count()
layer = {{"engine": "RayBatch", "schedule": {{"workers": 2 if FAULT == "the threads" else workers}}}}
print("RAYBATCH-STATISTICS " + json.dumps({{"errors": [], "layers": {{"ViewLayer": layer}}}}))
"""


@pytest.fixture
def tried(tmp_path, capfd):
    """Calls the script with a program that has a fault, and returns (exit code, what is wrong by check, output)."""

    def call(fault, *checks):
        program, report = tmp_path / "blender", tmp_path / "report.json"
        program.write_text(PROGRAM.format(python=sys.executable, fault=fault))
        program.chmod(0o755)
        only = [word for check in checks for word in ("--only", check)]
        code = headless.main(["--blender", str(program), "--folder", str(tmp_path), "--json", str(report), *only])
        printed = capfd.readouterr()
        assert report.exists(), printed.err
        rows = json.loads(report.read_text())["rows"]
        assert [row["name"] for row in rows] == list(checks)
        return code, {row["name"]: row["wrong"] for row in rows}, printed.out

    return call


GOOD = ("frames", "extensions", "animations", "threads")


def test_a_program_that_does_as_blender_passes(tried):
    code, wrong, printed = tried("", *GOOD)
    assert code == 0 and not any(wrong.values()), wrong
    assert "Blender 9.9.9" in printed and printed.count("| good |") == len(GOOD)


@pytest.mark.parametrize(
    "fault, check, words",
    [
        ("the step", "animations", "f_0003.png"),
        ("the extension", "extensions", "f_0001.png instead of f_0001"),
        ("the picture", "frames", "f_0001.png is no PNG"),
        ("the threads", "threads", "RayBatch has 2 threads instead of 1"),
        ("the lines", "lines of short frames", "two lines of progress come within 0.0 seconds"),
        ("the exit code", "wrong options", "the exit code is 0"),
        ("the exit code", "failed renders", "the exit code is 0"),
        ("the exit code", "refused renders", "the exit code is 0"),
    ],
)
def test_a_fault_is_named_and_the_exit_code_tells_it(tried, fault, check, words):
    code, wrong, printed = tried(fault, check)
    assert code == 1 and words in wrong[check], wrong
    assert "WRONG: " in printed
