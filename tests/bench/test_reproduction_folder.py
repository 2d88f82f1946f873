"""The folder of a reproduction: gone on with where it was interrupted, never mixed with another."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from bench.reproduce import app
from bench.reproduction.evaluation import gates_of, not_reached
from bench.reproduction.folder import Given, Reproduction, Stage, run_stages
from bench.reproduction.networks import existing
from bench.reproduction.settings import PAPER, SMALL
from droptrack.errors import DroptrackError


class Counted:
    """Stages that count their runs, of which one can be made to fail."""

    def __init__(self) -> None:
        self.runs: list[str] = []
        self.fails = ""

    def stages(self, *names: str) -> list[Stage]:
        return [Stage(name, self._run(name)) for name in names]

    def _run(self, name: str) -> Callable[[Reproduction, Callable[[str], None]], dict[str, Any]]:
        def run(of: Reproduction, _: Callable[[str], None]) -> dict[str, Any]:
            self.runs.append(name)
            of.folder(name).mkdir(exist_ok=True)
            (of.folder(name) / "file").write_text("half")
            if name == self.fails:
                raise KeyboardInterrupt
            return {"of": name, "nan": float("nan")}

        return run


@pytest.fixture
def of(tmp_path: Path) -> Reproduction:
    return Reproduction(tmp_path / "out", SMALL, Given())


def quietly(_: str) -> None:
    pass


def test_killed_in_the_middle_the_next_run_goes_on(of: Reproduction) -> None:
    counted = Counted()
    stages = counted.stages("one", "two", "three")
    counted.fails = "two"
    with pytest.raises(KeyboardInterrupt):
        run_stages(of, stages, quietly)
    assert (of.folder("two") / "file").exists()  # what it made is kept for the next run
    counted.fails = ""
    run_stages(of, stages, quietly)
    assert counted.runs == ["one", "two", "two", "three"]
    assert of.result("three") == {"of": "three", "nan": None}


def test_from_a_stage_on_everything_is_made_again(of: Reproduction) -> None:
    counted = Counted()
    stages = counted.stages("one", "two", "three")
    run_stages(of, stages, quietly)
    run_stages(of, stages, quietly, "two")
    assert counted.runs == ["one", "two", "three", "two", "three"]
    with pytest.raises(DroptrackError, match=r"--stage four: should be one of one, two, three$"):
        run_stages(of, stages, quietly, "four")


def test_a_stage_whose_inputs_changed_runs_again_and_those_after_it(of: Reproduction) -> None:
    counted = Counted()
    one, two, three = counted.stages("one", "two", "three")
    stages = [one, replace(two, inputs=lambda given: [given.real]), three]
    run_stages(of, stages, quietly)
    run_stages(replace(of, given=Given(real=Path("images"))), stages, quietly)
    assert counted.runs == ["one", "two", "three", "two", "three"]


def test_a_folder_of_another_version_or_scale_or_of_something_else_is_refused(
    of: Reproduction,
) -> None:
    run_stages(of, [], quietly)
    with pytest.raises(DroptrackError, match=r"out: is a reproduction at --scale small; choose"):
        run_stages(replace(of, settings=PAPER), [], quietly)
    stamp = of.out / "reproduction.json"
    old = json.loads(stamp.read_text()) | {"droptrack": "0.0.1"}
    stamp.write_text(json.dumps(old))
    with pytest.raises(DroptrackError, match=r"holds results of droptrack 0\.0\.1, this is .*\n?$"):
        run_stages(of, [], quietly)
    stamp.write_text("{")
    with pytest.raises(DroptrackError, match=r"reproduction.json: is damaged; choose another"):
        run_stages(of, [], quietly)
    stamp.unlink()
    (of.out / "thesis.tex").write_text("")
    with pytest.raises(DroptrackError, match="is not empty and no reproduction"):
        run_stages(of, [], quietly)
    assert (of.out / "thesis.tex").exists()


def test_the_command_refuses_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    result = CliRunner().invoke(app, ["--out", str(tmp_path)])
    assert result.exit_code == 1
    assert len(result.output.splitlines()) == 1


def test_weights_that_are_named_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match=r"--full-weights .*none\.weights: no such file"):
        existing(Given(full_weights=tmp_path / "none.weights"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--real", "none"], "--real none: has none of the folders foam, plugs"),
        (["--full-weights", "none.weights"], "--full-weights none.weights: no such file"),
        (["--stage", "figures"], "--stage figures: should be one of data_sets, networks"),
    ],
)
def test_what_is_not_there_is_said_before_anything_is_made(
    tmp_path: Path, options: list[str], said: str
) -> None:
    result = CliRunner().invoke(app, ["--out", str(tmp_path / "out"), *options])
    assert result.exit_code == 1
    assert said in result.output
    assert len(result.output.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def scores(**changed: Any) -> dict[str, Any]:
    perfect = {"n_droplets": 4, "n_droplets_found_in_every_frame": 4, "n_switches": 0, "hota": 1.0}
    return perfect | {"droplets": [{"mse_y_px2": 1e-6}]} | changed


@pytest.mark.parametrize(
    ("flow", "changed", "missed"),
    [
        ("shear", {"n_switches": 1}, "multi-core emulsion: identity switches"),
        (
            "constriction",
            {"n_droplets_found_in_every_frame": 3},
            "dense emulsion: found in every frame",
        ),
        ("constriction", {"hota": 0.98}, "dense emulsion: HOTA"),
        (
            "sine",
            {"droplets": [{"mse_y_px2": 1e-6}, {"mse_y_px2": 2.1e-5}]},
            "synthetic case: mean square error in y of the worst droplet, px²",
        ),
        (
            "shear",
            {"droplets": [{"mse_y_px2": float("nan")}]},
            "multi-core emulsion: mean square error in y of the worst droplet, px²",
        ),
    ],
)
def test_what_is_not_reached_is_named(flow: str, changed: dict[str, Any], missed: str) -> None:
    ours = {name: scores() for name in ("shear", "constriction", "sine")}
    assert not_reached(gates_of(ours)) == []
    assert not_reached(gates_of(ours | {flow: scores(**changed)})) == [missed]
