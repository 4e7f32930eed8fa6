"""docs/real-files.md: the table of the files of docs/real-files.json, and what is known of those that differ.

Figures are those of the last comparison, which docs/real-files/results.json keeps; what is known of a file (its
“finding”) stands in the list, beside where it comes from. Pictures are shown only where the file's licence allows it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from lib.output import json_text, write_text
from tables.marked_text import list_item, wrapped

from real_files.judging import NAMES
from real_files.listing import may_be_shown, name_of, read_listing
from real_files.pictures import GAIN, where_both_are, write_png
from real_files.records import Record
from real_files.rows import DIFFERS, summary_of
from real_files.tables import (
    EXPLAINED,
    HEADS,
    SUMMARY_HEADS,
    cells,
    counted,
    how_rendered,
    notes_of_old,
    remarks,
    summary_rows,
)

LISTING, PAGE, FOLDER = "docs/real-files.json", "docs/real-files.md", "docs/real-files"
# The option of the command line, by the word for it in a request
_KERNEL_CACHES = {"the user's": "", "cold": " --kernel-cache cold", "a copy": " --kernel-cache FOLDER-WITH-KERNELS"}
_HEAD = """\
# Real files

Files that other people made and published, rendered by Cycles and by RayBatch: do they show the same picture, and how
long does it take? `scripts/compare.py` makes this page; on your own files it answers the same questions.

None of the files is a part of this project. [real-files.json](real-files.json) says of each where it is: repository,
commit, path, MD5 and licence; “companions” are textures and libraries that lie beside it. With the files in a folder,
as OWNER/NAME/PATH, anyone can repeat it:

```
python scripts/compare.py --list docs/real-files.json --folder FOLDER --out out/compare --superposition \\
    --width {width} --samples {samples}{more}{kernel_cache}
python scripts/compare.py --out out/compare --table     # writes this page from what is there
```

Both engines render {width} pixels wide with {samples} samples on the CPU, {how}

## All files together

{counted}.{old}

{summary}

## Each file

{files}

{explained}

Which engine is right is judged by superposition: the picture of all sources of light is the sum of the pictures of each
lamp, of the world, and of all surfaces that emit. An engine whose pictures do not add up is wrong. Where both add up,
the sources whose pictures differ are named, and a person looked for the reason. RayBatch's own sums are the case
“overlapping lamps” in [stability.md](stability.md).
"""


def with_findings(report: dict[str, Any], listing: list[dict[str, Any]]) -> str:
    """The page's text, from a report as `results.json` keeps it and the list."""
    about = {name_of(entry): entry for entry in listing}
    versions = ", ".join(f"{name} {value}" for name, value in report["versions"].items())
    # requests of earlier comparisons know none of these
    repeats, defaults = report["request"].get("repeats", 1), report["request"].get("defaults", False)
    kernels = report["request"].get("kernels", "AUTO")
    note = "\n\n" + "\n".join(wrapped(report["note"])) if report.get("note") else ""
    lines = [
        _HEAD.format(
            width=report["request"]["width"],
            samples=report["request"]["samples"],
            more=f" --repeats {repeats}" * (repeats > 1)
            + " --defaults" * defaults
            + f" --kernels {kernels}" * (kernels != "AUTO"),
            how=f"{how_rendered(defaults)}, each in a process of its own. {versions}.{note}",
            kernel_cache=_KERNEL_CACHES[report["request"]["kernel_cache"]],
            counted=counted(report["summary"]),
            old="".join("\n\n" + "\n".join(wrapped(text)) for text in notes_of_old(report)),
            summary=_table(SUMMARY_HEADS, summary_rows(report["summary"])),
            files=_table(HEADS, [cells(row) for row in report["files"]]),
            explained=EXPLAINED,
        )
    ]
    missing = [name for name in about if name not in {row["name"] for row in report["files"]}]
    if missing:
        lines += wrapped(f"Of the list, not rendered yet: {'; '.join(missing)}.")
    for title, some in (
        ("Files that differ", [row for row in report["files"] if row["verdict"] == DIFFERS]),
        ("Other files", [row for row in report["files"] if row["verdict"] != DIFFERS]),
    ):
        lines += ["", f"## {title}"]
        for row in some:
            lines += _section(row, about.get(row["name"], {}))
    return "\n".join(lines) + "\n"


def _table(heads: tuple[str, ...], rows: list[list[str]]) -> str:
    made = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in made)


def _section(row: dict[str, Any], entry: dict[str, Any]) -> list[str]:
    lines = ["", f"### {row['name']}", ""]
    if entry:
        kind = f"{entry['kind'][:1].upper()}{entry['kind'][1:]}. " if entry.get("kind") else ""
        lines += wrapped(f"{kind}Licence: {entry['licence']}.")
    finding = entry.get("finding", {})
    if row["verdict"] == DIFFERS:
        judged = row.get("superposition", {}).get("right")
        right = finding.get("right", judged if judged in NAMES.values() else "not known yet")
        why = finding.get("why", "")
        lines += ["", *wrapped(f"**Right: {right}.**{' ' if why else ''}{why}")]
    elif finding.get("why"):
        lines += ["", *wrapped(finding["why"])]
    reported = [f"{kind}: {text}" for kind, text in remarks(row)]
    lines += [""] * bool(reported) + [line for text in reported for line in list_item(text)]
    if row.get("picture"):
        credit = f"; {entry['credit']}" if entry.get("credit") else ""
        lines += ["", f"![Cycles, RayBatch and their difference](real-files/{row['picture']})", ""]
        lines += wrapped(f"Cycles, RayBatch, and their absolute difference {GAIN} times as bright{credit}.")
    return lines


def write_manual(root: Path, report: dict[str, Any], records: list[Record], slugs: dict[str, str]) -> None:
    """Write the page, its pictures and its results; `slugs` are names of files for rows."""
    listing = read_listing(root / LISTING)
    about = {name_of(entry): entry for entry in listing}
    folder = root / FOLDER
    folder.mkdir(exist_ok=True)
    by_name = {record.name: record for record in records}
    rows, pictures = [], set()
    for row in report["files"]:
        if row["name"] not in about:
            continue  # somebody's own file: not for the manual
        row = dict(row)
        record, picture = by_name[row["name"]], None
        if may_be_shown(about[row["name"]]):
            picture = where_both_are(record.pair("CYCLES"), record.pair("RAYBATCH"))
        if picture is not None:
            row["picture"] = f"{slugs[row['name']]}.png"
            pictures.add(row["picture"])
            write_png(folder / row["picture"], picture)
        rows.append(row)
    for path in folder.glob("*.png"):
        if path.name not in pictures:
            path.unlink()  # of a file that is there no more
    named = {row["name"] for row in rows}
    old = [name for name in report["old"] if name in named]
    kept = report | {"files": rows, "summary": summary_of(rows), "old": old}
    write_text(folder / "results.json", json_text(kept) + "\n")
    write_text(root / PAGE, with_findings(kept, listing))


def stored_page(root: Path) -> str:
    """The page as the stored results and the list make it."""
    report = json.loads((root / FOLDER / "results.json").read_text(encoding="utf-8"))
    return with_findings(report, read_listing(root / LISTING))
