"""Compiled networks kept in the user's cache: one that was compiled before is loaded at once.

A network is told by all that it depends on, the code that makes it included, so that nothing is
found that would not be made now.
"""

import functools
import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from droptrack.data.files import user_cache

MAX_KEPT = 40  # networks; of more, those that were used longest ago are deleted
SUFFIX = ".network"
DIGEST = 32  # bytes of a sha256, which come first


def find(about: Mapping[str, object]) -> bytes | None:
    """The network told by what it depends on; None where there is none, or a damaged one."""
    path = _path(about)
    try:
        with path.open("rb", buffering=0) as file:  # without copies
            digest, network = file.read(DIGEST), file.read()
        os.utime(path)
    except OSError:
        return None
    return network if hashlib.sha256(network).digest() == digest else None


def keep(about: Mapping[str, object], network: bytes) -> None:
    """Keep a network, where the cache can be written."""
    path = _path(about)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}")  # others may write the same one now
        partial.write_bytes(hashlib.sha256(network).digest() + network)
        os.replace(partial, path)
        kept = sorted(path.parent.glob(f"*{SUFFIX}"), key=lambda one: one.stat().st_mtime)
        for old in kept[:-MAX_KEPT]:
            old.unlink()


def _path(about: Mapping[str, object]) -> Path:
    told = json.dumps({**about, "code": _code()}, sort_keys=True)
    return user_cache() / f"{hashlib.sha256(told.encode()).hexdigest()[:40]}{SUFFIX}"


@functools.cache
def _code() -> str:
    """The sha256 of the code that makes networks."""
    digest = hashlib.sha256()
    here = Path(__file__).parents[2]
    for path in sorted([*(here / "network").glob("*.py"), here / "detection/engines/openvino.py"]):
        digest.update(path.read_bytes())
    return digest.hexdigest()
