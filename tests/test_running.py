"""How tests are run: long files first, under names of their own."""

import json
from collections import Counter

from tests.support.command_line import ROOT
from tests.support.running import file_seconds


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
