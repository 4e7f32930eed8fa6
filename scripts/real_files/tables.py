"""Cells of tables, as page and manual have them."""

from __future__ import annotations

import re
from typing import Any

from real_files.rows import DIFFERS, EQUAL, TIMES, agreement_in

HEADS = ("file", "verdict", "relMSE", "noise", "brightness", "first", "again", "small", "all", "equal error")
# What the heads mean; the same words below every table
EXPLAINED = """\
Verdict: *same* where relMSE (of blocks of 4 x 4 pixels, against Cycles) is at most 0.01 + 1.6 x what noise alone makes
of it, and the means differ by less than 2 % beyond two standard errors. Brightness: mean of RayBatch's picture over
that of Cycles, with its standard error. Seconds from the call to the written picture, RayBatch's / Cycles': the first
picture of a fresh process with 1 sample a pixel, the same again, 16 x 16 pixels (the second time), and all samples.
Equal error: seconds x noise, RayBatch over Cycles; below 1 RayBatch comes to an error sooner."""
# A name, several of them, a file or a number
_VARYING = re.compile(r"“[^”]*”((, | and )(“[^”]*”|\d+ more))*|(//|/)\S+|\d[\d,.]*")
SUMMARY_HEADS = ("", "RayBatch over Cycles", "95 % interval", "worst", "of", "RayBatch [s]", "Cycles [s]", "files")


def cells(row: dict[str, Any]) -> list[str]:
    """A row under HEADS; `-` for what is not known."""
    found = agreement_in(row)
    reported = ["-"] * 3
    if found:
        ratio = "-" if found.ratio != found.ratio else f"{found.ratio:.3f} ±{found.ratio_error:.3f}"
        reported = [f"{found.relmse:.2g}", f"{found.noise:.2g}", ratio]
    times = [_both(row, step) for step in TIMES]
    return [row["name"], row["verdict"], *reported, *times, _number(row["ratios"].get(EQUAL))]


def _both(row: dict[str, Any], step: str) -> str:
    ours, theirs = (row["seconds"][engine].get(step) for engine in ("RAYBATCH", "CYCLES"))
    return "-" if ours is None and theirs is None else f"{_number(ours)} / {_number(theirs)}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def summary_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Rows under SUMMARY_HEADS: of each ratio of times."""
    rows = []
    for name, spread in summary["ratios"].items():
        seconds = summary["seconds"].get(name, {})
        medians = [_number(seconds.get(engine, {}).get("median")) for engine in ("RAYBATCH", "CYCLES")]
        interval = f"{_number(spread['low'])} to {_number(spread['high'])}"
        rows.append(
            [name, _number(spread["median"]), interval, _number(spread["worst"]), spread["worst_of"]]
            + medians
            + [str(spread["count"])]
        )
    return rows


def how_rendered(defaults: bool) -> str:
    """How engines are set, in words; `defaults`: as in a new scene."""
    if defaults:
        return "with its own defaults, but without denoising"
    return "at most 8 bounces, without clamping, adaptive\nsampling and denoising"


def counted(summary: dict[str, Any]) -> str:
    """How many files there are, by verdict."""
    counts = ", ".join(f"{count} {verdict}" for verdict, count in summary["counts"].items() if count)
    return f"{summary['files']} files by verdict: {counts or 'none'}"


def notes_of_old(report: dict[str, Any]) -> list[str]:
    """A sentence about files that were rendered by other code than that which reports; none where there are none."""
    old, count = report.get("old", []), len(report["files"])
    if not old:
        return []
    which = "All files" if len(old) == count else f"{len(old)} of {count} files ({_listed(old)})"
    return [f"{which} were rendered by another state of RayBatch or Blender than that which tells of them here."]


def remarks(row: dict[str, Any]) -> list[tuple[str, str]]:
    """What else is to be reported for a file: kind and text."""
    found = [("error", text) for text in row["errors"]]
    found += [("note", text) for text in row["notes"]]
    if row["invalid_samples"]:
        found.append(("note", f"{row['invalid_samples']:,} samples of RayBatch were not finite"))
    if row["missing"]:
        found.append(("missing in the file", _listed(row["missing"])))
    if row["left_out"]:
        found.append(("left out or otherwise", _listed(alike(row["left_out"]))))
    if judgement := row.get("superposition"):
        found.append(("superposition", f"right is: {judgement['right']}. {_sentence(judgement['why'])}"))
    elif row["verdict"] == DIFFERS:
        found.append(("superposition", "not judged: --superposition tells which engine is right"))
    return found


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


def alike(texts: list[str]) -> list[str]:
    """The first of `texts` that differ by names and numbers alone, with how many there are like it."""
    groups: dict[str, list[str]] = {}
    for text in texts:
        groups.setdefault(_VARYING.sub("…", text), []).append(text)
    return [some[0] + (f" ({len(some) - 1} more like it)" if len(some) > 1 else "") for some in groups.values()]


def _listed(texts: list[str], most: int = 12) -> str:
    rest = len(texts) - most
    return "; ".join(texts[:most]) + (f"; and {rest} more" if rest > 0 else "")
