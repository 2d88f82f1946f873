"""Speed of training: ``python -m bench.training``, PyTorch against the Darknet of $DARKNET.

Both train the same network from the same start on the same images, at the cfg's input size,
one after the other on this machine; the ratios are of that run. Without $DARKNET only PyTorch.
"""

import resource
import statistics
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import DataSet, read_data_file
from droptrack.network.bundled import BUNDLED
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, with_options
from droptrack.training.darknet.binary import DarknetSettings, find_darknet, identify
from droptrack.training.darknet.training import DarknetTraining
from droptrack.training.log import Step
from droptrack.training.pytorch.devices import choose_devices
from droptrack.training.pytorch.settings import Job, TorchSettings
from droptrack.training.pytorch.training import train

app = new_app()
WARM_UP = 2  # iterations that are not counted
NEVER = 10_000  # iterations


def images_a_second(steps: Iterable[Step], batch: int) -> float:
    """The median over the iterations after the first ones."""
    seconds = [step.seconds for step in steps if step.iteration > WARM_UP]
    return batch / statistics.median(seconds)


def memory_mb() -> float:
    """The peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@app.command()
@one_line_errors
def main(
    cfg: Annotated[Path, typer.Option(help="Network description (.cfg).")] = (
        BUNDLED / "yolov3-tiny.cfg"
    ),
    batch: Annotated[int, typer.Option(min=2, help="Images an iteration.")] = 16,
    iterations: Annotated[
        int, typer.Option(min=WARM_UP + 1, help="Iterations of each trainer.")
    ] = 12,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes that prepare images for PyTorch.")
    ] = 1,
) -> None:
    """Images a second of each trainer, and as a ratio to the first."""
    changes = {"batch": batch, "subdivisions": 1, "max_batches": iterations, "burn_in": NEVER}
    net = {key: str(value) for key, value in changes.items()}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for _ in make_dataset(
            folder / "data", Recipe(scene="tiny", images=200, valid=8, seed=1), 1
        ):
            pass
        data = read_data_file(folder / "data" / "obj.data")
        network = _copy(folder, with_options(read_cfg(cfg), net, {"random": "0"}))
        rates = darknet_rates(network, data, folder)
        growth = 0.0
        for bf16 in (False, True):
            label, rate, grown = torch_rate(network, data, folder, bf16=bf16, workers=workers)
            rates[label], growth = rate, max(growth, grown)
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
        f"peak memory, grown over the last {iterations - WARM_UP - 2} iterations: {growth:.0f} MB"
    )


def darknet_rates(network: Cfg, data: DataSet, folder: Path) -> dict[str, float]:
    """Images a second of the Darknet that is found, by its name; empty without one."""
    binary = find_darknet(None)
    if binary is None:
        return {}
    darknet = identify(binary)
    out = folder / "darknet"
    out.mkdir()
    settings = DarknetSettings(
        gpus="", save_every=NEVER, map_every=NEVER, patience=0, hang_seconds=1800
    )
    training = DarknetTraining(
        darknet, _copy(out, network), data, out, settings, lambda _: float("nan")
    )
    rate = images_a_second(training.steps(None, resume=False), network.net.integer("batch"))
    return {f"Darknet of {darknet.fork}": rate}


def torch_rate(
    network: Cfg, data: DataSet, folder: Path, *, bf16: bool, workers: int
) -> tuple[str, float, float]:
    """What PyTorch trains in and on, images a second, and MB by which its peak memory grew."""
    batch, iterations = network.net.integer("batch"), network.net.integer("max_batches")
    settings = TorchSettings(
        iterations=iterations,
        batch=batch,
        subdivisions=1,
        optimizer="sgd",
        learning_rate=network.net.number("learning_rate"),
        window=None,
        sizes=None,
        seed=0,
        workers=workers,
        save_every=NEVER,
        map_every=NEVER,
        map_images=1,
        patience=0,
        devices=choose_devices("", batch, 1),
        bf16=bf16,
    )
    out = folder / f"torch-{bf16}"
    out.mkdir()
    steps = train(Job(cfg=network, data=data, out=out, settings=settings))
    kept = [next(steps) for _ in range(WARM_UP + 1)]
    before = memory_mb()
    while len(kept) < iterations - 1:  # the last one measures a mAP, too
        kept.append(next(steps))
    growth = memory_mb() - before
    steps.close()
    label = f"PyTorch {'bf16' if bf16 else 'fp32'} on {settings.devices[0]}"
    return label, images_a_second(kept, batch), growth


def _copy(folder: Path, network: Cfg) -> Cfg:
    path = folder / "bench.cfg"
    path.write_text(cfg_text(network), encoding="utf-8")
    return read_cfg(path)


if __name__ == "__main__":
    app()
