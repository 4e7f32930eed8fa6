"""How tests are run: one build of each kernel for all processes, long files first."""

import json
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

from tests.support.command_line import ROOT
from tests.support.running import file_seconds
from tests.support.running.kernel_builds import sole_owner

COUNT = """
import sys
from pathlib import Path
from tests.support.running.kernel_builds import sole_owner
folder = Path(sys.argv[1])
for _ in range(200):
    with sole_owner(folder / "lock"):
        number = int((folder / "number").read_text())
        (folder / "number").write_text(str(number + 1))
"""


def test_one_process_and_one_thread_at_a_time_builds_a_kernel(tmp_path):
    (tmp_path / "number").write_text("0")
    processes = [subprocess.Popen([sys.executable, "-c", COUNT, str(tmp_path)], cwd=ROOT) for _ in range(2)]

    def count(_):
        with sole_owner(tmp_path / "lock"):
            (tmp_path / "number").write_text(str(int((tmp_path / "number").read_text()) + 1))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(count, range(200)))
    assert [process.wait() for process in processes] == [0, 0]
    assert (tmp_path / "number").read_text() == "600"


def test_seconds_are_known_by_name_and_kept_for_files_that_are_there(tmp_path, monkeypatch):
    stored = tmp_path / "seconds.json"
    stored.write_text('{"test_running.py": 1.5, "test_of_old.py": 3.0}')
    monkeypatch.setattr(file_seconds, "STORED", stored)
    file_seconds.stored_seconds.cache_clear()
    try:
        assert file_seconds.file_seconds("tests/anywhere/test_running.py") == 1.5
        assert file_seconds.file_seconds("test_never_timed.py") == file_seconds.UNKNOWN
        file_seconds.store({"test_architecture.py": 2.04})
        assert json.loads(stored.read_text()) == {"test_architecture.py": 2.0, "test_running.py": 1.5}
    finally:
        file_seconds.stored_seconds.cache_clear()


def test_files_of_tests_have_names_of_their_own():
    """Their seconds are kept by name, and decide whether `make check` runs them."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []
