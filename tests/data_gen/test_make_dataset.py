import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from typer.testing import CliRunner

from data_gen.make_dataset import app
from data_gen.scenes.dataset import Recipe, make_dataset
from data_gen.scenes.scene_kinds import SCENES
from droptrack.data.darknet_dataset import read_data_file, read_ground_truth, read_image
from droptrack.errors import DroptrackError


def digest(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def make(folder: Path, recipe: Recipe, workers: int = 1) -> None:
    *_, done = make_dataset(folder, recipe, workers)
    assert done == recipe.images + recipe.valid


def test_same_seed_gives_the_same_bytes_whatever_the_number_of_workers(tmp_path: Path) -> None:
    recipe = Recipe(scene="all", images=40, valid=5, seed=3)
    make(tmp_path / "one", recipe)
    make(tmp_path / "two", recipe, workers=2)
    assert digest(tmp_path / "one") == digest(tmp_path / "two")
    make(tmp_path / "other", Recipe(scene="all", images=40, valid=5, seed=4))
    assert digest(tmp_path / "one") != digest(tmp_path / "other")


def test_labels_read_back_are_the_boxes_that_were_drawn(tmp_path: Path) -> None:
    make(tmp_path / "data", Recipe(scene="tiny", images=4, valid=1, seed=8))
    data = read_data_file(tmp_path / "data" / "obj.data")
    assert data.names == ("droplet",)
    assert (len(data.train), len(data.valid)) == (4, 1)
    for index, path in enumerate(data.train):
        scene = SCENES["ab"[index % 2]](np.random.default_rng([8, 0, index]))
        truth = read_ground_truth(path, 1200, 600)
        np.testing.assert_allclose(truth.boxes, scene.boxes, atol=0.01)
        grey = read_image(path)[..., 0].astype(float)
        assert np.abs(grey - scene.image).mean() < 1


def test_an_interrupted_data_set_is_completed_to_the_same_bytes(tmp_path: Path) -> None:
    recipe = Recipe(scene="c", images=70, valid=3, seed=1)
    make(tmp_path / "whole", recipe)
    progress = make_dataset(tmp_path / "cut", recipe, 1)
    next(progress), next(progress)
    progress.close()
    assert len(list((tmp_path / "cut" / "train").glob("*.txt"))) == 32
    (tmp_path / "cut" / "train" / "000040.jpg").write_bytes(b"half an ima")  # no label yet
    make(tmp_path / "cut", recipe)
    assert digest(tmp_path / "cut") == digest(tmp_path / "whole")


@pytest.mark.parametrize("killed", ["the first process", "one that draws", "all, by Ctrl-C"])
def test_a_data_set_whose_drawing_was_killed_is_completed_to_the_same_bytes(
    tmp_path: Path, killed: str
) -> None:
    recipe = Recipe(scene="a", images=700, valid=1, seed=1)
    command = [
        sys.executable, "-m", "data_gen.make_dataset", "--scene=a", "--images=700", "--valid=1",
        "--seed=1", f"--out={tmp_path / 'cut'}", "--workers=2",
    ]  # fmt: skip
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as first:
        while not list(tmp_path.glob("cut/train/*40.txt")):
            assert first.poll() is None
            time.sleep(0.05)
        drawing = [
            one
            for one in psutil.Process(first.pid).children()
            if "spawn_main" in " ".join(one.cmdline())
        ]
        if killed == "the first process":
            first.kill()
        elif killed == "one that draws":
            drawing[-1].kill()
        else:
            os.killpg(first.pid, signal.SIGINT)
        said = first.communicate(timeout=60)[1]
    assert "Traceback" not in said
    assert ("ended by itself" in said) == (killed == "one that draws")
    assert ("resumes it" in said) == (killed == "all, by Ctrl-C")
    assert psutil.wait_procs(drawing, timeout=20)[1] == []
    assert 0 < len(list((tmp_path / "cut" / "train").glob("*.txt"))) < recipe.images
    make(tmp_path / "cut", recipe, workers=2)
    make(tmp_path / "whole", recipe, workers=2)
    assert digest(tmp_path / "cut") == digest(tmp_path / "whole")


def test_a_share_of_the_images_is_degraded_and_no_label(tmp_path: Path) -> None:
    make(tmp_path / "drawn", Recipe(scene="c", images=40, valid=4, seed=1))
    make(tmp_path / "degraded", Recipe(scene="c", images=40, valid=4, seed=1, degraded=0.5))
    drawn, degraded = digest(tmp_path / "drawn"), digest(tmp_path / "degraded")
    changed = [name for name in drawn if drawn[name] != degraded[name]]
    images = [name for name in changed if name.endswith(".jpg")]
    assert 12 <= len(images) <= 32
    assert set(changed) - set(images) == {"dataset.json"}


def test_a_data_set_from_before_images_could_be_degraded_is_completed(tmp_path: Path) -> None:
    recipe = Recipe(scene="c", images=3, valid=1, seed=1)
    make(tmp_path, recipe)
    manifest = tmp_path / "dataset.json"
    manifest.write_text(manifest.read_text().replace('"spoilt": 0.0,', ""))
    assert "spoilt" not in manifest.read_text()
    make(tmp_path, recipe)
    with pytest.raises(DroptrackError, match="of other degraded"):
        make(tmp_path, replace(recipe, degraded=1))


def test_the_former_name_of_an_option_still_works_and_is_hidden(tmp_path: Path) -> None:
    for option in ("--degraded", "--spoilt"):
        size = ["--images", "6", "--valid", "1", "--workers", "1"]
        arguments = ["--scene", "c", *size, option, "0.5", "--out", str(tmp_path / option)]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output
    assert digest(tmp_path / "--degraded") == digest(tmp_path / "--spoilt")
    assert "--spoilt" not in CliRunner().invoke(app, ["--help"]).output


def test_another_data_set_is_not_overwritten(tmp_path: Path) -> None:
    make(tmp_path, Recipe(scene="a", images=2, valid=1, seed=1))
    before = digest(tmp_path)
    with pytest.raises(DroptrackError, match="data set of other images"):
        make(tmp_path, Recipe(scene="a", images=3, valid=1, seed=1))
    assert digest(tmp_path) == before


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(DroptrackError, match="not empty"):
        make(tmp_path, Recipe(scene="a", images=2, valid=1, seed=1))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("0 0.5 0.5 0.1\n", "class x y width height"),
        ("droplet 0.5 0.5 0.1 0.1\n", "class x y width height"),
        ("0 0.5 1.5 0.1 0.1\n", "between 0 and 1"),
    ],
)
def test_a_damaged_label_file_is_named(tmp_path: Path, line: str, problem: str) -> None:
    make(tmp_path, Recipe(scene="a", images=1, valid=1, seed=1))
    (tmp_path / "train" / "000000.txt").write_text(line)
    with pytest.raises(DroptrackError, match=rf"000000\.txt.*{problem}"):
        read_ground_truth(tmp_path / "train" / "000000.jpg", 1200, 600)


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held here")
def test_ctrl_c_while_processes_start_is_one_line(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "data_gen.make_dataset", "--scene=a", "--images=700", "--valid=1",
        f"--out={tmp_path / 'cut'}", "--workers=2",
    ]  # fmt: skip
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as first:
        while not any(map(imports_numpy, psutil.Process(first.pid).children())):
            assert first.poll() is None
            time.sleep(0.01)
        os.killpg(first.pid, signal.SIGINT)  # long before it is ready to draw
        said = first.communicate(timeout=120)[1]
    assert "Traceback" not in said
    assert "resumes it" in said


def imports_numpy(process: psutil.Process) -> bool:
    """Whether a process that is to draw has begun with its imports."""
    try:
        return "spawn_main" in " ".join(process.cmdline()) and any(
            "numpy" in one.path for one in process.memory_maps()
        )
    except psutil.Error:  # it has ended
        return False
