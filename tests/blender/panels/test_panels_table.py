"""The manual's pages of panels are made from the panels and the settings."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from tables import panels_table

from raybatch_addon.core.settings.settings import GROUPS, SETTINGS
from tests.support.panel_layout import Layout, context_of

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


class Labels(Layout):
    """A layout that notes how properties are called in it, and the headings of their groups."""

    def column(self, heading="", **_options):
        if heading not in ("", "Include"):
            self.notes.append(heading)
        return Labels(self.notes, self)

    row = box = split = column

    def prop(self, owner, name, text=None, **_options):
        label = owner.bl_rna.properties[name].name if text is None else text
        if label:
            self.notes.append(label)

    def template_curve_mapping(self, owner, name):
        self.notes.append(owner.bl_rna.properties[name].name)

    def prop_search(self, _owner, _name, _source, _collection, text="", **_options):
        self.notes.append(text)


def labels_of(panel, context):
    """What properties are called in `panel`."""
    layout = Labels()
    panel.draw(SimpleNamespace(layout=layout), context)
    return [each for each in layout.notes if isinstance(each, str)]


def test_panels_of_other_tabs_have_a_section_with_each_property(scene):
    scene.camera.data.type = "PANO"
    context = context_of(
        scene,
        material=bpy.data.materials.new("Material"),
        world=scene.world or bpy.data.worlds.new("World"),
        light=bpy.data.lights.new("Lamp", "AREA"),
        camera=scene.camera.data,
    )
    scene.world = context.world
    for panel in panels_table.panels():
        page = panels_table.written_page(panel)
        if page is None:
            continue
        text = " ".join((panels_table.FOLDER / page).read_text(encoding="utf-8").split())
        before = "> " if hasattr(panel, "bl_parent_id") else "# "
        assert f"{before}{panel.bl_label} " in text, "a heading of its own"
        for context.object in (scene.camera, bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))):
            labels = labels_of(panel, context) if panel.poll(context) else []
            assert not [each for each in labels if f"*{each}*" not in text], panel.__name__


def test_a_page_that_is_not_up_to_date_is_found_and_mended(tmp_path, monkeypatch, capsys):
    for page in panels_table.FOLDER.iterdir():
        (tmp_path / page.name).write_text(page.read_text(encoding="utf-8"), encoding="utf-8")
    whole = (tmp_path / "sampling.md").read_text(encoding="utf-8")
    (tmp_path / "sampling.md").write_text(whole.replace("**Samples**", "**Paths**"), encoding="utf-8")
    monkeypatch.setattr(panels_table, "FOLDER", tmp_path)
    assert panels_table.main(["--check"]) == 1 and "sampling.md is not up to date" in capsys.readouterr().err
    assert panels_table.main([]) == 0 and (tmp_path / "sampling.md").read_text(encoding="utf-8") == whole
