"""The page of a study: small multiples, a card a video, failed and doubtful ones first."""

import json
import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.files import read_text, write_text
from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError
from droptrack.studies.analyses import FOLDER
from droptrack.studies.jobs import LOG, Job, read_kept
from droptrack.studies.summary import Row

N_BINS = 30
WIDTH, HEIGHT = 240, 56  # of a histogram, px
FILES = ("tracked.mp4", "trajectories.csv", "report.json", "paths.png", LOG)
SHOWN = (  # of a row: what it is called, and how it is written
    ("n_droplets", "droplets", "{:d}"),
    ("n_frames", "frames", "{:d}"),
    ("diameter_um", "diameter / µm", "{:.2f}"),
    ("diameter_px", "diameter / px", "{:.2f}"),
    ("polydispersity", "polydispersity", "{:.3f}"),
    ("frequency_per_s", "frequency / s⁻¹", "{:.3g}"),
    ("speed_um_per_s", "speed / µm s⁻¹", "{:.3g}"),
    ("speed_px_per_frame", "speed / px a frame", "{:.3g}"),
    ("n_coalescence", "coalescences", "{:d}"),
    ("n_break_up", "break-ups", "{:d}"),
    ("n_frames_missing", "frames missing", "{:d}"),
)
STYLE = """
body{font:15px/1.4 system-ui,sans-serif;margin:1.5rem;color:#222;background:#fafafa}
h1{font-size:1.4rem;margin:0 0 .3rem}p{margin:.2rem 0 1rem}
main{display:grid;grid-template-columns:repeat(auto-fill,minmax(17rem,1fr));gap:1rem;
  align-items:start}
article{background:#fff;border:1px solid #ddd;border-top:4px solid #7a9;padding:.7rem}
article.failed,article.left{border-top-color:#c33}article.doubtful{border-top-color:#e90}
h2{font-size:1rem;margin:0 0 .4rem;overflow-wrap:anywhere}img{width:100%;display:block}
dl{display:grid;grid-template-columns:auto 1fr;gap:0 .8rem;margin:.5rem 0}
dt{color:#666}dd{margin:0;text-align:right}nav a{margin-right:.7rem;display:inline-block}
.why{color:#a00;overflow-wrap:anywhere}.doubt{color:#940;overflow-wrap:anywhere}
svg{display:block;width:100%;height:auto}small{color:#666}
"""


def write_page(out: Path, jobs: Sequence[Job], rows: Sequence[Row]) -> None:
    """Write ``index.html``, which needs nothing but the videos' folders."""
    diameters = [
        _diameters(job) if row["state"] == "done" else np.zeros(0)
        for job, row in zip(jobs, rows, strict=True)
    ]
    unit, every = _unit(rows)
    scaled = [
        values * (row["um_per_px"] if every else 1.0) if row["state"] == "done" else values
        for values, row in zip(diameters, rows, strict=True)
    ]
    known = [values for values in scaled if len(values)]
    limits = (min(map(np.min, known)), max(map(np.max, known))) if known else (0.0, 1.0)
    order = sorted(range(len(rows)), key=lambda k: _rank(rows[k]))
    cards = "\n".join(_card(jobs[k], rows[k], scaled[k], limits, unit) for k in order)
    counts = {
        kind: sum(_kind(row) == kind for row in rows) for kind in ("failed", "left", "doubtful")
    }
    said = [f"{len(rows)} videos", *(f"{n} {kind}" for kind, n in counts.items() if n)]
    title = escape(printable(out.absolute().name))
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{title}: droplets</title><style>{STYLE}</style>"
        f"<h1>{title}</h1><p>{', '.join(said)}. Failed and doubtful ones come first. "
        f"Histograms: diameters of droplets, {unit}, all on one axis. "
        '<a href="summary.csv">summary.csv</a></p>'
        f"<main>{cards}</main></html>\n"
    )
    write_text(out / "index.html", text)


def _unit(rows: Sequence[Row]) -> tuple[str, bool]:
    """The unit of the histograms: micrometres if those are known of all videos."""
    done = [row for row in rows if row["state"] == "done"]
    every = bool(done) and all(row["um_per_px"] for row in done)
    return ("µm" if every else "px"), every


def _kind(row: Row) -> str:
    if row["state"] != "done":
        return str(row["state"])
    doubtful = row["warnings"] or row["n_gaps_against_flow"] or not row["n_droplets"]
    return "doubtful" if doubtful else "good"


def _rank(row: Row) -> int:
    return ("failed", "left", "doubtful", "good").index(_kind(row))


def _card(job: Job, row: Row, diameters: Floats, limits: tuple[float, float], unit: str) -> str:
    place = quote(os.fsencode(job.name))
    parts = [f'<h2><a href="{place}/">{escape(row["name"])}</a></h2>']
    if row["state"] != "done":
        parts.append(
            f'<p class="why">{escape(str(row["state"]))}: {escape(str(row["reason"]))}</p>'
        )
    else:
        parts.append(
            f'<a href="{place}/paths.png"><img loading="lazy" alt="paths" src="{place}/paths.png">'
            "</a>"
        )
        parts.append(_histogram(diameters, limits, unit))
    if row["warnings"]:
        parts.append(f'<p class="doubt">{escape(str(row["warnings"]))}</p>')
    parts.append(_list(row, job))
    links = [
        f'<a href="{place}/{file}">{name}</a>'
        for file, name in _files(job)
        if (job.folder / file).is_file()
    ]
    parts.append(f"<nav><small>{' '.join(links)}</small></nav>")
    return f'<article class="{_kind(row)}">{"".join(parts)}</article>'


def _files(job: Job) -> list[tuple[str, str]]:
    """The files in a video's folder that its card links to, and what they are called there."""
    kept = read_kept(job.folder)
    files = [(name, name) for name in FILES]
    if job.config.events is not None:
        tables = [(f"events/{name}.csv", name) for name in ("events", "passages", "stays")]
        plots = sorted((job.folder / "events").glob("*.png")) if job.config.events.plots else []
        files += [*tables, *((f"events/{path.name}", f"plot of {path.stem}") for path in plots)]
    if kept is not None:
        files += [(f"{FOLDER}/{name}.html", f"analysis of {name}") for name in kept.analysed]
    return files


def _list(row: Row, job: Job) -> str:
    """The numbers of a video, in µm where they are known, and the user's own columns."""
    cells = [(name, text) for name, text in job.free.items() if text]
    for name, called, form in SHOWN:
        value = row[name]
        px_too = name.replace("_px_per_frame", "_um_per_s").replace("_px", "_um")
        if value is not None and (px_too == name or row.get(px_too) is None):
            cells.append((called, form.format(value)))
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in cells)
    return f"<dl>{rows}</dl>"


def _diameters(job: Job) -> Floats:
    """The mean diameter of each droplet that has one, px."""
    try:
        droplets = json.loads(read_text(job.folder / "report.json"))["droplets"]
    except (DroptrackError, ValueError, KeyError):
        return np.zeros(0)
    return np.array([one["diameter_px"] for one in droplets if one["diameter_px"] is not None])


def _histogram(values: Floats, limits: tuple[float, float], unit: str) -> str:
    """Bars of how many droplets have which diameter, as SVG."""
    low, high = limits
    if high <= low:
        low, high = low - 0.5, high + 0.5
    counts, _ = np.histogram(values, N_BINS, (low, high))
    tallest, step = max(1, int(counts.max())), WIDTH / N_BINS
    bars = "".join(
        f'<rect x="{k * step:.1f}" y="{HEIGHT * (1 - n / tallest):.1f}" width="{step - 1:.1f}" '
        f'height="{HEIGHT * n / tallest:.1f}"/>'
        for k, n in enumerate(counts.tolist())
        if n
    )
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT + 14}" role="img" aria-label="diameters">'
        f'<g fill="#37a">{bars}</g><line x2="{WIDTH}" y1="{HEIGHT}" y2="{HEIGHT}" stroke="#888"/>'
        f'<g font-size="10" fill="#666"><text y="{HEIGHT + 11}">{low:.3g}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT + 11}" text-anchor="end">{high:.3g} {unit}</text></g></svg>'
    )
