"""Reports as a person reads them."""

from __future__ import annotations

from typing import Any


def table(heads: list[str], rows: list[list[str]]) -> str:
    """Rows in columns: the first two to the left, figures to the right."""
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = []
    for row in [heads, ["-" * width for width in widths], *rows]:
        cells = [
            cell.ljust(width) if place < 2 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def traversal_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py traversal`."""
    names = list(report["trees"])
    lines = [f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}"]
    for name, tree in report["trees"].items():
        size = (
            ""
            if tree["bvh_bytes"] is None
            else f", {tree['bvh_bytes'] / max(1, report['triangles']):.0f} bytes a triangle"
        )
        lines.append(f"tree of {name}: built in {tree['build_s']:.2f} s{size}")
    cases: dict[tuple, dict[str, dict[str, Any]]] = {}
    for result in report["results"]:
        cases.setdefault((result["rays"], result["order"], result["threads"]), {})[result["tracer"]] = result
    rows, counted = [], report["results"][0]["node_steps"] is not None
    for (rays, order, threads), by_name in cases.items():
        first = by_name[names[0]]
        row = [rays, order, "" if threads is None else str(threads), f"{first['ray_count']:,}"]
        for name in names:
            result = by_name[name]
            sort = f" ({result['mrays_per_s_without_sort']:.2f})" if result["sort_s"] else ""
            row.append(f"{result['mrays_per_s']:.2f}{sort} ±{50 * result['spread']:.0f} %")
        row += [f"{first['mrays_per_s'] / by_name[name]['mrays_per_s']:.2f}" for name in names[1:]]
        if counted:
            row += [f"{first['node_steps']:.1f}", f"{first['triangle_tests']:.1f}"]
        rows.append(row)
    heads = ["rays", "order", "threads", "count", *names, *(f"{names[0]} / {name}" for name in names[1:])]
    heads += [f"steps of {names[0]}", "triangle tests"] if counted else []
    lines += ["", table(heads, rows), "Mrays/s, medians, ± half the spread; in brackets without the time of sorting"]
    for (rays, order, _), by_name in cases.items():
        for name, result in by_name.items():
            if order == report["results"][0]["order"] and (result["disagreements"] or result["faults"]):
                lines.append(
                    f"hits of {name}, {rays}: {result['disagreements']:,} differ from another's, {result['judged']:,} "
                    f"judged, {result['faults']:,} faults"
                )
            if result["bytes_copied"] is not None:
                brought = result["bytes_copied"]
                lines.append(f"{name}, {rays}, {order}: {brought / 1e6:,.1f} MB of the tree were brought in")
    return "\n".join(dict.fromkeys(lines))


_CORES = {
    True: "has ray-tracing cores, which only Cycles by OptiX uses",
    False: "has no ray-tracing cores, which Cycles by OptiX would use",
}


def render_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py render`."""
    _frame, ours = report["frame"], report["raybatch"]
    rate = report["rays"]["total"] / ours["render"]["seconds"] / 1e6 if ours["render"]["seconds"] else 0.0
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}",
        _rays_line(report),
        f"first render, with compilation  {report['cold']['seconds']:9.3f} s",
        f"whole render                    {_time(ours)}" + ", without export" * (report["export_s"] is not None),
        f"  tree                          {_time(ours['build'])}",
        f"  render                        {_time(ours['render'])}, {rate:.2f} Mrays/s",
    ]
    if report["export_s"] is not None:
        lines.append(f"export from Blender, timed once {report['export_s']:9.3f} s")
    if "cycles" in report:
        lines.append(
            f"Cycles, whole render            {_time(report['cycles'])} ({report['cycles']['device']}), with export"
        )
        lines.append(f"RayBatch over Cycles, at equal samples: {report['raybatch_over_cycles']:.2f} of its time")
        if report["ray_tracing_cores"] is not None:  # a GPU
            lines.append(
                "Set-up is in these times, Cycles' export too: give two counts, as --samples 64,256, to tell it from "
                f"sampling. The device {_CORES[report['ray_tracing_cores']]}."
            )
    if "equal_error" in report:
        equal = report["equal_error"]
        lines.append(
            f"relMSE of RayBatch {equal['relmse']['raybatch']:.3g}, of Cycles {equal['relmse']['cycles']:.3g}; "
            f"brightness {equal['mean_ratio']:.4f} of Cycles'"
        )
        lines.append(
            f"RayBatch over Cycles, at equal error: {equal['raybatch_over_cycles']:.2f} of its time "
            f"({equal['raybatch_seconds_to_cycles_error']:.2f} s to the error of Cycles)"
        )
    if report["invalid_samples"]:
        lines.append(f"{report['invalid_samples']:,} samples were not finite")
    return "\n".join(lines)


def slopes_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py render` with two sample counts."""
    frame, counts = report["frame"], report["sample_counts"]
    engines = {"RayBatch": report["raybatch"]}
    engines |= {f"Cycles ({kind})": each for kind, each in report.get("cycles", {}).items()}
    exports = {"RayBatch": "not timed" if report["export_s"] is None else f"{report['export_s']:.3f} s"}
    rows = [
        [
            name,
            *(f"{seconds:.3f} s" for seconds in each["seconds"]),
            f"{each['ms_a_sample']:.3f} ms ({each['ms_a_sample_least']:.3f} to {each['ms_a_sample_most']:.3f})",
            f"{each['fixed_seconds']:.3f} s",
            exports.get(name, "in it"),
            f"{each['first_seconds']:.3f} s",
        ]
        for name, each in engines.items()
    ]
    cores, heads = report["ray_tracing_cores"], ["engine", *(f"{count} samples" for count in counts)]
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}"
        + ("" if cores is None else f", which {_CORES[cores]}"),
        f"{frame['width']} x {frame['height']} pixels, {report['bounces']} bounces, {engines['RayBatch']['runs']} runs",
        "",
        table([*heads, "a sample", "once", "export", "first render"], rows),
        "once: beside samples, with kernels loaded; first render: of the smaller count, with what it loads or compiles",
    ]
    if "cycles" in report:
        lines.append("export: RayBatch's from Blender, timed once, is in none of its renders; Cycles' is in each")
    if "peer" in report:
        lines.append(
            f"RayBatch over Cycles ({report['peer']}), time of a sample: {report['slope_raybatch_over_cycles']}"
        )
    if "relmse" in report:
        lines.append(
            f"variance at equal samples: {report['variance_raybatch_over_cycles']}; time of samples at equal error: "
            f"{report['equal_error_raybatch_over_cycles']}; brightness {report['mean_ratio']} of Cycles'"
        )
    if report["invalid_samples"]:
        lines.append(f"{report['invalid_samples']:,} samples were not finite")
    return "\n".join(lines)


def recording_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py recording`."""
    frame, films = report["frame"], report["films"]
    rows = []
    for each in report["ways"]:
        cost = ["", "", ""]
        if each is not report["ways"][0]:
            least, most = (f"{100 * share:+.1f}" for share in each["cost_half"])
            cost = [f"{1000 * each['seconds_added']:+.0f} ms", f"{100 * each['cost']:+.1f} %", f"{least} to {most} %"]
        rows.append([each["way"], str(each["rounds"]), f"{each['seconds']:.3f} s", *cost])
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}",
        f"{frame['width']} x {frame['height']} pixels, {report['samples_per_pixel']} samples a pixel, "
        f"{report['bounces']} bounces, {report['ways'][0]['runs']} turns, {report['clock']} time",
        "",
        table(["render", "rounds", "median", "added", "cost", "half of the turns"], rows),
        "recording changes no bit of the films"
        if films["equal"]
        else "FILMS DIFFER: " + "; ".join(films["differences"]),
    ]
    if report["invalid_samples"]:
        lines.append(f"{report['invalid_samples']:,} samples were not finite")
    return "\n".join(lines)


def viewport_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py viewport`."""
    frame = report["frame"]
    rows = [
        [each["edit"], *(f"{1000 * each[name]:.0f} ms" for name in ("median", "p95", "most", "first"))]
        + [f"{each['pixel_side']:g}"]
        for each in report["edits"]
    ]
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}",
        f"{frame['width']} x {frame['height']} pixels, {report['edits_of_each_kind']} edits of each kind; "
        f"the first picture of all took {report['first_picture_seconds']:.2f} s",
        "",
        table(["edit", "median", "95 %", "most", "first of its kind", "pixels' side"], rows),
    ]
    return "\n".join(lines)


def memory_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py render --against memory`."""
    memory = report["memory"]
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, {report['geometry_bytes'] / 1e6:,.1f} MB of tree, on "
        f"{report['device']['name']}",
        _rays_line(report),
        "",
    ]
    rows = [["memory", f"{report['geometry_bytes'] / 1e6:,.1f}", *_times(memory), "1", "", "", "", ""]]
    for each in report["budgets"]:
        rows.append(
            [
                each["budget"],
                f"{each['geometry_budget'] / 1e6:,.1f}",
                *_times(each),
                f"{each['speed']:.3f}",
                f"{each['bytes_copied'] / 1e6:,.1f}",
                f"{each['pages_loaded']:,}",
                f"{each['rays_queued_per_ray']:.2f}",
                f"{each['steps']:,}",
            ]
        )
    heads = [
        "geometry",
        "MB",
        "paths alive",
        "tree",
        "render",
        "Mrays/s",
        "speed",
        "MB copied",
        "pages",
        "queued a ray",
        "steps",
    ]
    lines += [table(heads, rows), "medians, ± half the spread; speed: of the render in memory, trees apart", ""]
    for name, each in [("memory", memory), *((each["budget"], each) for each in report["budgets"])]:
        if each["stages"]:
            stages = ", ".join(f"{stage} {seconds:.3f} s" for stage, seconds in each["stages"].items() if seconds)
            lines.append(f"stages of {name}, with counters: {stages}")
        lines += [f"{name}: {warning}" for warning in each["warnings"]]
    return "\n".join([*lines, *_films_lines(report)])


def devices_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py render --against devices`."""
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}",
        _rays_line(report),
        "",
    ]
    rows = [
        [
            ", ".join(each["devices"]),
            _time(each["build"]).strip(),
            _time(each["render"]).strip(),
            *(f"{each[name]:.3f}" for name in ("speedup", "speedup_whole")),
            f"{100 * each['idle']:.1f} %",
        ]
        for each in report["several"]
    ]
    heads = ["devices", "trees", "render", "speedup", "with trees", "idle"]
    lines += [table(heads, rows), "medians, ± half the spread; speedup: over one device in the same turn", ""]
    for each in report["several"]:
        lines += [f"{', '.join(each['devices'])}: {warning}" for warning in each["warnings"]]
    return "\n".join([*lines, *_films_lines(report)])


def _rays_line(report: dict[str, Any]) -> str:
    frame = report["frame"]
    return (
        f"{frame['width']} x {frame['height']} pixels, {report['samples_per_pixel']} samples a pixel, "
        f"{report['bounces']} bounces, {report['rays']['total']:,} rays"
    )


def _films_lines(report: dict[str, Any]) -> list[str]:
    films = report["films"]
    lines = [
        f"{films['compared']} films are equal bit for bit"
        if films["equal"]
        else "FILMS DIFFER: " + "; ".join(films["differences"])
    ]
    if report["invalid_samples"]:
        lines.append(f"{report['invalid_samples']:,} samples were not finite")
    return lines


def _times(part: dict[str, Any]) -> list[str]:
    return [
        f"{part['schedule']['ray_count']:,}",
        _time(part["build"]).strip(),
        _time(part["render"]).strip(),
        f"{part['rays_per_second'] / 1e6:.2f}",
    ]


def _time(part: dict[str, Any]) -> str:
    return f"{part['seconds']:9.3f} s ±{50 * part['spread']:.0f} %"
