"""What the page says, section by section: accuracy, speed, flocks, and what one would pick instead.

Words that judge are chosen by the numbers, so that they stay true when these change.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from bench.reproduction.figures import clip_title
from bench.reproduction.folder import defined
from bench.reproduction.sections import (
    NOT_GIVEN,
    Picture,
    Results,
    Section,
    Table,
    number,
    score_text,
)
from bench.reproduction.simulations import CASES, FLOWS
from bench.reproduction.speed import PAPER_FPS
from bench.reproduction.tracking import OURS, PAPERS_WAY

PAPER_CORES = (3.44e-2, 1.80e-2, 3.12e-2, 1.59e-2)  # its figure 11
PAPER_SINE = (1.41e-4, 1.52e-4, 1.55e-4, 1.45e-4)  # its figure 12
NO_UNIT = (
    "The paper gives no unit to its mean square error, and no size of its images in px; taken as "
    "px², ours is compared in that unit, and stands in two more in the table of all droplets."
)
ERRORS = ("mse_y_px2", "mse_y_heights2", "mse_y_diameters2")


def inferred(found: Results, flow: str) -> Section:
    """Inferred against true y (the paper's figures 11 and 12)."""
    sine = flow == "sine"
    scores = found.scores(flow, OURS)
    each = [row["mse_y_px2"] for row in scores["droplets"]]
    worst = max((one for one in each if one is not None), default=None)
    paper = PAPER_SINE if sine else PAPER_CORES
    pictures = [
        Picture(
            name=f"{flow}_y",
            caption="y of four droplets over the frames, true (black) and inferred (red); below "
            "each, the difference. Where the lines lie on each other, only the lower panel "
            "shows what is left.",
        )
    ]
    if sine:
        pictures.append(
            Picture(name="sine_frames", caption="Boxes and identities, as the paper's figure 15.")
        )
    return Section(
        name=f"{flow}_y",
        title=f"{CASES[flow].capitalize()}: inferred against true y",
        of_paper="Figures 12 and 15" if sine else "Figure 11",
        text="The paper takes the box's centre for the centre of mass. droptrack measures the "
        "centre of mass in the image.",
        compared=[
            ("mean square error in y of each droplet, px²", _list(paper), _list(each)),
            ("of the worst droplet", number(max(paper)), number(worst)),
            ("of the best droplet", number(min(paper)), number(_least(each))),
            (
                "of all, the paper's way (box centres)",
                NOT_GIVEN,
                number(found.scores(flow, PAPERS_WAY)["mse_y_px2"]),
            ),
        ],
        command=f"{found['simulations'][flow]['command']}; python -m droptrack.track "
        "DIR/video.avi --out DIR; python -m droptrack.evaluate DIR/truth.csv DIR/trajectories.csv",
        word=f"{_factor(worst, min(paper))} {NO_UNIT}"
        + (
            ""
            if sine
            else " The paper sees deviations in the first frames; the lower panels show ours."
        )
        + _word_on_box_centres(
            found.scores(flow, PAPERS_WAY)["mse_y_px2"], paper, "full" if sine else "tiny"
        ),
        pictures=pictures,
    )


def _list(values: Sequence[object], most: int = 4) -> str:
    shown = ", ".join(number(one) for one in values[:most])
    return shown + (f" … ({len(values)} droplets)" if len(values) > most else "")


def _least(values: Sequence[float | None]) -> float | None:
    return min((one for one in values if one is not None), default=None)


def _factor(worst: float | None, best_of_paper: float) -> str:
    """How the worst droplet here compares with the paper's best one."""
    if worst is None or not worst > 0:
        return "Our worst droplet has no error that could be compared."
    if worst < best_of_paper:
        return (
            f"Our worst droplet's error is {best_of_paper / worst:.3g} times smaller than that of "
            "the paper's best droplet."
        )
    return (
        f"Our worst droplet's error is {worst / best_of_paper:.3g} times that of the paper's best "
        "droplet: larger than the paper's."
    )


def _word_on_box_centres(ours: float | None, paper: Sequence[float], network: str) -> str:
    """How the paper's way of measuring does here, beside the paper's own numbers."""
    if not defined(ours) or ours is None or not ours > 0:
        return ""
    mean = sum(paper) / len(paper)
    ratio, how = (ours / mean, "larger") if ours > mean else (mean / ours, "smaller")
    return (
        f" Box centres, the paper's way, have an error {ratio:.3g} times {how} here than the "
        f"mean of the paper's: boxes are of the bundled tiny network, there of a {network} one."
    )


def errors(found: Results) -> Section:
    """The error of every droplet, in three units."""
    tables = []
    for flow in FLOWS:
        one = found.scores(flow, OURS)
        rows = [
            [str(row["track_id"]), str(row["n_missed"]), str(row["n_switches"]),
             *(number(row[key]) for key in ERRORS)]
            for row in one["droplets"]
        ]  # fmt: skip
        rows.append(["all", str(one["n_missed"]), str(one["n_switches"]),
                     *(number(one[key]) for key in ERRORS)])  # fmt: skip
        tables.append(
            Table(
                caption=clip_title(flow).capitalize(),
                header=("droplet", "missed", "switches", "px²", "(y/H)²", "diameters²"),
                rows=rows,
            )
        )
    return Section(
        name="errors",
        title="Error of each droplet, in px², (y/H)² and diameters²",
        of_paper="Figures 11 and 12",
        text="Mean square error in y, equation 1 of the paper; H is the image's height.",
        compared=[],
        command="python -m droptrack.evaluate DIR/truth.csv DIR/trajectories.csv",
        word="In the simulations the truth is the centre of mass of a fluid. The image hides a "
        "part of it in the dark films, so that no method can reach zero.",
        tables=tables,
    )


def speed(found: Results) -> Section:
    """Frames a second (the paper's table 1)."""
    one = found["speed"]
    rows, compared = [], []
    for row in one["rows"]:
        rates = [row[key] for key in ("network_alone_fps", "with_deepsort_fps",
                                      "with_droptrack_fps")]  # fmt: skip
        texts = [row[key] for key in ("network", "weights", "input", "engine")]
        boxes = f"{row['boxes_per_frame']:.1f}"
        rows.append([*texts, boxes, *(number(one) for one in rates)])
    for name, (cpu, gpu) in PAPER_FPS.items():
        for where, theirs, is_gpu in (("CPU", cpu, False), ("GPU", gpu, True)):
            mine = [row for row in one["rows"] if row["network"] == name and row["gpu"] is is_gpu]
            best = max(mine, key=lambda row: row["with_deepsort_fps"], default=None)
            ours = "no GPU on this machine" if is_gpu and not one["gpu"] else "not measured"
            if best is not None:
                ours = f"{number(best['with_deepsort_fps'])} ({best['engine']})"
            compared.append((f"{name} + DeepSORT, {where}, frames/s", number(theirs), ours))
    return Section(
        name="speed",
        title="Frames a second",
        of_paper="Table 1",
        text="The network alone, one image after the other; and end to end, from the video's file "
        "to trajectories, with DeepSORT and with droptrack's own tracker.",
        compared=compared,
        command="python -m bench.engines speed",
        word=f"Measured on {one['machine']}{', ' + one['gpu'] if one['gpu'] else ''}, while other "
        "programs may have run; the paper's machines are an i3-2328M and an RTX 2060 Super. Where "
        "no trained weights are at hand they are random: the network takes as long, but what it "
        "finds is random, and with it the tracker's part of the time. The paper does not say its "
        "input size; 416 x 416 is the usual one. Careful figures are in docs/performance.md.",
        tables=[
            Table(
                caption="Frames a second; end to end without the annotated video",
                header=("network", "weights", "input", "engine", "boxes a frame",
                        "network alone", "with DeepSORT", "with droptrack's tracker"),
                rows=rows,
                n_text=4,
            )
        ],
    )  # fmt: skip


def flock(found: Results) -> Section:
    """Do droplets flock (the paper's figure 13)."""
    one = found["flock"]
    main = one["main"]
    radius = main["radius_diameters"]
    rows = [
        [number(row["radius_diameters"]),
         *(number(row[whose][key]) for whose in ("ours", "truth") for key in ("share", "shuffled"))]
        for row in one["radii"]
    ]  # fmt: skip
    quantities = [
        [row["label"], number(row["value"]), number(row["error"]),
         number(row["null"]) if row["null_model"] else "", row["reason"] or row["null_model"]]
        for row in one["quantities"]
    ]  # fmt: skip
    return Section(
        name="flock",
        title="Flocks of droplets?",
        of_paper="Figure 13",
        text="Share of droplets and frames whose heading differs by less than 0.12 rad from the "
        f"mean heading of the neighbours within R = {number(main['radius_px'])} px, "
        f"{number(radius)} median diameters.",
        compared=[
            ("share with |theta_i - theta_S| < 0.12 rad", "0.47",
             f"{number(main['share'])} ± {number(main['share_error'], 1)}"),
            ("the same, headings shuffled among the droplets of a frame", NOT_GIVEN,
             number(main["share_shuffled"])),
        ],
        command="python -m droptrack.analyse flock DIR/trajectories.csv --out DIR",
        word=_word_on_flocks(one),
        pictures=[
            Picture(name=name, folder="flock", caption=caption)
            for name, caption in one["captions"].items()
        ],
        tables=[
            Table(
                caption="The share by the radius, in the median diameter of each",
                header=("R, diameters", "our trajectories", "shuffled", "ground truth",
                        "shuffled"),
                rows=rows,
            ),
            Table(
                caption="All quantities of the analysis; ± is the standard error, by bootstrap "
                "over droplets",
                header=("quantity", "value", "±", "null model", "which, or why not defined"),
                rows=quantities,
                text_last=True,
            ),
        ],
    )  # fmt: skip


def _word_on_flocks(one: Mapping[str, Any]) -> str:
    shares = [row["ours"]["share"] for row in one["radii"] if defined(row["ours"]["share"])]
    swept = [row["radius_diameters"] for row in one["radii"]]
    words = [
        "The paper's R is 30 px, but it does not say how large its droplets are in px; so R is "
        "given in diameters here. A flow that carries all droplets the same way aligns strangers, "
        "too: with the headings shuffled among the droplets of a frame the share is still "
        f"{number(one['main']['share_shuffled'])}, so that a share alone says little."
    ]
    if shares:
        words.append(
            f"Over R from {number(min(swept))} to {number(max(swept))} diameters the share is "
            f"{number(min(shares))} to {number(max(shares))}."
        )
    return " ".join(words)


def alternatives(found: Results) -> Section:
    """What one would pick instead, in the same table."""
    methods = found["evaluation"]["methods"]
    tables = []
    for clip, rows in methods.items():
        tables.append(
            Table(
                caption=clip_title(clip).capitalize(),
                header=("method", "in every frame", "missed", "switches", "false", "MOTA",
                        "IDF1", "HOTA", "MSE of y, px²", "frames/s", "setting"),
                rows=[_method_row(name, one) for name, one in rows.items()],
                text_last=True,
            )
        )  # fmt: skip
    return Section(
        name="alternatives",
        title="What one would pick instead",
        of_paper="not in the paper",
        text="The same videos, clean and degraded (out of focus, light that falls to half, half "
        "the contrast, noise), by other methods. Settings of thresholds, watershed and "
        "trackpy.locate are those of a few that find most on four frames by the ground truth: "
        "more than a user can do. Which of its two bundled models droptrack takes, it chooses by "
        "itself from some frames; the setting says which. MOTA, IDF1 and HOTA by TrackEval.",
        compared=[],
        command="make reproduce",
        word=_where_it_pays(methods),
        pictures=[Picture(name="methods", caption="HOTA of each method on each video.")],
        tables=tables,
    )


def _method_row(name: str, one: Mapping[str, Any]) -> list[str]:
    return [
        name, f"{one['n_droplets_found_in_every_frame']} of {one['n_droplets']}",
        *(str(one[key]) for key in ("n_missed", "n_switches", "n_false")),
        *(score_text(one[key]) for key in ("mota", "idf1", "hota")),
        number(one["mse_y_px2"]), number(one["frames_per_second"]), one["setting"],
    ]  # fmt: skip


def _where_it_pays(methods: Mapping[str, Mapping[str, Any]]) -> str:
    """In a sentence a video: the best of the others, against ours."""
    words = []
    for clip, rows in methods.items():
        others = {name: one for name, one in rows.items() if _without_network(name)}
        if not others:
            continue
        name, best = max(others.items(), key=lambda item: item[1]["hota"] or 0)
        ours = rows[OURS]
        verdict = "the network earns its cost"
        if (best["hota"] or 0) >= (ours["hota"] or 0) - 0.005:
            verdict = "the network earns nothing here"
        words.append(
            f"{clip_title(clip).capitalize()}: {name} has a HOTA of {score_text(best['hota'])}, "
            f"droptrack {score_text(ours['hota'])}, at {number(best['frames_per_second'])} and "
            f"{number(ours['frames_per_second'])} frames/s: {verdict}."
        )
    return " ".join(words) or "Nothing else was tried."


def _without_network(name: str) -> bool:
    return name.startswith(("threshold", "watershed", "trackpy.locate"))


def real(found: Results) -> Section | None:
    """Real images, where they were given."""
    sets = found["real"]
    if not sets:
        return None
    return Section(
        name="real",
        title="Real images",
        of_paper="not in the paper",
        text="Labelled images of experiments: what the bundled models and other methods find.",
        compared=[],
        command="python -m bench real DIR",
        word="The best fixed scale, and the best setting of each other method, are chosen by the "
        "labels: more than a user can do. The scale that the images suggest needs no label.",
        tables=[
            Table(
                caption=name,
                header=("method", "AP@0.50", "recall", "precision"),
                rows=[
                    [row["method"], *(number(row[key]) for key in ("ap50", "recall", "precision"))]
                    for row in rows
                ],
            )
            for name, rows in sets.items()
        ],
    )
