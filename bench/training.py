"""Speed of training: ``python -m bench.training``, PyTorch against the Darknet of $DARKNET.

Both train the same network from the same start on the same pictures, at the cfg's input size,
one after the other on this machine; the ratios are of that run. Without $DARKNET only PyTorch.
"""

import resource
import statistics
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file
from droptrack.network.bundled import BUNDLED
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, with_options
from droptrack.training.darknet.binary import DarknetSettings, find_darknet, identify
from droptrack.training.darknet.training import DarknetTraining
from droptrack.training.log import Step
from droptrack.training.pytorch.devices import choose_devices
from droptrack.training.pytorch.training import Job, Settings, train

app = new_app()
WARM_UP = 2  # iterations that are not counted


def images_a_second(steps: Iterable[Step], batch: int) -> float:
    """The median over the iterations after the first ones."""
    seconds = [step.seconds for step in steps if step.iteration > WARM_UP]
    return batch / statistics.median(seconds)


def memory_mb() -> float:
    """The most memory this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@app.command()
@one_line_errors
def main(
    cfg: Annotated[Path, typer.Option()] = BUNDLED / "yolov3-tiny.cfg",
    batch: Annotated[int, typer.Option(min=2)] = 16,
    iterations: Annotated[int, typer.Option(min=WARM_UP + 1)] = 12,
    workers: Annotated[int, typer.Option(min=0)] = 1,
) -> None:
    """Images a second of each trainer, and as a ratio to the first."""
    changes = {"batch": batch, "subdivisions": 1, "max_batches": iterations, "burn_in": 10_000}
    net = {key: str(value) for key, value in changes.items()}
    rates: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for _ in make_dataset(
            folder / "data", Recipe(scene="tiny", images=200, valid=8, seed=1), 1
        ):
            pass
        data = read_data_file(folder / "data" / "obj.data")
        network = _copy(folder, with_options(read_cfg(cfg), net, {"random": "0"}))
        binary = find_darknet(None)
        if binary is not None:
            darknet = identify(binary)
            out = folder / "darknet"
            out.mkdir()
            settings = DarknetSettings("", 10_000, 10_000, 0, 1800)
            training = DarknetTraining(
                darknet, _copy(out, network), data, out, settings, lambda _: float("nan")
            )
            rates[f"Darknet of {darknet.fork}"] = images_a_second(
                training.steps(None, resume=False), batch
            )
        how = Settings(
            iterations,
            batch,
            1,
            "sgd",
            network.net.number("learning_rate"),
            None,
            None,
            0,
            workers,
            10_000,
            10_000,
            1,
            0,
            choose_devices("", batch, 1),
            False,
        )
        growth = 0.0
        for bf16 in (False, True):
            out = folder / f"torch-{bf16}"
            out.mkdir()
            steps = train(Job(network, data, out, replace(how, bf16=bf16)))
            kept = [next(steps) for _ in range(WARM_UP + 1)]
            before = memory_mb()
            while len(kept) < iterations - 1:  # the last one measures a mAP, too
                kept.append(next(steps))
            growth = max(growth, memory_mb() - before)
            steps.close()
            label = f"PyTorch {'bf16' if bf16 else 'fp32'} on {how.devices[0]}"
            rates[label] = images_a_second(kept, batch)
    first = next(iter(rates.values()))
    table = Table(
        "trainer",
        "images/s",
        "ratio",
        title=f"{cfg.name}, {network.width} x {network.height}, batch {batch}",
    )
    for name, rate in rates.items():
        table.add_row(name, f"{rate:.1f}", f"{rate / first:.2f}")
    Console().print(table)
    typer.echo(
        f"most memory, grown over the last {iterations - WARM_UP - 2} iterations: {growth:.0f} MB"
    )


def _copy(folder: Path, network: Cfg) -> Cfg:
    path = folder / "bench.cfg"
    path.write_text(cfg_text(network), encoding="utf-8")
    return read_cfg(path)


if __name__ == "__main__":
    app()
