"""Tables of docs/experiments/traversal.md, from the data beside it."""

from __future__ import annotations

from typing import Any

from tables.experiment_data import NAMES, PLAIN, RAYS, cases, rate_text, title

NODE_BYTES, TRIANGLE_BYTES = 80, 48  # of the layout QUANTISED


def table(heads: list[str], rows: list[list[Any]]) -> str:
    """Rows as Markdown."""
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in [heads, ["---"] * len(heads), *rows])


def tracers_table(reports: dict[str, dict[str, Any]]) -> str:
    """Rates of all tracers of some reports, [Mrays/s]."""
    tracers = [name for name in NAMES if any(name in report["trees"] for report in reports.values())]
    rows = []
    for report in reports.values():
        for (rays, order, _), by_name in cases(report).items():
            rates = [by_name[name]["mrays_per_s"] if name in by_name else None for name in tracers]
            rows.append([title(report), RAYS.get(rays, rays), order, *(rate_text(rate) for rate in rates)])
    return table(["scene", "rays", "order", *(NAMES[name] for name in tracers)], rows)


def lanes_table(variants: dict[str, dict[str, Any]]) -> str:
    """What a ray costs, and how many lanes were at it."""
    rows = []
    for data in variants.values():
        for counted in data["counters"]:
            asked = NODE_BYTES * counted["node_steps"] + TRIANGLE_BYTES * counted["triangle_tests"]
            rows.append(
                [
                    title(data),
                    RAYS[counted["rays"]],
                    counted["order"],
                    "plain" if counted["variant"] == PLAIN else "refill",
                    f"{counted['node_steps']:.1f}",
                    f"{counted['triangle_tests']:.1f}",
                    f"{asked:,.0f}",
                    f"{counted['lanes_alive']:.1f}",
                    f"{counted['lanes_visiting']:.1f}",
                    f"{counted['lanes_testing']:.1f}",
                ]
            )
    return table(
        [
            "scene",
            "rays",
            "order",
            "traversal",
            "nodes",
            "triangles",
            "bytes asked for",
            "lanes with a ray",
            "visiting",
            "testing",
        ],
        rows,
    )


def profile_table(profiles: dict[str, dict[str, Any]]) -> str:
    """Figures of the profiler: `profile-*.json` hold `scene` and `rows`, each with `rays`, `order`, `tracer` and
    `metrics` by name.
    """
    if not profiles:
        return "Not measured yet."
    rows = [(title(profile), row) for profile in profiles.values() for row in profile["rows"]]
    metrics = list(dict.fromkeys(name for _, row in rows for name in row["metrics"]))
    cells = [
        [
            scene,
            RAYS.get(row["rays"], row["rays"]),
            row["order"],
            row["tracer"],
            *(row["metrics"].get(name, "") for name in metrics),
        ]
        for scene, row in rows
    ]
    return table(["scene", "rays", "order", "traversal", *metrics], cells)


def variants_table(data: dict[str, Any]) -> str:
    """All kernels of one scene, [Mrays/s]; sorted: the rays themselves lie in sorted order, and the sort is not
    timed.
    """
    columns = list(data["variants"][0]["mrays_per_s"])
    rows = [
        [variant["label"], variant["registers"] or "", *(variant["mrays_per_s"][column] for column in columns)]
        for variant in data["variants"]
    ]
    return table(
        ["kernel", "registers", *(f"{RAYS[column.split()[0]]}, {column.split()[1]}" for column in columns)], rows
    )


def scenes_table(data: dict[str, Any]) -> str:
    """The CPU's variants over Embree."""
    heads = {
        "plain": "one ray at a time",
        "interleaved": "16 rays",
        "sorted": "16 rays, sorted",
        "splits": "16 rays, spatial splits",
        "splits_sorted": "the same, sorted",
    }
    rows = [
        [
            row["scene"],
            RAYS[row["rays"]],
            row["order"],
            f"{row['embree_mrays_per_s']:.2f}",
            *(f"{row['over_embree'][key]:.2f}" for key in heads),
        ]
        for row in data["results"]
    ]
    return table(["scene", "rays", "order", "Embree [Mrays/s]", *heads.values()], rows)


def build_table(build: dict[str, Any]) -> str:
    """Steps of rays by how the tree was built."""
    scenes = build["quality"]["scenes"]
    methods = list(next(iter(scenes.values())))
    rows = [
        [
            method,
            *(
                f"{scene[method]['node_steps']:.2f} / {scene[method]['triangle_tests']:.2f}"
                for scene in scenes.values()
            ),
        ]
        for method in methods
    ]
    return table(["build", *scenes], rows)


def renders_table(sorting: dict[str, Any]) -> str:
    """Whole renders with and without sorting."""
    rows = [
        [row["scene"], f"{row['unsorted_ms']} ms", f"{row['sorted_ms']} ms"] for row in sorting["renders"]["results"]
    ]
    return table(["scene", "unsorted", "every list sorted"], rows)
