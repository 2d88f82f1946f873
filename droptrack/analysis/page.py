"""One static page of an analysis: no server, no network, pictures beside it."""

import math
from html import escape

from droptrack.analysis.records import Analysis, Quantity, Snapshot, factor, unit_text
from droptrack.data.units import Units
from droptrack.version import __version__

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem;
  color: #222; background: #fff; }
table { border-collapse: collapse; width: 100%; margin: 1rem 0; }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem;
  border-bottom: 1px solid #ddd; }
td.number { white-space: nowrap; font-variant-numeric: tabular-nums; }
.why, .of, figcaption { color: #555; font-size: .9em; }
figure { margin: 2rem 0; } img { max-width: 100%; height: auto; } h1 { margin-bottom: 0; }
"""


def page_of(name: str, found: Analysis, units: Units) -> str:
    """The page's HTML; pictures and tables are files named ``NAME_FIGURE`` beside it."""
    counts = "".join(_row(key.replace("_", " "), str(n)) for key, n in found.counts.items())
    settings = "".join(_row(key, str(one)) for key, one in found.settings.items())
    notes = "".join(f"<li>{escape(note)}</li>" for note in found.notes)
    figures = "".join(
        _figure(name, figure.name, figure.caption, figure) for figure in found.figures
    )
    tables = "".join(
        f'<li><a href="{name}_{table}.csv">{name}_{table}.csv</a>, {len(rows)} rows</li>'
        for table, rows in found.tables.items()
    )
    quantities = "".join(_quantity(one, units) for one in found.quantities)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(found.title)}</title>
<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>
<h1>{escape(found.title)}</h1>
<p class="of">droptrack {__version__} · <a href="{name}.json">{name}.json</a></p>
<p>{escape(found.about)}</p>
{f"<ul>{notes}</ul>" if notes else ""}
<table><tr><th>quantity</th><th>value</th><th>null model</th></tr>{quantities}</table>
{figures}
{f"<h2>Tables</h2><ul>{tables}</ul>" if tables else ""}
<h2>Counts and settings</h2><table>{counts}{settings}</table>
<p class="of">± is the standard error, by bootstrap over whole droplets.</p>
</body></html>
"""


def error_text(error: float) -> str:
    """An error with two digits.

    >>> error_text(101.3), error_text(0.01234)
    ('100', '0.012')
    """
    return f"{float(f'{error:.2g}'):.6g}"


def _row(key: str, value: str) -> str:
    return f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>"


def _quantity(one: Quantity, units: Units) -> str:
    scale = factor(one.dimension, units)
    unit = unit_text(one.dimension, physical=scale is not None)
    by = scale or 1.0
    if math.isfinite(one.value):
        error = f" ± {error_text(one.error * by)}" if math.isfinite(one.error) else ""
        value = f"{one.value * by:.4g}{error} {unit}"
    else:
        value = "not defined"
    null = f"{one.null * by:.4g} {unit}" if math.isfinite(one.null) else ""
    reason = f'<br><span class="why">{escape(one.reason)}</span>' if one.reason else ""
    model = f'<br><span class="of">{escape(one.null_model)}</span>' if one.null_model else ""
    return (
        f"<tr><td><b>{escape(one.label)}</b><br>"
        f'<span class="of">{escape(one.definition)}</span></td>'
        f'<td class="number">{escape(value)}{reason}</td><td>{escape(null)}{model}</td></tr>\n'
    )


def _figure(name: str, of: str, caption: str, figure: object) -> str:
    table = "" if isinstance(figure, Snapshot) else f' <a href="{name}_{of}.csv">Table</a>'
    return (
        f'<figure><img src="{name}_{of}.png" alt="{escape(caption)}">'
        f"<figcaption>{escape(caption)}{table}</figcaption></figure>\n"
    )
