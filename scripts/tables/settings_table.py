"""Write the settings and presets in docs/tuning.md: python scripts/tables/settings_table.py [--check]

They are made from the metadata of `RenderSettings`, as the panel and the command line are. With --check nothing is
written, and the exit code is 1 where the file is not up to date.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.core.settings.settings import BYTES, GROUPS, SETTINGS, SettingInfo
from tables.marked_text import list_item, with_part, write_or_check

MANUAL = ROOT / "docs/tuning.md"
# what is made here, by the names of the marks around it
PARTS = ("settings", "presets")


def _marks(part: str) -> tuple[str, str]:
    return f"<!-- {part}: made by scripts/tables/settings_table.py -->", f"<!-- end of {part} -->"


def _values(info: SettingInfo) -> str:
    """The legal values and their unit."""
    if info.choices:
        return ", ".join(f"`{identifier}`" for identifier, _, _ in info.choices)
    text = info.range_text()
    if info.maximum in (2**62, 2**31 - 1):
        text = text.replace(str(info.maximum), "2^62" if info.maximum == 2**62 else "2^31 - 1")
    unit = f" {info.unit}" if info.unit else ""
    return text + (f"{unit}, or with a unit: `1.5G`, `512Mi`" if info.unit == BYTES else unit)


def _continued(sentence: str) -> str:
    """`sentence` behind a colon; words in capitals stay."""
    return sentence[0].lower() + sentence[1:] if sentence[1:2].islower() or sentence[1:2] == " " else sentence


def _choices(infos: Iterable[SettingInfo]) -> list[str]:
    """What the values of those settings mean that have choices; no lines where none has."""
    lines = []
    for info in infos:
        if info.choices:
            lines.append(f"- `{info.name}`")
            for identifier, _, about in info.choices:
                lines += list_item(f"`{identifier}`: {_continued(about)}.", "  ")
    return ["", "What the values mean:", "", *lines] if lines else []


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def settings_tables() -> str:
    """A section for each group of settings."""
    lines = []
    for name, group in GROUPS.items():
        lines += [f"### {group.label}", "", group.description, ""]
        infos = [info for info in SETTINGS.values() if info.group == name]
        if not infos:  # they are in the groups below it
            continue
        lines += [_row(["setting", "in the panel", "values", "default", "meaning"]), "|---|---|---|---|---|"]
        for info in infos:
            cells = [f"`{info.name}`", info.label, _values(info), f"`{info.default}`", f"{info.description}."]
            lines.append(_row(cells))
        lines += [*_choices(infos), ""]
    return "\n".join(lines).rstrip()


def presets_list() -> str:
    """What each preset sets to other than the default."""
    lines = []
    for name, preset in PRESETS.items():
        values = preset_settings(name).items()
        changed = [f"`{each}={value}`" for each, value in values if value != SETTINGS[each].default]
        if preset.changes_picture:
            reported = f"Sets {', '.join(f'`{each}={value}`' for each, value in values)}"
        else:
            reported = f"Other than the defaults: {', '.join(changed) or 'nothing'}"
        lines += list_item(f"`{name}`: {preset.description}. {reported}.")
    return "\n".join(lines)


def updated(text: str) -> str:
    """The manual `text` with both parts as they are now; raises `ValueError` where a mark is missing."""
    for part, made in zip(PARTS, (settings_tables(), presets_list()), strict=True):
        text = with_part(text, *_marks(part), made, MANUAL)
    return text


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(MANUAL, updated, "scripts/tables/settings_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
