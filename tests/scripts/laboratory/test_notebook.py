"""The notebook of the laboratory runs from top to bottom, with smaller figures than a reader's."""

import json
from pathlib import Path

import pytest
from docs_site.staging import text_of, with_links_within

from tests.support.command_line import ROOT

NOTEBOOK = ROOT / "docs/laboratory.ipynb"
# What takes time there, and what the test takes instead
SMALLER = {
    "room(128, 96)": "room(16, 12)",
    "sample_count=8, bounce_max=3": "sample_count=2, bounce_max=1",
    "ray_count=5000": "ray_count=200",
    '"turns": 2': '"turns": 1',
    '"AUTO"': '"cpu"',
    "[2048, 8192]": "[256, 512]",
}


def test_the_notebook_runs_from_top_to_bottom(monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(NOTEBOOK.parent)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells)
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    for old in SMALLER:
        assert any(old in each for each in code), f"the notebook has no {old} any more"
    assert sum(bool(line.strip()) for source in code for line in source.splitlines()) <= 30, "it is to stay short"
    names: dict = {}
    for source in code:
        for old, new in SMALLER.items():
            source = source.replace(old, new)
        exec(compile(source, NOTEBOOK.name, "exec"), names)
    assert (names["out"] / "rays-alive.png").stat().st_size > 0
    assert {result["faults"] for result in names["results"]} == {0} and len(names["results"]) == 9
    assert len(names["rows"]) == 4 and len({row["film"] for row in names["rows"]}) == 1
    assert "equal bit for bit" in capsys.readouterr().out


def test_the_site_shows_the_notebook_as_a_page():
    text = text_of(NOTEBOOK)
    linked = with_links_within("[a](../laboratory.ipynb)", Path("studies/own.md"), Path("docs/studies/own.md"))
    assert linked == "[a](../laboratory.md)"
    assert text.startswith("# The laboratory\n") and text.count("```python\n") == text.count("\n```\n") == 6
