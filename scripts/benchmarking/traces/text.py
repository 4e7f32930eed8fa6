"""What commands on traces found, in words."""

from __future__ import annotations

from typing import Any

from benchmarking.tables import table

FAULTY_NAMED = 8  # rays of which an answer is wrong


def recorded_text(report: dict[str, Any]) -> str:
    """The report of `record_trace`."""
    rays = ", ".join(f"{count:,} {name}" for name, count in report["rays"].items())
    lines = [f"{report['file']}: {rays}; {report['bytes'] / 1e6:.1f} MB"]
    if report["hits"]:
        lines.append(f"hits of {report['hits']['tracer']}")
    if report["triangles_file"]:
        lines.append(f"{report['triangles_file']}: the {report['scene']['triangles']:,} triangles of the scene")
    return "\n".join(lines)


def checked_text(report: dict[str, Any]) -> str:
    """The report of `check_trace`."""
    has_hits = any("hits" in each for each in report["rays"].values())
    rows = [
        [name, "", f"{each['rays']:,}", *([f"{each['hits']:,}"] if has_hits else [])]
        for name, each in report["rays"].items()
    ]
    of = (report["scene"] or {}).get("name")
    compared = (
        "its geometry is that of the scene that was given"
        if report["compared_with_scene"]
        else "not compared with its scene (--scene)"
    )
    return "\n".join(
        [
            f"{report['file']}: as it should be; rays of {of or 'a scene that it does not name'}; {compared}",
            *([f"hits of {report['hits_of'] or 'a tracer that it does not name'}"] if has_hits else []),
            "",
            table(["rays", "", "count", *(["hit"] if has_hits else [])], rows),
        ]
    )


def compared_text(report: dict[str, Any]) -> str:
    """The report of `compare_hits`."""
    rows = []
    for each in report["results"]:
        same = "" if each["same_triangle"] is None else f"{100 * each['same_triangle']:.3f} %"
        theirs, ours = each["theirs"], each["ours"]
        rows.append(
            [
                each["rays"],
                "",
                f"{each['ray_count']:,}",
                f"{each['hits']:,}",
                f"{theirs['disagreements']:,}",
                f"{theirs['judged']:,}",
                f"{theirs['faults']:,}",
                f"{ours['faults']:,}",
                same,
            ]
        )
    heads = ["rays", "", "count", "hit", "differ", "judged", "faults theirs", "faults ours", "same triangle"]
    faulty = [index for each in report["results"] for index in each["faulty_rays"]]
    named = ", ".join(f"{index:,}" for index in faulty[:FAULTY_NAMED])
    return "\n".join(
        [
            f"{report['file']}: hits of {report['hits_of']}, beside those of {report['tracer']} on {report['scene']}",
            "",
            table(heads, rows),
            "Where hits differ by more than float32 rounds, every triangle was asked in float64: for all such rays, or "
            "for as many as there is time for, evenly among them.",
            *([f"The first of their faults are of the rays {named} of the file; --json has more."] if faulty else []),
        ]
    )
