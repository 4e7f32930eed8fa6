"""Write the tables of docs/studies/lineage.md from the data of experiments and studies: python
scripts/tables/lineage_table.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from tables.experiment_tables import table
from tables.lineage.figures import STUDIES
from tables.lineage.rows import HARDWARE, RIVALS, THESIS, Row
from tables.marked_text import with_part, write_or_check

PAGE = STUDIES / "lineage.md"
TABLES = {"thesis": THESIS, "rivals": RIVALS, "hardware": HARDWARE}


def rows_table(rows: tuple[Row, ...]) -> str:
    """The systems of one table."""
    return table(
        ["system", "what it proposes", "where", "setting", "in memory", "beyond memory", "verdict"],
        [
            [
                row.system,
                row.proposes,
                f"[{Path(row.code).name}](../../{row.code})",
                row.setting,
                row.in_memory(),
                row.beyond(),
                row.verdict,
            ]
            for row in rows
        ],
    )


def updated(text: str) -> str:
    """The page with its tables made of the data."""
    for name, rows in TABLES.items():
        text = with_part(text, f"<!-- {name} -->", f"<!-- end of {name} -->", rows_table(rows), PAGE)
    return text


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(PAGE, updated, "scripts/tables/lineage_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
