"""Files come whole or not at all, and one process at a time owns one."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from raybatch_addon.core.files import OWNER, VOLUMES_PREFIX, remove_if_left, sole_owner, temporary_folder, whole_file
from tests.support.command_line import ROOT


def names(folder):
    return sorted(each.name for each in folder.iterdir())


def test_a_file_is_there_when_the_block_ends(tmp_path):
    path = tmp_path / "made.json"
    path.write_text("before")
    with whole_file(path) as temporary:
        temporary.write_text("after")
        assert path.read_text() == "before"
        assert temporary.parent == tmp_path and temporary.suffix == ".json"
    assert path.read_text() == "after" and names(tmp_path) == ["made.json"]


def test_a_block_that_fails_leaves_what_was_there(tmp_path):
    path = tmp_path / "made.json"
    path.write_text("before")
    with pytest.raises(ValueError, match="half"), whole_file(path) as temporary:
        temporary.write_text("af")
        raise ValueError("half")
    assert path.read_text() == "before" and names(tmp_path) == ["made.json"]


def test_errors_of_the_file_system_are_raised_as_they_are(tmp_path):
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "nowhere" / "made.json") as temporary:
        temporary.write_text("after")
    (tmp_path / "taken").mkdir()
    with pytest.raises(IsADirectoryError), whole_file(tmp_path / "taken") as temporary:
        temporary.write_text("after")
    assert names(tmp_path) == ["taken"]


def test_two_files_of_one_name_do_not_meet_on_the_way(tmp_path):
    path = tmp_path / "made.json"
    with whole_file(path) as first, whole_file(path) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert path.read_text() == "first"


def test_a_file_has_the_rights_of_any_new_one(tmp_path):
    (tmp_path / "plain").write_text("")
    with whole_file(tmp_path / "made") as temporary:
        temporary.write_text("")
    assert (tmp_path / "made").stat().st_mode == (tmp_path / "plain").stat().st_mode


COUNT = """
import sys
from pathlib import Path
from raybatch_addon.core.files import sole_owner
folder = Path(sys.argv[1])
for _ in range(200):
    with sole_owner(folder / "lock"):
        number = int((folder / "number").read_text())
        (folder / "number").write_text(str(number + 1))
"""


def test_one_process_and_one_thread_at_a_time_owns_a_file(tmp_path):
    (tmp_path / "number").write_text("0")
    processes = [subprocess.Popen([sys.executable, "-c", COUNT, str(tmp_path)], cwd=ROOT) for _ in range(2)]

    def count(_):
        with sole_owner(tmp_path / "lock"):
            (tmp_path / "number").write_text(str(int((tmp_path / "number").read_text()) + 1))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(count, range(200)))
    assert [process.wait() for process in processes] == [0, 0]
    assert (tmp_path / "number").read_text() == "600"


def test_a_temporary_folder_is_held_as_long_as_its_block(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(ValueError, match="half"), temporary_folder(VOLUMES_PREFIX) as folder:
        assert folder.parent == tmp_path and folder.name.startswith(VOLUMES_PREFIX)
        assert remove_if_left(folder) and folder.exists()
        raise ValueError("half")
    assert names(tmp_path) == []
    folder = tmp_path / f"{VOLUMES_PREFIX}x"
    folder.mkdir()
    assert not remove_if_left(folder) and folder.exists(), "nobody tells whose it is"
    (folder / OWNER).touch()
    assert remove_if_left(folder) and not folder.exists()


def test_a_temporary_folder_goes_without_locks_too(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("raybatch_addon.core.files.lock_now", lambda _path: None)
    with temporary_folder(VOLUMES_PREFIX) as folder:
        assert names(tmp_path) == [folder.name]
    assert names(tmp_path) == []
