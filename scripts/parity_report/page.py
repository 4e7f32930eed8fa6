"""docs/parity.md: a table of features with figures and thumbnails, and the same as JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

THUMBNAIL = 64  # pixels of the edge of each of the three pictures
GAIN = 10  # differences are shown this many times as large

_HEAD = """\
# Parity with Cycles

`scripts/parity.py` makes this page. Each feature of Blender's materials, textures and worlds is built as a small scene and rendered by
Cycles and by RayBatch on the CPU.

- A **node** alone is emitted by planes of 32 x 32 points, with coordinates that are the same bits for both. Its figure is the largest difference,
  absolute below 1 and relative above, over all points, outputs and variants; the bound is {node:g}.
- A **picture** is rendered twice by each engine, with different seeds and Cycles made unbiased. *Mean*: the largest relative difference of a
  channel's mean (bound {mean:.0%}), with its standard error, and the largest difference in standard errors (σ). *relMSE*: the mean of squared relative
  differences, less what the noise of both makes of it (bound {rel_mse:g}), with its standard error. Samples double until both can be told from their bounds.

Pictures: Cycles, RayBatch, and the absolute difference {gain} times as bright. A feature that is approximated or not supported stays in the table with its
figures.
"""


def _slug(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _to_screen(pixels: np.ndarray) -> np.ndarray:
    """Linear to sRGB bytes."""
    value = np.clip(np.nan_to_num(pixels, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return (np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.power(np.maximum(value, 1e-9), 1 / 2.4) - 0.055) * 255 + 0.5).astype(np.uint8)


def _enlarged(pixels: np.ndarray) -> np.ndarray:
    """Top row first, about `THUMBNAIL` pixels high."""
    factor = max(1, round(THUMBNAIL / pixels.shape[0]))
    return np.repeat(np.repeat(pixels[::-1], factor, 0), factor, 1)


def thumbnail(result: Any) -> np.ndarray:
    """Cycles, RayBatch and difference side by side, uint8 [height, width, 3]."""
    both = result.theirs, result.ours
    low, high = 0.0, 1.0
    if result.feature.kind == "node":
        values = result.theirs[np.isfinite(result.theirs)]
        low, high = min(0.0, float(np.percentile(values, 1))), max(1.0, float(np.percentile(values, 99)))
    else:
        high = max(float(np.percentile(result.theirs, 97)), 1e-6)
    shown = [(each - low) / (high - low) for each in both] + [GAIN * np.abs(both[0] - both[1]) / (high - low)]
    gap = np.full((_enlarged(result.theirs).shape[0], 2, 3), 255, np.uint8)
    parts = [_to_screen(_enlarged(each)) for each in shown]
    return np.concatenate([parts[0], gap, parts[1], gap, parts[2]], 1)


def write_thumbnails(results: list, folder: Path) -> dict[str, str]:
    """One PNG a feature in `folder`; returns file names by feature, those that were there before included."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    names = {}
    for result in results:
        name = f"{_slug(result.feature.name)}.png"
        if result.ours is not None and result.theirs is not None:
            Image.fromarray(thumbnail(result)).quantize(128).save(folder / name, optimize=True)
        if (folder / name).exists():
            names[result.feature.name] = name
    for file in folder.glob("*.png"):
        if file.name not in names.values():
            file.unlink()  # of a feature that is there no more
    return names


def earlier_results(file: Path) -> list:
    """Results in a report by `json_report`, of features that are still there; without pictures. None without the file."""
    from blender.features.registry import all_features
    from blender.features.runner import Result

    if not file.exists():
        return []
    by_name = {each.name: each for each in all_features()}
    rows = json.loads(file.read_text(encoding="utf-8"))["features"]
    return [
        Result(by_name[row["name"]], row["status"], row["figures"], row["note"], seconds=row["seconds"]) for row in rows if row["name"] in by_name
    ]


def together(earlier: list, new: list) -> list:
    """`new`, and those of `earlier` that it has not, in the order of the registry."""
    from blender.features.registry import all_features

    results = {result.feature.name: result for result in [*earlier, *new]}
    return [results[each.name] for each in all_features() if each.name in results]


def _figures(result: Any) -> str:
    figures = result.figures
    if not figures:
        return ""
    if result.feature.kind == "node":
        beyond = figures.get("points beyond the bound, %")
        return f"{figures['error']:.1e}" + (f"; {beyond:.3g} % of points beyond" if beyond else "")
    return (
        f"mean {figures['mean']:.2%} ± {figures[MEAN_NOISE]:.2%} ({figures['deviations']:.1f} σ); "
        f"relMSE {figures['relMSE']:.1e} ± {figures[REL_NOISE]:.0e}; {figures['samples']:.0f} spp"
    )


MEAN_NOISE, REL_NOISE = "mean's noise", "relMSE's noise"


def counts(results: list) -> dict[str, tuple[int, int]]:
    """By family, and of all: (within bounds, features)."""
    from blender.features.registry import FAMILIES

    made = {}
    for family in FAMILIES:
        some = [result for result in results if result.feature.family == family]
        if some:
            made[family] = (sum(result.ok for result in some), len(some))
    made["all"] = (sum(result.ok for result in results), len(results))
    return made


def page(results: list, pictures: dict[str, str], versions: dict[str, str]) -> str:
    """The Markdown text; `pictures` are file names in the folder parity/ beside it."""
    from blender.features.registry import FAMILIES, all_features
    from blender.features.runner import MEAN_TOLERANCE, REL_MSE_TOLERANCE, TOLERANCE

    lines = [_HEAD.format(node=TOLERANCE, mean=MEAN_TOLERANCE, rel_mse=REL_MSE_TOLERANCE, gain=GAIN)]
    lines += [", ".join(f"{name} {version}" for name, version in versions.items()) + ".", ""]
    if missing := len(all_features()) - len(results):
        lines += [f"**{missing} of {len(all_features())} features are not in this table yet.**", ""]
    lines += ["| family | within bounds | of | share |", "|---|---|---|---|"]
    lines += [f"| {name} | {ok} | {total} | {ok / total:.0%} |" for name, (ok, total) in counts(results).items()]
    for family in FAMILIES:
        some = [result for result in results if result.feature.family == family]
        if not some:
            continue
        lines += ["", f"## {family}", "", "| feature | | figures | Cycles, RayBatch, difference | notes |", "|---|---|---|---|---|"]
        for result in some:
            picture = f"![{result.feature.name}](parity/{pictures[result.feature.name]})" if result.feature.name in pictures else ""
            note = result.note.replace("|", "\\|")
            lines.append(f"| {result.feature.name} | {result.status} | {_figures(result)} | {picture} | {note} |")
    return "\n".join(lines) + "\n"


def json_report(results: list, versions: dict[str, str], seconds: float) -> dict[str, Any]:
    """Everything but the pictures."""
    return {
        "versions": versions,
        "seconds": round(seconds, 1),
        "counts": {name: {"ok": ok, "total": total} for name, (ok, total) in counts(results).items()},
        "features": [
            {
                "name": result.feature.name, "family": result.feature.family, "kind": result.feature.kind, "quick": result.feature.quick,
                "status": result.status, "figures": result.figures, "note": result.note, "seconds": round(result.seconds, 2),
            }
            for result in results
        ],
    }  # fmt: skip
