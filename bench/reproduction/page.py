"""The stage ``page``: figures, one static page without server or network, and results.json."""

import json
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from bench.reproduction import sections, sections_of_results
from bench.reproduction.evaluation import gate_line
from bench.reproduction.figures import draw_all
from bench.reproduction.folder import Reproduction, without_nan
from bench.reproduction.sections import Picture, Results, Section, Table
from droptrack.data.files import read_text, write_text
from droptrack.version import __version__

STAGES = ("data_sets", "networks", "simulations", "tracking", "evaluation", "speed", "flock",
          "real")  # fmt: skip
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 64rem; padding: 0 1rem;
  color: #222; background: #fff; }
h1 { margin-bottom: 0; } section { border-top: 1px solid #ccc; margin-top: 2.5rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .92em; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem;
  border-bottom: 1px solid #ddd; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.of, figcaption { color: #555; font-size: .92em; }
.word { background: #f6f3e8; border-left: 4px solid #c9a227; padding: .5rem .8rem; }
.reached { color: #17692f; } .missed { color: #a4161a; font-weight: 700; }
code { background: #f3f3f3; padding: .1rem .3rem; overflow-wrap: anywhere; }
figure { margin: 1.5rem 0; } img { max-width: 100%; height: auto; }
"""


def write_page(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Draw the figures, and write index.html and results.json; returns the gates as text."""
    stages = {name: of.result(name) for name in STAGES}
    found = Results(of.settings, stages)
    draw_all(of, of.out / "figures")
    parts = sections_of(found)
    gates = stages["evaluation"]["gates"]
    times = {name: json.loads(read_text(of.out / f"{name}.json")) for name in STAGES}
    seconds, processor = (
        {name: one[key] for name, one in times.items()} for key in ("seconds", "processor_seconds")
    )
    took = (
        f"Took {_minutes(seconds)}; of processor time {_minutes(processor)}. A stage that was "
        "interrupted counts from where it went on."
    )
    write_text(of.out / "index.html", page_of(found, parts, gates, took))
    content = {
        "made_by": f"droptrack {__version__}",
        "scale": of.settings.scale,
        "machine": stages["speed"]["machine"],
        "seconds": seconds,
        "processor_seconds": processor,
        "must_reach": gates,
        "compared": {
            part.name: [
                {"what": what, "paper": paper, "ours": ours} for what, paper, ours in part.compared
            ]
            for part in parts
        },
        "stages": stages,
    }
    write_text(of.out / "results.json", json.dumps(without_nan(content), indent=1) + "\n")
    say(f"{of.out / 'index.html'}: {len(parts)} sections")
    return {"gates": [gate_line(gate) for gate in gates], "sections": [part.name for part in parts]}


def sections_of(found: Results) -> list[Section]:
    """All sections, in the order of the page."""
    real = sections_of_results.real(found)
    return [
        sections.flows(found),
        sections.scenes(found),
        sections.networks(found),
        sections.frames(found, "shear"),
        sections.paths(found, "shear"),
        sections.frames(found, "constriction"),
        sections.paths(found, "constriction"),
        sections_of_results.inferred(found, "shear"),
        sections_of_results.inferred(found, "sine"),
        sections_of_results.errors(found),
        sections_of_results.speed(found),
        sections_of_results.flock(found),
        sections_of_results.alternatives(found),
        *([real] if real is not None else []),
    ]


def page_of(
    found: Results,
    parts: Sequence[Section],
    gates: Sequence[dict[str, Any]],
    took: str,
) -> str:
    """The page's HTML; figures are files beside it."""
    scale = found.settings.scale
    small = (
        "This is the small scale: flows and trainings are smaller than the paper's, where a "
        "section says so. <code>make reproduce SCALE=paper</code> has the paper's sizes."
        if found.small
        else "This is the paper's scale."
    )
    contents = "".join(f'<li><a href="#{p.name}">{escape(p.title)}</a></li>' for p in parts)
    marks = "".join(
        f'<li class="{"reached" if gate["reached"] else "missed"}">{escape(gate_line(gate))}</li>'
        for gate in gates
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>The paper, reproduced</title>
<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>
<h1>The paper, reproduced</h1>
<p class="of">M. Durve et al., Tracking droplets in soft granular flows with deep learning
techniques (2021) · droptrack {__version__} · scale {escape(scale)} ·
{escape(found["speed"]["machine"])} · <a href="results.json">results.json</a></p>
<p>Each figure and table of the paper beside ours, each with the paper's number, the command that
makes it, and a word where they differ. {small} The paper's figures 3, 4 and 5 are sketches of how
YOLO works; they have no numbers.</p>
<h2>What must be reached</h2><ul>{marks}</ul>
<h2>Contents</h2><ul>{contents}</ul>
{"".join(_section(part) for part in parts)}
<section><p class="of">{escape(took)}</p></section>
</body></html>
"""


def _minutes(seconds: Mapping[str, float]) -> str:
    each = ", ".join(f"{name} {value / 60:.1f}" for name, value in seconds.items())
    return f"{sum(seconds.values()) / 60:.0f} minutes ({each})"


def _section(part: Section) -> str:
    rows = [[what, paper, ours] for what, paper, ours in part.compared]
    compared = Table(
        caption="The paper's and ours", header=("", "the paper", "here"), rows=rows, n_text=1
    )
    return f"""<section id="{part.name}"><h2>{escape(part.title)}</h2>
<p class="of">{escape(part.of_paper)}</p>
<p>{escape(part.text)}</p>
{_table(compared) if rows else ""}
{"".join(_picture(one) for one in part.pictures)}
{"".join(_table(one) for one in part.tables)}
<p class="word">{escape(part.word)}</p>
<p class="of">Command: <code>{escape(part.command)}</code></p></section>
"""


def _picture(one: Picture) -> str:
    path = f"{one.folder}/{one.name}"
    caption = escape(one.caption)
    return (
        f'<figure><img src="{path}.png" alt="{caption}"><figcaption>{caption} '
        f'<a href="{path}.png">PNG</a> <a href="{path}.pdf">PDF</a></figcaption></figure>\n'
    )


def _table(one: Table) -> str:
    n = len(one.header)
    kinds = ["text" if k < one.n_text else "number" for k in range(n - one.text_last)]
    kinds += ["text"] * one.text_last
    head = "".join(
        f'<th class="{kind}">{escape(text)}</th>'
        for kind, text in zip(kinds, one.header, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(
            f'<td class="{kind}">{escape(text)}</td>' for kind, text in zip(kinds, row, strict=True)
        )
        + "</tr>"
        for row in one.rows
    )
    return (
        f'<div class="scroll"><table><caption>{escape(one.caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )
