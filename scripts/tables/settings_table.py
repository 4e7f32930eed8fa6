"""Write the tables of settings and presets in docs/tuning.md: python scripts/tables/settings_table.py [--check]

They are made from the metadata of `RenderSettings`, as the panel and the command line are. With --check nothing is
written, and the exit code is 1 where the file is not up to date.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.core.settings.settings import BYTES, GROUPS, SETTINGS, SettingInfo
from tables.marked_text import with_part, write_or_check

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


def _meaning(info: SettingInfo) -> str:
    lines = [f"{info.description}."]
    lines += [f"`{identifier}`: {_continued(about)}." for identifier, _, about in info.choices]
    return "<br>".join(lines)


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def settings_tables() -> str:
    """A section for each group of settings."""
    lines = []
    for name, group in GROUPS.items():
        lines += [f"### {group.label}", "", group.description, ""]
        lines += [_row(["setting", "in the panel", "values", "default", "meaning"]), "|---|---|---|---|---|"]
        for info in SETTINGS.values():
            if info.group == name:
                lines.append(_row([f"`{info.name}`", info.label, _values(info), f"`{info.default}`", _meaning(info)]))
        lines.append("")
    return "\n".join(lines).rstrip()


def presets_table() -> str:
    """What each preset sets to other than the default."""
    lines = [_row(["preset", "meaning", "other than the defaults"]), "|---|---|---|"]
    for name, preset in PRESETS.items():
        changed = [
            f"`{each}={value}`" for each, value in preset_settings(name).items() if value != SETTINGS[each].default
        ]
        lines.append(_row([f"`{name}`", f"{preset.description}.", ", ".join(changed) or "nothing"]))
    return "\n".join(lines)


def updated(text: str) -> str:
    """The manual `text` with both parts as they are now; raises `ValueError` where a mark is missing."""
    for part, made in zip(PARTS, (settings_tables(), presets_table()), strict=True):
        text = with_part(text, *_marks(part), made, MANUAL)
    return text


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(MANUAL, updated, "scripts/tables/settings_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
