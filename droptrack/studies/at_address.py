"""Results at an address such as s3://bucket/study, worked on in a folder of this machine."""

import hashlib
import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from droptrack.data.files import user_cache, write_text
from droptrack.errors import DroptrackError
from droptrack.studies.addresses import COPY, failures, is_address, system_of
from droptrack.studies.jobs import STATE, read_kept

TABLES = ("summary.csv", "summary.parquet", "index.html", "batch.json")
DATA_SET = "trajectories"
NOT_FETCHED = {".mp4", ".part"}  # large, or of use to nobody but the machine that wrote them
NOT_SENT = {".part"}
SENT = "sent.json"  # which tables were sent, and in which version


@dataclass(frozen=True)
class Place:
    """Where results go: a folder, and the address that they are sent to, if they are."""

    folder: Path
    address: str = ""

    def __str__(self) -> str:
        return self.address or str(self.folder)

    def of(self, name: str) -> str:
        """The address of a video's results; empty where there is none."""
        return self.address and f"{self.address}/{name}"

    def fetch(self) -> None:
        """Fetch what is at the address and not here; raises DroptrackError.

        What this machine has begun and not done stays as it is.
        """
        if not self.address:
            return
        system, root = system_of(self.address)
        with failures(self.address):
            states = list(map(str, system.glob(f"{root}/*/{STATE}")))
            for path, state in (system.cat(states) if states else {}).items():
                there = path.removesuffix(f"/{STATE}")
                folder = self.folder / there.rpartition("/")[2]
                if not _is_here(folder, state):
                    _fetch_video(system, there, folder)

    def send_tables(self) -> None:
        """Send the tables, the data set and the page, as far as they are new.

        Raises DroptrackError.
        """
        if not self.address:
            return
        system, root = system_of(self.address)
        tables = filter(Path.exists, (self.folder / name for name in TABLES))
        files = [*(self.folder / DATA_SET).glob("*/*.parquet"), *tables]
        sent = self._sent()
        with failures(self.address):
            there = set(map(str, system.find(f"{root}/{DATA_SET}")))
            names = {f"{root}/{_relative(path, self.folder)}": path for path in files}
            for gone in there - names.keys():
                system.rm_file(gone)
            for target, path in names.items():
                version = [path.stat().st_size, path.stat().st_mtime_ns]
                if target not in there or sent.get(target) != version:
                    _send(system, self.folder, root, [path])
                    sent[target] = version
                    write_text(self.folder / SENT, json.dumps(sent))

    def _sent(self) -> dict[str, list[int]]:
        """Bytes and time of what was sent before, by where it is."""
        try:
            sent: dict[str, list[int]] = json.loads((self.folder / SENT).read_text())
        except (OSError, ValueError):
            return {}
        return sent


def place_of(out: str) -> Place:
    """The place that ``--out`` names; for an address, a folder in the user's cache besides.

    Raises DroptrackError for one that cannot be.
    """
    if not is_address(out):
        if Path(out).is_file():
            raise DroptrackError(f"{out}: is a file; --out is a folder for results")
        return Place(Path(out))
    address = out.rstrip("/")
    system_of(address)  # refuses what cannot be
    key = hashlib.sha256(address.encode()).hexdigest()[:16]
    return Place(user_cache() / "studies" / key, address)


def send_video(folder: Path, address: str) -> None:
    """Send the results of a video from its folder to an address; raises DroptrackError.

    ``state.json`` is the last: where it is, all is.
    """
    system, root = system_of(address)
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and _is_sent(path)]
    files.sort(key=lambda path: path.name == STATE)
    here = {f"{root}/{_relative(path, folder)}" for path in files}
    with failures(address):
        for gone in set(map(str, system.find(root))) - here:
            system.rm_file(gone)
        _send(system, folder, root, files)


def _is_sent(path: Path) -> bool:
    return path.suffix not in NOT_SENT and not path.name.startswith(COPY)


def _send(system: Any, folder: Path, root: str, files: Iterable[Path]) -> None:
    for path in files:
        target = f"{root}/{_relative(path, folder)}"
        system.makedirs(target.rpartition("/")[0], exist_ok=True)
        system.put_file(str(path), target)


def _is_here(folder: Path, state: bytes) -> bool:
    """Whether a folder has what a state is of, or something that is not done."""
    kept = read_kept(folder)
    return kept is not None and (kept.state != "done" or (folder / STATE).read_bytes() == state)


def _fetch_video(system: Any, there: str, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    files = sorted(map(str, system.find(there)), key=lambda name: name.endswith(f"/{STATE}"))
    for name in files:
        path = folder / name.removeprefix(f"{there}/")
        if path.suffix not in NOT_FETCHED:
            path.parent.mkdir(parents=True, exist_ok=True)
            system.get_file(name, str(path))


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()
