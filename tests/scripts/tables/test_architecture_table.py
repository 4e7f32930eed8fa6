"""The architecture page names every room and file of the package, from what they say of themselves."""

import pytest
from tables import architecture_table
from tables.architecture_table import first_sentence, idea_of

from tests.test_architecture import FILES

MODULES = [path for path in FILES if (path.parent / "__init__.py").exists()]  # presets are values, in folders alone


def test_the_page_is_up_to_date():
    assert architecture_table.main(["--check"]) == 0, "run python scripts/tables/architecture_table.py"


def test_every_file_of_the_package_is_named_in_the_list_of_its_room():
    lists = architecture_table.files_list().split("<details><summary><code>")
    by_room = {text.split("</code>")[0]: text for text in lists}
    for path in MODULES:
        if path.name != "__init__.py":
            room = architecture_table._name(path.parent)
            assert by_room[room].count(f"\n- `{path.name}`: ") == 1, path


def test_headers_belong_to_the_nearest_room(tmp_path):
    room, inner = tmp_path / "native", tmp_path / "native/step"
    inner.mkdir(parents=True)
    (room / "__init__.py").touch()
    for path in (room / "vectors.h", inner / "ray.h", room / "build.py"):
        path.touch()
    assert architecture_table._files(room) == [room / "build.py", inner / "ray.h", room / "vectors.h"]


def test_a_row_for_each_room_in_the_order_of_imports():
    rows = [line.split("`")[1] for line in architecture_table.rooms_table().splitlines()[2:]]
    assert len(rows) == len(set(rows)) == len({path.parent for path in MODULES})
    assert rows.index("core/scene/") < rows.index("core/bvh/") < rows.index("core/wavefront/") < rows.index("export/")


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("One. Two.", "One."),
        ("Wide\nlines, of x.y and 1.5: here.\n\nMore.", "Wide lines, of x.y and 1.5: here."),
        ("No stop", "No stop"),
        ("", ""),
    ],
)
def test_the_first_sentence_of_a_docstring(text, first):
    assert first_sentence(text) == first


def test_native_headers_and_files_without_a_sentence(tmp_path):
    header = tmp_path / "step.h"
    header.write_text("// One step of a ray. It may\n// stop here.\n#define A 1\n", encoding="utf-8")
    assert idea_of(header) == "One step of a ray."
    silent = tmp_path / "silent.py"
    silent.write_text("x = 1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="silent.py does not say what it is"):
        idea_of(silent)


def test_a_page_that_is_not_up_to_date_is_found_and_mended(tmp_path, monkeypatch, capsys):
    whole = architecture_table.MANUAL.read_text(encoding="utf-8")
    copy = tmp_path / "architecture.md"
    monkeypatch.setattr(architecture_table, "MANUAL", copy)
    copy.write_text(whole.replace("| `core/film/` |", "| `core/foil/` |"), encoding="utf-8")
    assert architecture_table.main(["--check"]) == 1
    assert "run python scripts/tables/architecture_table.py" in capsys.readouterr().err
    assert architecture_table.main([]) == 0 and copy.read_text(encoding="utf-8") == whole
