"""The rows reported for each file, and those of all of them together."""

from __future__ import annotations

import math
import statistics
from typing import Any

import numpy as np

from raybatch_addon.core.errors import RayBatchError
from real_files.judging import judge
from real_files.measures import SIGMAS, Agreement, Pair, Spread, agreement, equal_error, noise_of, short
from real_files.process import DONE
from real_files.records import ENGINES, Record
from real_files.worker import PICTURES, SEEDS, SOURCES, seed_pairs

SAME, DIFFERS, BLACK, FAILED = "same", "differs", "both black", "not compared"
# Noise that is reported: relative standard error of the ratio of means, and the part of relMSE that noise makes
NOISY, NOISY_BLOCKS = 0.02, 0.04
ALPHA_MOST = 0.02  # mean difference of alpha at which pictures are still the same
# Times that are reported, by the step that they are of
TIMES = {"first": "first picture", "again": "picture again", "small": "16 x 16 pixels", "all-2": "all samples"}
# What is reported for the errors: variances at equal samples, and times at equal error
VARIANCE, EQUAL = "variance", "equal error"


def row_of(record: Record) -> dict[str, Any]:
    """Everything that is known of a file, as JSON holds it."""
    ours = record.tasks.get(f"RAYBATCH/{PICTURES}", {})
    steps = ours.get("steps", [])
    last = steps[-1] if steps else {}
    row: dict[str, Any] = {
        "name": record.name,
        "md5": record.md5,
        "verdict": FAILED,
        "errors": _errors(record),
        "seconds": {engine: record.seconds(engine) for engine in ENGINES},
        "ratios": {},
        "left_out": last.get("warnings", []),
        "missing": ours.get("missing", []),
        "invalid_samples": max((each.get("invalid_samples", 0) for each in steps), default=0),
        "triangles": last.get("triangles", 0),
        "notes": [ours["prepared"]] if ours.get("prepared") else [],
    }
    row["ratios"] = {
        name: short(row["seconds"]["RAYBATCH"][name] / row["seconds"]["CYCLES"][name])
        for name in TIMES
        if name in row["seconds"]["RAYBATCH"] and row["seconds"]["CYCLES"].get(name)
    }
    pairs = {engine: record.pair(engine) for engine in ENGINES}
    if any(pair is None for pair in pairs.values()):
        return row
    try:
        _compare(row, record, pairs)
    except RayBatchError as error:
        row["errors"].append(str(error))
    return row


def _compare(row: dict[str, Any], record: Record, pairs: dict) -> None:
    found = agreement(pairs["RAYBATCH"], pairs["CYCLES"])
    row["agreement"] = found.data()
    row["means"] = {engine: [short(value) for value in pair.mean.mean((0, 1))] for engine, pair in pairs.items()}
    row["alpha"] = short(_alpha_apart(record))
    row["verdict"] = SAME if found.same and row["alpha"] <= ALPHA_MOST else DIFFERS
    shown = (pairs["RAYBATCH"].mean + pairs["CYCLES"].mean) / 2
    _note_errors(row, record, shown)
    if not shown.any():
        row["verdict"] = BLACK
    for engine, key in (("Cycles", "CYCLES"), ("RayBatch", "RAYBATCH")):
        pixels = sum(int((~np.isfinite(record.pictures[f"{key}/all-{seed}"])).any(-1).sum()) for seed in SEEDS)
        if pixels:
            row["notes"].append(f"{pixels} pixels of {engine} are not finite, and count as black")
    relative = found.ratio_error / max(1.0, found.ratio)
    if relative > NOISY or found.noise > NOISY_BLOCKS:
        row["notes"].append(
            f"noise hides differences of less than {SIGMAS * relative:.0%} in the mean and "
            f"{math.sqrt(found.noise):.0%} in a block: render more samples"
        )
    if cells := record.tasks[f"RAYBATCH/{PICTURES}"].get("cells"):
        row["cells"] = _cells(pairs, cells)
        row["notes"].append(_reported_cells(row["cells"]))
    alone = {engine: record.sources(engine) for engine in ENGINES}
    if all(alone.values()):
        row["superposition"] = judge(pairs, alone).data()


def _cells(pairs: dict, cells: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """How each material of a library agrees, by its name."""
    found = {}
    for each in cells:
        x0, y0, x1, y1 = each["box"]
        cut = {
            engine: Pair(*(picture[y0:y1, x0:x1] for picture in (pair.first, pair.second)))
            for engine, pair in pairs.items()
        }
        found[each["material"]] = agreement(cut["RAYBATCH"], cut["CYCLES"]).data()
    return found


def _reported_cells(cells: dict[str, dict[str, Any]]) -> str:
    """Which materials differ, the furthest apart first."""
    agreements = {name: Agreement.of_data(data) for name, data in cells.items()}
    differ = sorted(
        (name for name, each in agreements.items() if not each.same), key=lambda name: -agreements[name].relmse
    )
    if not differ:
        return f"all {len(cells)} materials look the same"
    ratios = ", ".join(
        f"“{name}” ({agreements[name].ratio:.2f} ±{agreements[name].ratio_error:.2f})" for name in differ
    )
    same = len(cells) - len(differ)
    return f"of {len(cells)} materials {same} look the same; of the others RayBatch over Cycles: {ratios}"


def _note_errors(row: dict[str, Any], record: Record, shown: np.ndarray) -> None:
    """Noise of both engines and their times to equal error, medians over repeats; `shown`: what errors are relative
    to.
    """
    found: dict[str, list[float]] = {VARIANCE: [], EQUAL: []}
    noises: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    for first, second in seed_pairs(record.request.get("repeats", 1)):
        names = (f"all-{first}", f"all-{second}")
        pairs = {engine: pair for engine in ENGINES if (pair := record.pair(engine, names)) is not None}
        if len(pairs) < len(ENGINES):
            continue
        noise = {engine: noise_of(pair, shown) for engine, pair in pairs.items()}
        for engine in ENGINES:
            noises[engine].append(noise[engine])
        times = [(row["seconds"][engine].get(names[1], 0.0), noise[engine]) for engine in ("RAYBATCH", "CYCLES")]
        if (equal := equal_error(*times)) is not None:
            found[EQUAL].append(equal)
            found[VARIANCE].append(noise["RAYBATCH"] / noise["CYCLES"])
    row["noise"] = {engine: short(statistics.median(values)) for engine, values in noises.items()}
    row["repeats"] = {name: [short(value) for value in values] for name, values in found.items()}
    row["ratios"] |= {name: short(statistics.median(values)) for name, values in found.items() if values}


def _alpha_apart(record: Record) -> float:
    alphas = [
        sum(np.nan_to_num(record.pictures[f"{engine}/all-{seed}"][..., 3].astype(np.float64)) for seed in SEEDS) / 2
        for engine in ENGINES
    ]
    return float(np.abs(alphas[0] - alphas[1]).mean())


def _errors(record: Record) -> list[str]:
    reported = [record.complaint] if record.complaint else []
    for key, task in record.tasks.items():
        if task["status"] != DONE and task["error"] not in reported:
            reported.append(task["error"] + (" (its sources alone)" if key.endswith(SOURCES) else ""))
    return reported


def agreement_in(row: dict[str, Any]) -> Agreement | None:
    """How the file's pictures agree; None if there was nothing to compare."""
    return Agreement.of_data(row["agreement"]) if "agreement" in row else None


def summary_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts by verdict, and of each ratio of times, RayBatch over Cycles, its median and its worst over all files."""
    spreads = {}
    for name, title in (TIMES | {VARIANCE: VARIANCE, EQUAL: EQUAL}).items():
        spread = Spread.of({row["name"]: row["ratios"][name] for row in rows if row["ratios"].get(name)})
        if spread:
            spreads[title] = spread.data()
    medians: dict[str, dict[str, Any]] = {}
    for engine in ENGINES:
        for name, title in TIMES.items():
            spread = Spread.of(
                {row["name"]: row["seconds"][engine][name] for row in rows if name in row["seconds"][engine]}
            )
            if spread:
                medians.setdefault(title, {})[engine] = spread.data()
    counts = {verdict: sum(row["verdict"] == verdict for row in rows) for verdict in (SAME, DIFFERS, BLACK, FAILED)}
    return {"files": len(rows), "counts": counts, "ratios": spreads, "seconds": medians}
