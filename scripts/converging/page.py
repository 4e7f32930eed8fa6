"""A report as one HTML page that stands alone, readable in light and in dark."""

from __future__ import annotations

import base64
import html
import io
import math
import platform

import numpy as np
from rendering.pictures import HEAT_COLORS, display_pixels, heat_pixels, save_png

from converging.plots import COLORS, svg_plots
from converging.summary import HEADS, Summary, reference_text, rows, slopes_said, target_line
from raybatch_addon.core.convergence.errors import relative_to, squared_error

THUMBNAIL_MOST = 480  # pixels of the longer side
SCALE_PERCENTILE = 99.0  # of all errors: brightest in difference pictures
_STYLE = """
:root { color-scheme: light dark; --bad: #b3261e; --line: #8884 }
@media (prefers-color-scheme: dark) { :root { --bad: #ff8a80 } }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 82rem; padding: 0 1rem; background: Canvas; color: CanvasText }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
.row { display: flex; flex-wrap: wrap; gap: 1rem } .row > svg { width: 25rem; height: auto; flex: 1 1 25rem; max-width: 34rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums } .wide { overflow-x: auto }
th, td { text-align: right; padding: .25rem .7rem; border-bottom: 1px solid var(--line); white-space: nowrap }
th:first-child, td:first-child { text-align: left }
i.key { display: inline-block; width: .8em; height: .8em; margin-right: .5em; border-radius: 50% }
figure { margin: 0 } figure img { max-width: 24rem; width: 100%; image-rendering: pixelated; border: 1px solid var(--line) }
figcaption { font-size: .9em; max-width: 24rem } .bad { color: var(--bad); font-weight: 600 } .soft { opacity: .75 }
.scale { height: .7rem; width: 16rem; display: inline-block; vertical-align: middle }
"""


def html_page(summary: Summary, command: str) -> str:
    """The whole page; `command` is how it was made."""
    study = summary.study
    frame = study.opened.scene.frame
    device = study.device
    machine = [
        (
            "device",
            f"{device['name']} ({device['alias']}), {device['memory'] / 2**30:.1f} GiB, {device['cores']} cores of the "
            "host",
        )
    ]
    if study.cycles_device:
        machine.append(("device of Cycles", study.cycles_device))
    machine += [
        ("host", f"{platform.machine()}, {platform.processor() or 'processor not told'}"),
        *study.versions.items(),
        ("command", command),
    ]
    about = "; ".join([device["name"], *reference_text(summary), target_line(summary)])
    said = "".join(
        f"<li{' class=bad' * flattens}><b>{_text(label)}</b>: {_text(says)}</li>"
        for label, says, flattens in slopes_said(summary)
    )
    notes = "".join(f"<li>{_text(note)}</li>" for note in [*summary.notes, *study.warnings])
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width">'
        f"<title>Error against time: {_text(study.opened.name)}</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>Error against run time: {_text(study.opened.name)}</h1>\n"
        f"<p>{frame.width} x {frame.height} pixels, on {_text(about)}.</p>\n"
        + (f'<ul class="notes">{notes}</ul>\n' if notes else "")
        + f'<div class="row">{"".join(svg_plots(summary))}</div>\n'
        '<p class="soft">Lines are medians of all runs, bands reach from the least to the most, thin lines are single '
        "runs. "
        "Both axes are logarithmic. Time is that of rendering alone, without trees and compilation.</p>\n"
        + "".join(f"<p><b>{_text(each.says[0].upper() + each.says[1:])}.</b></p>\n" for each in summary.equal_times)
        + f'<h2>Figures</h2>\n<div class="wide">{_table(summary)}</div>\n'
        '<p class="soft">Medians of runs. Slope: of RMSE against samples. To target: seconds of rendering, '
        "extrapolated where it has a ~. "
        "Sooner: at the target, than the first setting. Efficiency: 1 / (error × seconds), relative to the first, with "
        "the least and the most of runs.</p>\n"
        + (f"<h2>Slopes</h2>\n<ul>{said}</ul>\n" if said else "")
        + _pictures(summary)
        + "<h2>Machine and versions</h2>\n<table>"
        + "".join(f"<tr><td>{_text(name)}</td><td>{_text(str(value))}</td></tr>" for name, value in machine)
        + f'</table>\n<p class="soft">Measured in {study.seconds:.0f} s.</p>\n</body></html>\n'
    )


def _text(text: str) -> str:
    return html.escape(text, quote=True)


def _table(summary: Summary) -> str:
    lines = []
    for place, (outcome, cells) in enumerate(zip(summary.outcomes, rows(summary), strict=True)):
        key = f'<i class="key" style="background: {COLORS[place % len(COLORS)]}"></i>'
        bad = outcome.slope is not None and outcome.slope.flattens
        lines.append(
            f"<tr><td>{key}{_text(cells[0])}</td>"
            + "".join(
                f"<td{' class=bad' if bad and head == 'slope' else ''}>{_text(cell)}</td>"
                for head, cell in zip(HEADS[1:], cells[1:], strict=True)
            )
            + "</tr>"
        )
    return f"<table><tr>{''.join(f'<th>{_text(head)}</th>' for head in HEADS)}</tr>{''.join(lines)}</table>"


# --- pictures


def _pictures(summary: Summary) -> str:
    """The reference, and of each variant the first run's picture and how far it is from the reference."""
    study = summary.study
    figures, errors = [], {}
    for used in study.used:
        if used.reference is not None:
            figures.append(_figure(_display(used.reference.picture), f"Reference: {used.reference.name}"))
    shown = [
        (outcome.variant.label, run, run.picture)
        for outcome in summary.outcomes
        for run in outcome.runs
        if run.picture is not None and run.points
    ]
    for label, _run, picture in shown:
        reference = study.references[label].reference
        if reference is not None:
            errors[label] = _relative_error(picture, reference.picture)
    largest = (
        float(np.percentile(np.concatenate([error.ravel() for error in errors.values()]), SCALE_PERCENTILE))
        if errors
        else 0.0
    )
    for label, run, picture in shown:
        last = run.points[-1]
        about = f"{label}, seed {run.seed}: {last.samples:,.0f} samples, {last.seconds:.3g} s, relMSE {last.relmse:.3g}"
        figures.append(_figure(_display(picture), about))
        if label in errors:
            figures.append(_figure(_heat(errors[label], largest), f"{label}: difference from the reference"))
    steps = ", ".join(f"rgb({r},{g},{b})" for r, g, b in HEAT_COLORS)
    scale = (
        f"<p>Differences: root of the squared error over the squared reference (+ 0.01), mean of channels; 0 "
        f'<span class="scale" style="background: linear-gradient(90deg, {steps})"></span> {largest:.3g} and more.</p>\n'
        if errors
        else ""
    )
    return f'<h2>Pictures</h2>\n{scale}<div class="row">{"".join(figures)}</div>\n'


def _relative_error(picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The root of each pixel's part of relMSE, [height, width]."""
    return np.sqrt((squared_error(picture, reference) / relative_to(reference)).mean(-1))


def _figure(pixels: np.ndarray, caption: str) -> str:
    encoded = base64.b64encode(png(pixels)).decode()
    return (
        f'<figure><img alt="{_text(caption)}" '
        f'src="data:image/png;base64,{encoded}"><figcaption>{_text(caption)}</figcaption></figure>'
    )


def _display(picture: np.ndarray) -> np.ndarray:
    linear = _thumbnail(np.asarray(picture, np.float32))
    return display_pixels(np.concatenate([linear, np.ones_like(linear[..., :1])], -1))[..., :3]


def _heat(error: np.ndarray, largest: float) -> np.ndarray:
    small = _thumbnail(error[..., None])[..., 0]
    shown = np.minimum(small, largest) if largest > 0 else np.zeros_like(small)
    # one pixel more than the picture has, so that all have one scale
    row = np.full((1, shown.shape[1]), largest)
    return heat_pixels(np.concatenate([shown, row]))[0][1:]


def _thumbnail(picture: np.ndarray) -> np.ndarray:
    """Means of squares of pixels, so that the longer side is no more than THUMBNAIL_MOST."""
    step = math.ceil(max(picture.shape[:2]) / THUMBNAIL_MOST)
    if step == 1:
        return picture
    height, width = (max(1, size // step) for size in picture.shape[:2])
    down, across = min(step, picture.shape[0]), min(step, picture.shape[1])
    return picture[: height * down, : width * across].reshape(height, down, width, across, -1).mean((1, 3))


def png(pixels: np.ndarray) -> bytes:
    """A PNG of `pixels`, uint8 [height, width, 3], top row first."""
    encoded = io.BytesIO()
    save_png(encoded, pixels)
    return encoded.getvalue()
