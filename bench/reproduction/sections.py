"""What the page says, section by section: networks and flows. Every number is a stage's.

Words that judge are chosen by the numbers, so that they stay true when these change.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.reproduction.folder import defined
from bench.reproduction.settings import Settings
from bench.reproduction.simulations import CASES
from bench.reproduction.tracking import OURS, PAPERS_WAY

NOT_GIVEN = "not given"


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with its caption; the first of its columns are text, and maybe the last one."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    n_text: int = 1
    text_last: bool = False


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure: the stem of its files, in a folder, and its caption."""

    name: str
    caption: str
    folder: str = "figures"


@dataclass(frozen=True, kw_only=True)
class Section:
    """One part of the page. `compared`: what, the paper's, ours; `word`: where and why they differ.

    `command`: makes it, or the like, outside of this reproduction.
    """

    name: str
    title: str
    of_paper: str
    text: str
    compared: Sequence[tuple[str, str, str]]
    command: str
    word: str
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()


@dataclass(frozen=True)
class Results:
    """What all stages found, by their names."""

    settings: Settings
    stages: Mapping[str, Any]

    @property
    def small(self) -> bool:
        """Whether this is not the paper's size."""
        return self.settings.scale != "paper"

    def __getitem__(self, stage: str) -> Any:
        return self.stages[stage]

    def scores(self, flow: str, method: str) -> Mapping[str, Any]:
        """The scores of a method on the clean video of a flow."""
        found: Mapping[str, Any] = self["evaluation"]["methods"][flow][method]
        return found


def number(value: object, digits: int = 3) -> str:
    """A number as text; what is not defined says so.

    >>> number(0.0123456), number(None)
    ('0.0123', 'not defined')
    """
    if not defined(value):
        return "not defined"
    return str(value) if isinstance(value, int) else f"{float(str(value)):.{digits}g}"


def score_text(value: object) -> str:
    """A score from 0 to 1 with four decimals."""
    return f"{float(str(value)):.4f}" if defined(value) else "not defined"


def scenes(found: Results) -> Section:
    """The data sets (the paper's figure 14)."""
    sets = found["data_sets"]
    tiny, full = sets["tiny"], sets["full"]
    as_many = (
        "The networks below see images drawn while they are trained, so a small data set costs "
        "nothing but these files." if found.small else "As many as the paper has."
    )  # fmt: skip
    return Section(
        name="scenes",
        title="Synthetic scenes and their labels",
        of_paper="Figure 14",
        text="Images that a program draws, 1200 x 600 px, and the boxes of the droplets in them: "
        "nobody labels anything by hand.",
        compared=[
            ("images of scenes a and b, training + validation", "10000 + 1000", _images(tiny)),
            ("images of scene c, training + validation", "10000 + 1000", _images(full)),
        ],
        command="python -m data_gen.make_dataset --scene tiny|full --out DIR",
        word=f"Drawn from the paper's description; its own images were not published. {as_many}",
        pictures=[
            Picture(
                name="scenes",
                caption="One image of each scene with the boxes of its labels, and the label file "
                "of (b), in fractions of the image.",
            )
        ],
    )


def _images(one: Mapping[str, Any]) -> str:
    return f"{one['n_images']} + {one['n_valid']}"


def networks(found: Results) -> Section:
    """Loss and mAP (the paper's figure 6)."""
    nets = found["networks"]
    rows = [_network_row(one, row) for one in nets.values() for row in one.get("scenes", ())]
    missing = {name: one["missing"] for name, one in nets.items() if "missing" in one}
    bundled = {row["scene"]: row["map_50"] for row in nets["bundled"]["scenes"]}
    compared = [
        ("mAP@0.50 of YOLOv3-tiny on scenes a and b", "0.985", _maps(nets["tiny"])),
        ("mAP@0.50 of YOLOv3 on scene c", "0.99", _maps(nets["full"])),
        (
            "mAP@0.50 of the bundled model, which the clean videos below are tracked with",
            "none",
            ", ".join(f"{scene} {score_text(value)}" for scene, value in bundled.items()),
        ),
    ]
    logged = [one for one in nets.values() if one.get("log")]
    pictures = []
    if logged:
        pictures = [Picture(name="training", caption=_caption_of_training(logged))]
    return Section(
        name="networks",
        title="Loss and mean average precision of the networks",
        of_paper="Figure 6",
        text="mAP@0.50 by Darknet's definition on validation images that no training saw; "
        "precision and recall at a score of 0.25.",
        compared=compared,
        command=next(
            (one["command"] for one in nets.values() if one.get("trained_here")),
            "make train-tiny; make train",
        ),
        word=_word_on_networks(found, missing),
        pictures=pictures,
        tables=[
            Table(
                caption="Every network that is at hand, by scene",
                header=("network", "scene", "images", "mAP@0.50", "precision", "recall",
                        "mean IoU", "COCO's AP@0.50:0.95"),
                rows=rows,
                n_text=2,
            )
        ],
    )  # fmt: skip


def _network_row(one: Mapping[str, Any], row: Mapping[str, Any]) -> list[str]:
    keys = ("map_50", "precision", "recall", "average_iou", "coco_ap_50_95")
    return [
        f"{one['title']} ({one['network']})", row["scene"], str(row["n_images"]),
        *(score_text(row[key]) for key in keys),
    ]  # fmt: skip


def _maps(one: Mapping[str, Any]) -> str:
    if "missing" in one:
        return "not trained here"
    return ", ".join(f"{row['scene']} {score_text(row['map_50'])}" for row in one["scenes"])


def _caption_of_training(logged: Sequence[Mapping[str, Any]]) -> str:
    each = [
        f"{one['title']}: {one['log']['iterations'][-1]} iterations in "
        f"{one['log']['seconds'] / 60:.0f} minutes"
        for one in logged
    ]
    return (
        "Average loss as Darknet prints it, and mAP@0.50, as the training goes on. "
        f"{'; '.join(each)}."
    )


def _word_on_networks(found: Results, missing: Mapping[str, str]) -> str:
    nets = found["networks"]
    words = []
    tiny = nets["tiny"]
    if tiny.get("trained_here") and found.small:
        n = found.settings.tiny.iterations
        reached = min(row["map_50"] for row in tiny["scenes"])
        how = "below" if reached < 0.985 else "not below"
        words.append(
            f"The tiny network was trained for {n} iterations only, to show that it learns; its "
            f"mAP is {how} the paper's. The 3,400 of SCALE=paper reached 0.9955 (a) and 0.9975 (b) "
            "when they were run (docs/training.md)."
        )
    words += [
        f"The paper's {'YOLOv3-tiny' if name == 'tiny' else 'YOLOv3'} has no trained weights here: "
        f"no mAP and no loss is shown for it. What it needs: {needs}."
        for name, needs in missing.items()
    ]
    words.append(
        "The bundled model is a YOLOv3-tiny with a larger input, trained on all of the paper's "
        "scenes and deformed droplets; one network does here what the paper needs two for."
    )
    return " ".join(words)


def flows(found: Results) -> Section:
    """What was simulated (the paper's figures 1 and 2)."""
    shear, dense = found["simulations"]["shear"], found["simulations"]["constriction"]
    size = " x ".join(str(side) for side in dense["size_px"])
    word = "The paper's parameters; what it leaves open is said in docs/simulations.md."
    if found.small:
        word = (
            f"{found.settings.shear_steps} steps of shear instead of 150000, and "
            f"{dense['n_droplets']} droplets instead of 49 on {size} nodes, so that both "
            "simulations end within minutes; SCALE=paper has the paper's sizes. What the paper "
            "leaves open is said in docs/simulations.md."
        )
    return Section(
        name="flows",
        title="The two simulated flows",
        of_paper="Figures 1 and 2",
        text="A free-energy lattice Boltzmann model of cores in a sheared shell (appendix B), and "
        "a colour-gradient model of a dense emulsion that squeezes through a constriction "
        "(appendix A). Each droplet's centre of mass is known in every frame.",
        compared=[
            ("cores in the shell", "4", str(shear["n_droplets"])),
            ("droplets in the dense emulsion", "49", str(dense["n_droplets"])),
            ("droplets through the constriction", NOT_GIVEN, number(dense.get("n_through"))),
            (
                "pieces of a droplet, at most",
                NOT_GIVEN,
                number(dense.get("max_pieces_of_a_droplet")),
            ),
        ],
        command=f"{shear['command']}; {dense['command']}",
        word=word,
        pictures=[
            Picture(
                name="flows",
                caption=f"First, middle and last frame; {shear['n_frames']} and "
                f"{dense['n_frames']} frames.",
            )
        ],
    )


def frames(found: Results, flow: str) -> Section:
    """Four sequential frames with boxes and identities (the paper's figures 7 and 9)."""
    dense = flow == "constriction"
    scores = found.scores(flow, PAPERS_WAY)
    n, every = scores["n_droplets"], scores["n_droplets_found_in_every_frame"]
    network = "the full YOLOv3" if dense else "YOLOv3-tiny"
    return Section(
        name=f"{flow}_frames",
        title=f"{CASES[flow].capitalize()}: four frames with boxes and identities",
        of_paper="Figure 9" if dense else "Figure 7",
        text="Boxes of the bundled model, identities of DeepSORT.",
        compared=[
            ("droplets with a box in all frames of the video", _all(dense), f"{every} of {n}"),
            ("identity switches", NOT_GIVEN, str(scores["n_switches"])),
        ],
        command="python -m droptrack.track VIDEO --tracker deepsort --out DIR",
        word=f"The paper uses {network} here; this is the bundled tiny one."
        + (
            " The paper reports that its tiny network makes many mistakes on the dense emulsion."
            if dense
            else ""
        ),
        pictures=[
            Picture(
                name=f"{flow}_frames",
                caption="The paper's frame numbers; blue boxes and numbers as in the paper.",
            )
        ],
    )


def _all(dense: bool) -> str:
    return f"{49 if dense else 4} trajectories"


def paths(found: Results, flow: str) -> Section:
    """The trajectories (the paper's figures 8 and 10)."""
    dense = flow == "constriction"
    scores = found.scores(flow, OURS)
    n = scores["n_droplets"]
    differs = f"{n} droplets here, 49 in the paper. " if dense and n != 49 else ""
    return Section(
        name=f"{flow}_paths",
        title=f"{CASES[flow].capitalize()}: trajectories",
        of_paper="Figure 10" if dense else "Figure 8",
        text="The centre of mass of each droplet over the whole video, tracked by droptrack with "
        "its defaults.",
        compared=[
            ("trajectories", "49" if dense else "4", str(scores["n_tracks"])),
            ("droplets found in every frame", NOT_GIVEN, _share(scores)),
            ("identity switches", NOT_GIVEN, str(scores["n_switches"])),
            ("false positions", NOT_GIVEN, str(scores["n_false"])),
        ],
        command="python -m droptrack.track VIDEO --out DIR",
        word=f"{differs}The paper counts trajectories; it does not say whether each is complete. "
        "Here the ground truth of the simulation tells.",
        pictures=[
            Picture(name=f"{flow}_paths", caption="A colour a droplet; dots: where each begins.")
        ],
    )


def _share(scores: Mapping[str, Any]) -> str:
    return f"{scores['n_droplets_found_in_every_frame']} of {scores['n_droplets']}"
