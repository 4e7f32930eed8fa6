"""Write what panels hold into the manual, docs/manual/panels: python scripts/tables/panels_table.py [--check]

It is made from the panels that the add-on registers, the metadata of `RenderSettings`, and the properties of the other
panels; so it needs Blender's module bpy. Each page has its own words around the part that is made here, between marks.
With --check nothing is written, and the exit code is 1 where a page is not up to date.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import bpy

import raybatch_addon
from raybatch_addon.core.settings.settings import BYTES, GROUPS, SETTINGS, SettingInfo
from raybatch_addon.ui.checkpoint import RayBatchCheckpoint
from raybatch_addon.ui.convergence.properties import RayBatchConvergence
from raybatch_addon.ui.panel import EnginePanel
from raybatch_addon.ui.viewport import RayBatchViewport
from tables.marked_text import list_item, with_part, write_or_check

FOLDER = ROOT / "docs/manual/panels"
LIST = "README.md"  # of all panels
FIRST, LAST = "<!-- panel: made by scripts/tables/panels_table.py -->", "<!-- end of panel -->"
# Pages of panels of the render tab, by the panel's name, and the properties of those that no group of settings is
PAGES = {
    "device": None,
    "sampling": None,
    "denoising": None,
    "light_paths": None,
    "film": None,
    "checkpoint": RayBatchCheckpoint,
    "viewport": RayBatchViewport,
    "performance": None,
    "batching": None,
    "before_render": None,
    "last_render": None,
    "cluster": None,
    "compare": None,
    "convergence": RayBatchConvergence,
}
_PREFIX = "RAYBATCH_RENDER_PT_"
# Pages of panels that show properties of Blender's and Cycles', by how the panels' classes are called: all in words
WRITTEN_PAGES = {
    "RAYBATCH_RENDER_PT_curves": "curves.md",
    "RAYBATCH_RENDER_PT_motion_blur": "motion-blur.md",
    "RAYBATCH_VIEWLAYER_": "view-layer.md",
    "RAYBATCH_WORLD_": "world.md",
    "RAYBATCH_OBJECT_": "object.md",
    "RAYBATCH_LIGHT_": "light.md",
    "RAYBATCH_CAMERA_": "camera.md",
    "RAYBATCH_MATERIAL_": "material.md",
}
_TABS = {
    "render": "Render",
    "view_layer": "View Layer",
    "world": "World",
    "object": "Object",
    "data": "Data (camera or light)",
    "material": "Material",
}
_UNITS = {"relMSE": "", "relative": "", "of rays alive": "of Rays Alive", BYTES: "(megabytes)"}
_OF_EVERY_GROUP = ("rna_type", "name")  # properties
_LARGE = 2**31 - 1  # from here on a range is written without its end


def panels() -> list[type[bpy.types.Panel]]:
    """The add-on's own panels, those of a group of settings in the order of the groups, the others by name. The add-on
    is registered for it, where it is not.
    """
    if not hasattr(bpy.types, f"{_PREFIX}device"):
        raybatch_addon.register()
    found = [each for each in _below(EnginePanel) if getattr(each, "is_registered", False)]
    return sorted((each for each in found if not str(each.__doc__).startswith("As Blender's own")), key=_place)


def _place(panel: type[bpy.types.Panel]) -> tuple:
    name = panel.__name__.removeprefix(_PREFIX)
    within = getattr(panel, "bl_parent_id", "").removeprefix(_PREFIX)
    pages, groups = [*PAGES], [each.lower() for each in GROUPS]
    page = next((pages.index(each) for each in (name, within) if each in PAGES), len(pages))
    return page, within != "", groups.index(name) if name in groups else len(groups), panel.__name__


def _below(kind: type[bpy.types.Panel]) -> Iterator[type[bpy.types.Panel]]:
    for each in kind.__subclasses__():
        yield each
        yield from _below(each)


def page_name(panel: str) -> str:
    """The file of the page about the panel of the render tab called so, in classes."""
    return f"{panel.replace('_', '-')}.md"


def written_page(panel: type[bpy.types.Panel]) -> str | None:
    """The page that describes `panel` in words, if one does."""
    return next((page for name, page in WRITTEN_PAGES.items() if panel.__name__.startswith(name)), None)


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:,g}"


def _values(info: SettingInfo) -> str:
    """What a number may be, and what it is at first."""
    unit = _UNITS.get(info.unit, info.unit)
    scale = 1e6 if info.unit == BYTES else 1
    least, most = (int(each) if info.kind is int and scale == 1 else each / scale for each in info.range)
    if info.auto is not None and info.kind is int:
        at_first = "At first *Auto*"
        least = info.least or info.multiple if least == info.auto and info.unit != BYTES else least
    elif info.off is not None and info.default == info.off:
        at_first = "At first off" if info.unit == BYTES else "At first without a limit"
    else:
        at_first = f"At first {_number(info.default)}"
    bounds = (
        f"{_number(least)} or more"
        if most * scale >= _LARGE or info.range[1] >= 1e9
        else f"{_number(least)} to {_number(most)}"
    )
    return f"{at_first}; {bounds} {unit}".rstrip() + "."


def _setting(info: SettingInfo) -> list[str]:
    """A setting as an item of a list, with its choices below it."""
    about = f"**{info.label}**: {info.panel_description}."
    if info.is_switch:
        meaning = next(each[2] for each in info.choices if each[0] == "ON")
        return list_item(f"{about} On: {meaning}. At first {info.default.lower()}.")
    if info.choices:
        label = next(label for identifier, label, _ in info.choices if identifier == info.default)
        lines = list_item(f"{about} At first *{label}*.")
        for _, label, meaning in info.choices:
            lines += list_item(f"*{label}*: {meaning}.", "  ")
        return lines
    return list_item(about if info.kind is str else f"{about} {_values(info)}")


def _property(found: bpy.types.Property) -> list[str]:
    """A property of Blender as an item of a list."""
    text = f"**{found.name}**: {found.description}."
    if found.type == "BOOLEAN":
        text += f" At first {'on' if found.default else 'off'}."
    elif found.type in ("INT", "FLOAT"):
        text += f" At first {found.default:g}{' seconds' if found.unit == 'TIME_ABSOLUTE' else ''}."
    return list_item(text)


def page_part(name: str) -> str:
    """What the panel called `name` holds, and those within it."""
    there = {each.__name__: each for each in panels()}
    lines = _panel_lines(there[_PREFIX + name], PAGES[name])
    for each in there.values():
        if getattr(each, "bl_parent_id", "") == _PREFIX + name:
            lines += ["", f"## {each.bl_label}", "", *_panel_lines(each, None)]
    return "\n".join(lines).strip()


def _panel_lines(panel: type[bpy.types.Panel], group: type[bpy.types.PropertyGroup] | None) -> list[str]:
    lines = [str(panel.__doc__), ""]
    own = panel.__name__.removeprefix(_PREFIX).upper()
    for info in SETTINGS.values():
        if info.group == own and own in GROUPS:
            lines += _setting(info)
    for found in group.bl_rna.properties if group else ():
        if found.identifier not in _OF_EVERY_GROUP:
            lines += _property(found)
    return lines


def list_part() -> str:
    """A table of all panels, by tab."""
    lines = ["| tab | panel | what it is for |", "|---|---|---|"]
    found = panels()
    labels = {each.__name__: each.bl_label for each in found}
    for tab, title in _TABS.items():
        for each in found:
            if each.bl_context != tab:
                continue
            parent = getattr(each, "bl_parent_id", "")
            if parent and not parent.startswith("RAYBATCH"):
                kind = getattr(bpy.types, parent, None)
                labels[parent] = getattr(kind, "bl_label", "") or "Blender's own panel"
            name = each.__name__.removeprefix(_PREFIX)
            page = page_name(name) if tab == "render" and name in PAGES else written_page(each)
            text = f"[{each.bl_label}]({page})" if page else each.bl_label
            lines.append(f"| {title} | {f'{labels[parent]} > ' if parent else ''}{text} | {each.__doc__} |")
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """The exit code."""
    parts = {LIST: list_part()} | {page_name(name): page_part(name) for name in PAGES}
    codes = []
    for name, made in parts.items():
        page = FOLDER / name

        def updated(text: str, made=made, page=page) -> str:
            return with_part(text, FIRST, LAST, made, page)

        codes.append(write_or_check(page, updated, "scripts/tables/panels_table.py", arguments))
    return max(codes)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
