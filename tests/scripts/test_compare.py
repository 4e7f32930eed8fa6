"""scripts/compare.py without Blender: its processes, what it keeps, and what it says of bad files."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from compare import main
from real_files import code, comparison, manual, records
from real_files.listing import RealFile, files_named, may_be_shown, read_listing
from real_files.process import COLD, CRASHED, DONE, FAILED, TIMED_OUT, ProcessOutcome, run_process
from real_files.tables import alike
from real_files.worker import PICTURES

from tests.support.command_line import HIDE_BPY, ROOT, error_line, run_script
from tests.support.scripts_here import call_script

BLEND = b"BLENDER-v500"


# --- processes

STUB = """
import json, os, sys, time
from pathlib import Path
folder = Path(sys.argv[2]).parent
state = {"doing": "open", "steps": [{"name": "open", "seconds": 0.1}], "error": ""}
(folder / "steps.json").write_text(json.dumps(state))
"""


@pytest.mark.parametrize(
    "end, status, part",
    [
        ("time.sleep(60)", TIMED_OUT, "in the step “open”, which took more than 2 s: raise --limit"),
        ("os.abort()", CRASHED, "signal 6 (SIGABRT) in the step “open” of Cycles; it said last: going down"),
        (
            "state['error'] = 'no camera'; (folder / 'steps.json').write_text(json.dumps(state)); sys.exit(1)",
            FAILED,
            "no camera",
        ),
        ("pass", DONE, ""),
    ],
)
def test_what_becomes_of_a_process_is_reported_and_its_steps_are_kept(tmp_path, end, status, part):
    script = tmp_path / "stub.py"
    script.write_text(f"{STUB}\nprint('going down', flush=True)\n{end}\n")
    outcome = run_process(script, {"engine": "CYCLES", "kind": PICTURES}, 2.0, None)
    assert outcome.status == status and part in outcome.error
    assert [each["name"] for each in outcome.state["steps"]] == ["open"]


@pytest.mark.parametrize("cache", [COLD, "warm"])
def test_each_file_begins_with_the_same_kernels(tmp_path, cache):
    warm = tmp_path / "warm"
    warm.mkdir()
    (warm / "kernel").write_text("")
    script = tmp_path / "stub.py"
    script.write_text(
        "import json, os, sys\nfrom pathlib import Path\nhere = Path(os.environ['RAYBATCH_KERNEL_CACHE'])\n"
        "found = [each.name for each in here.iterdir()]\n(here / 'new').write_text('')\n"
        "Path(sys.argv[2]).with_name('steps.json').write_text(json.dumps({'steps': [], 'found': found}))\n"
    )
    for _ in range(2):
        outcome = run_process(script, {"engine": "RAYBATCH"}, 20.0, COLD if cache == COLD else str(warm))
        assert outcome.state["found"] == ([] if cache == COLD else ["kernel"])


def test_a_worker_ends_when_nobody_waits_for_it_any_more(tmp_path):
    scripts = str(ROOT / "scripts")
    here, script = tmp_path / "pid", tmp_path / "stub.py"
    script.write_text(
        f"import os, sys, time\nfrom pathlib import Path\nsys.path[:0] = [{str(ROOT)!r}, {scripts!r}]\n"
        "from real_files.worker import end_with_the_caller\nend_with_the_caller()\n"
        f"Path({str(here)!r}).write_text(str(os.getpid()))\ntime.sleep(100)\n"
    )
    caller = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"import sys; from pathlib import Path; sys.path[:0] = [{str(ROOT)!r}, {scripts!r}]\n"
            "from real_files.process import run_process\n"
            f"run_process(Path({str(script)!r}), {{'engine': 'CYCLES'}}, 100.0, None)",
        ]
    )
    _wait_until(lambda: here.exists() and here.read_text())
    worker = int(here.read_text())
    caller.kill()
    caller.wait()
    _wait_until(lambda: not _is_running(worker))


def _wait_until(done) -> None:
    for _ in range(600):
        if done():
            return
        time.sleep(0.1)
    raise AssertionError("it did not come to that within a minute")


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


# --- what is kept


@pytest.fixture
def rendered(monkeypatch):
    """Processes that only tell which they are; RayBatch's fails while `failing` is set."""
    calls = []

    def run(script, request, limit, kernel_cache):
        calls.append(f"{request['engine']} {Path(request['file']).name}")
        if request["engine"] == "RAYBATCH" and run.failing:
            return ProcessOutcome(CRASHED, error="it crashed")
        images = {
            f"all-{seed}": np.full((16, 16, 4), 0.5 + seed * 1e-3 * (len(calls) % 3), np.float32) for seed in (1, 2)
        }
        steps = [
            {"name": name, "seconds": 0.5, "warnings": ["volume “fog” is left out"]} for name in ("first", "all-2")
        ]
        return ProcessOutcome(DONE, {"steps": steps, "versions": {"RayBatch": "1"}}, pictures=images)

    run.failing = False
    run.calls = calls
    monkeypatch.setattr(comparison, "run_process", run)
    return run


@pytest.fixture
def blends(tmp_path):
    """Two files that begin as a .blend does."""
    paths = [tmp_path / name for name in ("a.blend", "b.blend")]
    for path in paths:
        path.write_bytes(BLEND + path.name.encode())
    return [str(path) for path in paths]


def report_in(folder: Path) -> dict:
    return json.loads((folder / "results.json").read_text())


def test_a_second_run_renders_what_is_missing_or_failed_and_no_more(rendered, blends, tmp_path):
    out = tmp_path / "out"
    rendered.failing = True
    assert main([*blends[:1], "--out", str(out)]) == 1
    (row,) = report_in(out)["files"]
    assert row["verdict"] == "not compared" and row["errors"] == ["it crashed"]
    rendered.failing = False
    rendered.calls.clear()
    assert main([*blends, "--out", str(out)]) == 0
    assert rendered.calls == ["RAYBATCH a.blend", "CYCLES b.blend", "RAYBATCH b.blend"]
    assert [row["verdict"] for row in report_in(out)["files"]] == ["same", "same"]
    assert report_in(out)["files"][0]["left_out"] == ["volume “fog” is left out"]
    rendered.calls.clear()
    assert main([*blends, "--out", str(out)]) == 0 and not rendered.calls
    assert main([*blends[:1], "--out", str(out), "--again"]) == 0 and len(rendered.calls) == 2


def test_another_size_or_another_version_of_a_file_is_rendered_anew(rendered, blends, tmp_path):
    out = str(tmp_path / "out")
    main([*blends, "--out", out])
    rendered.calls.clear()
    main([*blends[:1], "--out", out, "--samples", "8"])
    assert len(rendered.calls) == 2
    assert len(report_in(tmp_path / "out")["files"]) == 1  # those of other samples are not mixed with it
    Path(blends[1]).write_bytes(BLEND + b"changed")
    rendered.calls.clear()
    main([blends[1], "--out", out, "--samples", "8"])
    assert rendered.calls == ["CYCLES b.blend", "RAYBATCH b.blend"]


def test_what_other_code_rendered_is_rendered_anew_and_shown_as_old_until_then(
    rendered, blends, tmp_path, monkeypatch, capfd
):
    out, root = tmp_path / "out", tmp_path / "root"
    (root / manual.LISTING).parent.mkdir(parents=True)
    (root / manual.LISTING).write_text('{"files": []}')
    monkeypatch.setattr("compare.ROOT", root)
    main([*blends, "--out", str(out)])
    assert report_in(out)["old"] == []
    codes = {"CYCLES": {"bpy": "1"}, "RAYBATCH": {"bpy": "1", "RayBatch": "abc"}}
    for module in (records, comparison):
        monkeypatch.setattr(module, "code_of", codes.__getitem__)
    main([*blends, "--out", str(out)])
    rendered.calls.clear()
    codes["RAYBATCH"] = {"bpy": "1", "RayBatch": "def"}
    assert main(["--out", str(out), "--table"]) == 0
    assert not rendered.calls and report_in(out)["old"] == ["a.blend", "b.blend"]
    reported = "were rendered by another state of RayBatch or Blender than that which tells of them here."
    assert f"All files {reported}" in capfd.readouterr().out and reported in (out / "report.html").read_text()
    assert main([*blends[:1], "--out", str(out)]) == 0 and rendered.calls == ["RAYBATCH a.blend"]
    said = capfd.readouterr()
    assert "a.blend: pictures by RayBatch are of other code (RayBatch abc, now def): rendered again" in said.err
    assert report_in(out)["old"] == ["b.blend"] and f"1 of 2 files (b.blend) {reported}" in said.out


def test_the_code_of_raybatch_is_all_of_the_add_on_and_cycles_does_not_depend_on_it(tmp_path, monkeypatch):
    ours, theirs = code.code_of("RAYBATCH"), code.code_of("CYCLES")
    assert set(ours) - set(theirs) == {"RayBatch", "Warp"} and all(ours[name] == theirs[name] for name in theirs)
    for name, content in (("a.py", "1"), ("b/c.h", "2"), ("b/table.npz", "3")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    monkeypatch.setattr(code.raybatch_addon, "__file__", str(tmp_path / "__init__.py"))
    digests = set()
    for name in ("a.py", "b/c.h", "b/table.npz", "picture.png"):
        (tmp_path / name).write_text("changed")
        code.code_of.cache_clear()
        digests.add(code.code_of("RAYBATCH")["RayBatch"])
    assert len(digests) == 3, "each source counts, and nothing else"
    code.code_of.cache_clear()
    assert code.what_changed(None, theirs) == "code that was not written down"


def test_pictures_of_an_extension_are_rendered_by_what_is_in_its_zip(rendered, blends, tmp_path, monkeypatch):
    addon, before, seen = tmp_path / "addon", code.code_of("RAYBATCH"), []
    (addon / "core").mkdir(parents=True)
    (addon / "__init__.py").write_text("mine")
    zipped, out = shutil.make_archive(str(tmp_path / "mine"), "zip", addon), tmp_path / "out"

    def run(script, request, *_):
        seen.append((script.parents[1] / "raybatch_addon/__init__.py").read_text())
        assert (script.parent / "real_files/worker.py").is_file()
        return rendered(script, request, *_)

    monkeypatch.setattr(comparison, "run_process", run)
    assert main([*blends[:1], "--out", str(out), "--extension", zipped]) == 0 and seen == ["mine", "mine"]
    assert report_in(out)["request"]["extension"].startswith("mine.zip (")
    assert main([*blends[:1], "--out", str(out), "--extension", zipped]) == 0 and len(seen) == 2, "nothing is missing"
    assert code.code_of("RAYBATCH") == before, "without the option the add-on is this folder's"


def test_a_damaged_record_is_rendered_anew(rendered, blends, tmp_path):
    out = tmp_path / "out"
    main([*blends, "--out", str(out)])
    (record,) = (out / "files").glob("a-blend-*.npz")
    record.write_bytes(b"half")
    rendered.calls.clear()
    assert main([*blends, "--out", str(out)]) == 0
    assert rendered.calls == ["CYCLES a.blend", "RAYBATCH a.blend"]


def test_the_page_stands_alone_and_shows_pictures(rendered, blends, tmp_path):
    main([*blends, "--out", str(tmp_path / "out")])
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2 and "volume “fog” is left out" in page and "equal error" in page


def test_what_is_alike_but_for_names_is_reported_once():
    texts = [f"material “m{i}” of “a”, “b” and {i} more: Filter Width (0.1 pixels instead)" for i in range(2, 5)]
    assert alike([*texts, "image “x” is magenta"]) == [f"{texts[0]} (2 more like it)", "image “x” is magenta"]


def test_results_do_not_reveal_where_files_lie(blends, tmp_path, monkeypatch):
    places = ProcessOutcome(FAILED, {"missing": [f"{tmp_path}/textures/wood.png"]}, f"{blends[0]} is bad")
    monkeypatch.setattr(comparison, "run_process", lambda *_: places)
    main([blends[0], "--out", str(tmp_path / "out")])
    (row,) = report_in(tmp_path / "out")["files"]
    assert row["errors"] == ["//a.blend is bad"] and row["missing"] == ["//textures/wood.png"]


# --- bad input


def test_bad_files_are_rows_that_name_the_thing_and_the_remedy(tmp_path):
    (tmp_path / "text.blend").write_text("hello")
    (tmp_path / "pointer.blend").write_text("version https://git-lfs.github.com/spec/v1\n")
    (tmp_path / "folder.blend").mkdir()
    names = ("none", "text", "pointer", "folder")
    done = call_script("compare.py", *(tmp_path / f"{name}.blend" for name in names), "--out", tmp_path / "out")
    assert done.returncode == 1
    for part in ("check the name", "is not a .blend file: save it", "`git lfs pull`", "is a folder: name the .blend"):
        assert part in done.stderr
    rows = report_in(tmp_path / "out")["files"]
    assert len(rows) == 4 and all(row["verdict"] == "not compared" and len(row["errors"]) == 1 for row in rows)


def test_without_bpy_every_row_says_so(blends, tmp_path):
    done = run_script("compare.py", blends[0], "--out", tmp_path / "out", before=HIDE_BPY, PYTHONPATH=_no_bpy(tmp_path))
    (row,) = report_in(tmp_path / "out")["files"]
    assert done.returncode == 1 and "no bpy in this Python: use the project's environment" in row["errors"][0]


def _no_bpy(folder: Path) -> Path:
    """A folder in which `bpy` cannot be imported."""
    (folder / "path").mkdir()
    (folder / "path" / "bpy.py").write_text("raise ModuleNotFoundError('no bpy here', name='bpy')\n")
    return folder / "path"


@pytest.mark.parametrize(
    "arguments, part",
    [
        ((), "name .blend FILEs"),
        (("--list", ROOT / "docs/real-files.json"), "--list needs --folder"),
        (("a.blend", "--only", "x"), "go with --list"),
        (("--list", "none.json", "--folder", "."), "cannot be read"),
        (("--list", ROOT / "docs/testing.json", "--folder", "."), "is no list of files"),
        (("--list", ROOT / "docs/real-files.json", "--folder", ".", "--only", "zzz"), "no file of"),
        (("a.blend", "--kernel-cache", "none"), "is no folder"),
        (("a.blend", "--extension", "none.zip"), "cannot be unpacked"),
        (("a.blend", "--extension", ROOT / "docs/testing.json"), "cannot be unpacked"),
        (("--table",), "render files first"),
    ],
)
def test_what_does_not_go_together_is_one_line(tmp_path, arguments, part):
    done = call_script("compare.py", *arguments, "--out", tmp_path / "out")
    assert part in error_line(done) and done.returncode == 1


def test_a_listed_file_that_is_missing_or_of_another_version_says_where_to_get_it(tmp_path):
    entry = {
        "repository": "some/one",
        "commit": "0123456789abcdef",
        "path": "in/it.blend",
        "md5": "0",
        "licence": "MIT",
    }
    file = RealFile(tmp_path / "it.blend", "some/one/in/it.blend", entry)
    assert "get in/it.blend of commit 0123456789ab of https://github.com/some/one" in file.complaint()
    file.path.write_bytes(BLEND)
    assert "is another version than the list means" in file.complaint()


def test_files_of_one_name_are_distinguished(tmp_path):
    names = [each.name for each in files_named(["x/room.blend", "y/room.blend", "hall.blend", "x/room.blend"])]
    assert names == ["x/room.blend", "y/room.blend", "hall.blend"]


# --- the manual


@pytest.mark.parametrize(
    "licence, shown",
    [("CC0-1.0", True), ("CC-BY-4.0", True), ("CC-BY-NC-4.0", False), ("not stated", False), ("MIT", False)],
)
def test_pictures_are_shown_only_where_the_licence_allows_it(licence, shown):
    assert may_be_shown({"licence": licence}) == shown


def test_the_manual_has_files_of_the_list_alone_and_pictures_of_those_that_may_be_shown(
    rendered, blends, tmp_path, monkeypatch
):
    folder = tmp_path / "some+one"
    folder.mkdir()
    entries = []
    for name, licence in (("free.blend", "CC-BY-4.0"), ("closed.blend", "not stated")):
        (folder / name).write_bytes(BLEND)
        md5 = RealFile(folder / name, name).md5()
        about = {"repository": "some/one", "commit": "0" * 40, "path": name, "md5": md5, "licence": licence}
        entries.append(about | {"credit": "by Some One", "finding": {"why": "There is fog."}})
    root = tmp_path / "root"
    (root / "docs").mkdir(parents=True)
    (root / manual.LISTING).write_text(json.dumps({"files": entries}))
    (root / "docs/real-files").mkdir()
    (root / "docs/real-files/gone.png").write_bytes(b"")
    monkeypatch.setattr("compare.ROOT", root)
    listed = ["--list", str(root / manual.LISTING), "--folder", str(tmp_path)]
    assert main([*blends, *listed, "--out", str(tmp_path / "out")]) == 0
    assert not (root / manual.PAGE).exists()
    assert main(["--out", str(tmp_path / "out"), "--table"]) == 0
    text = (root / manual.PAGE).read_text(encoding="utf-8")
    assert text == manual.stored_page(root) and "There is fog." in text and "by Some One" in text
    assert "a.blend" not in text and str(tmp_path) not in text
    (picture,) = (root / manual.FOLDER).glob("*.png")
    assert picture.name.startswith("some-one-free-blend-") and text.count("![") == 1


def test_the_list_names_each_file_once_and_gives_credit_where_pictures_are_shown():
    entries = read_listing(ROOT / manual.LISTING)
    assert len({(each["repository"], each["path"]) for each in entries}) == len(entries)
    assert all(len(each["md5"]) == 32 and len(each["commit"]) == 40 for each in entries)
    assert all(each.get("credit") for each in entries if may_be_shown(each))


def test_the_manual_is_that_of_its_results_and_shows_no_picture_without_a_licence():
    page = ROOT / manual.PAGE
    assert page.read_text(encoding="utf-8") == manual.stored_page(ROOT), (
        "docs/real-files.md is not up to date: run python scripts/compare.py --out DIR --table"
    )
    about = {f"{each['repository']}/{each['path']}": each for each in read_listing(ROOT / manual.LISTING)}
    rows = json.loads((ROOT / manual.FOLDER / "results.json").read_text())["files"]
    pictures = {row["picture"] for row in rows if "picture" in row}
    assert all(may_be_shown(about[row["name"]]) for row in rows if "picture" in row)
    assert {each.name for each in (ROOT / manual.FOLDER).glob("*.png")} == pictures
