"""The README's table of whole renders is made from the reports in docs/figures."""

import pytest
from tables import figures_table


def test_the_table_is_up_to_date():
    assert figures_table.main(["--check"]) == 0, "run python scripts/tables/figures_table.py"


def test_every_report_is_a_row_of_it():
    reports = list((figures_table.ROOT / "docs/figures").glob("render-*.json"))
    assert reports and len(figures_table.figures_table().splitlines()) == 2 + len(reports)


def test_a_table_that_is_not_up_to_date_is_found_and_mended(tmp_path, monkeypatch, capsys):
    whole = figures_table.MANUAL.read_text(encoding="utf-8")
    copy = tmp_path / "README.md"
    monkeypatch.setattr(figures_table, "MANUAL", copy)
    copy.write_text(whole.replace("| Dragon |", "| Wyvern |"), encoding="utf-8")
    assert figures_table.main(["--check"]) == 1
    assert "run python scripts/tables/figures_table.py" in capsys.readouterr().err
    assert figures_table.main([]) == 0 and copy.read_text(encoding="utf-8") == whole


def test_a_page_without_marks_is_not_passed_over(tmp_path, monkeypatch):
    copy = tmp_path / "README.md"
    monkeypatch.setattr(figures_table, "MANUAL", copy)
    copy.write_text("A page.\n", encoding="utf-8")
    with pytest.raises(ValueError, match="figures: made by"):
        figures_table.main([])
