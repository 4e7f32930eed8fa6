"""Write the README's table of whole renders from the reports in docs/figures: python scripts/figures_table.py

The reports are those of `scripts/benchmark.py render ... --json docs/figures/render-SCENE-DEVICE.json`.
"""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MARKS = ("<!-- figures: made by scripts/figures_table.py -->", "<!-- end of figures -->")


def row(path: Path) -> str:
    """One line of the table."""
    report = json.loads(path.read_text(encoding="utf-8"))
    ours, cycles = report["raybatch"], report.get("cycles")
    frame = report["frame"]
    rate = report["rays"]["total"] / ours["render"]["seconds"] / 1e6
    cells = [
        path.stem.split("-")[1].capitalize(), f"{report['triangles']:,}", report["device"]["name"],
        f"{frame['width']} x {frame['height']}, {report['samples_per_pixel']} spp", f"{ours['build']['seconds']:.2f} s",
        f"{ours['render']['seconds']:.2f} s", f"{rate:.1f}", f"{ours['seconds']:.2f} s (±{50 * ours['spread']:.0f} %)",
        f"{cycles['seconds']:.2f} s (±{50 * cycles['spread']:.0f} %)" if cycles else "",
        f"{report['raybatch_over_cycles']:.2f}" if cycles else "",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    heads = ["scene", "triangles", "device", "picture", "tree", "render", "Mrays/s", "whole", "Cycles, same CPU and run", "ratio"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    lines += [row(path) for path in sorted((ROOT / "docs/figures").glob("render-*.json"))]
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    table = "\n".join([MARKS[0], *lines, MARKS[1]])
    readme.write_text(re.sub(re.escape(MARKS[0]) + ".*" + re.escape(MARKS[1]), lambda _: table, text, flags=re.S), encoding="utf-8")


if __name__ == "__main__":
    main()
