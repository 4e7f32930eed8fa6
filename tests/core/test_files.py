"""Files come whole or not at all."""

import pytest

from raybatch_addon.core.files import whole_file


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
