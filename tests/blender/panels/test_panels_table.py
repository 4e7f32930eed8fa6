"""The manual's pages of panels are made from the panels and the settings."""

import pytest

pytest.importorskip("bpy")

from tables import panels_table

from raybatch_addon.core.settings.settings import GROUPS, SETTINGS

pytestmark = pytest.mark.usefixtures("addon")


def test_the_manual_is_up_to_date():
    assert panels_table.main(["--check"]) == 0, "run python scripts/tables/panels_table.py"


def test_every_setting_is_on_one_page():
    pages = {name: panels_table.page_part(name) for name in panels_table.PAGES}
    for info in SETTINGS.values():
        group = GROUPS[info.group]
        page = pages[(group.parent or info.group).lower()]
        assert page.count(f"- **{info.label}**: ") >= 1
        assert all(f"  - *{label}*: " in page for _, label, _ in info.choices if not info.is_switch)


def test_every_panel_of_the_render_tab_is_listed():
    text = panels_table.list_part()
    for panel in panels_table.panels():
        assert panel.bl_label in text
    for name in panels_table.PAGES:
        assert f"]({panels_table.page_name(name)})" in text


def test_a_page_that_is_not_up_to_date_is_found_and_mended(tmp_path, monkeypatch, capsys):
    for page in panels_table.FOLDER.iterdir():
        (tmp_path / page.name).write_text(page.read_text(encoding="utf-8"), encoding="utf-8")
    whole = (tmp_path / "sampling.md").read_text(encoding="utf-8")
    (tmp_path / "sampling.md").write_text(whole.replace("**Samples**", "**Paths**"), encoding="utf-8")
    monkeypatch.setattr(panels_table, "FOLDER", tmp_path)
    assert panels_table.main(["--check"]) == 1 and "sampling.md is not up to date" in capsys.readouterr().err
    assert panels_table.main([]) == 0 and (tmp_path / "sampling.md").read_text(encoding="utf-8") == whole
