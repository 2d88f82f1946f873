"""Videos at addresses such as s3://bucket/video.avi, through fsspec."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from droptrack.data.files import replacing
from droptrack.errors import DroptrackError

COPY = "copy of "  # what begins the name of a copy
LIVE = ("rtsp", "rtmp", "rtsps", "udp", "rtp", "tcp", "srt", "mms")


def is_address(video: str) -> bool:
    """Whether a video is not a file of this machine's disks."""
    return "://" in video and not Path(video).exists()


def matches(pattern: str) -> list[str]:
    """The addresses that a pattern matches."""
    system, path = system_of(pattern)
    with failures(pattern):
        return [str(system.unstrip_protocol(one)) for one in system.glob(path)]


def version_of(address: str) -> dict[str, str | int]:
    """Bytes and time of the file at an address; raises DroptrackError where there is none."""
    system, path = system_of(address)
    with failures(address):
        about = system.info(path)
    changed = [about.get(key) for key in ("mtime", "LastModified", "ETag", "created", "updated")]
    return {
        "bytes": int(about.get("size") or 0),
        "modified": next((str(one) for one in changed if one is not None), ""),
    }


@contextmanager
def local_copy(video: str, folder: Path) -> Iterator[str]:
    """The name of a video as a file: its own, or that of a copy in a folder, deleted at last.

    The copy has the same name in every run, so that a run can be resumed.
    """
    if not is_address(video):
        yield video
        return
    system, path = system_of(video)
    place = folder / f"{COPY}{PurePosixPath(path).name}"
    with failures(video), replacing(place) as partial:
        system.get_file(path, str(partial))
    try:
        yield str(place)
    finally:
        place.unlink(missing_ok=True)


def system_of(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path in it; raises DroptrackError."""
    protocol = address.partition("://")[0]
    if protocol in LIVE:
        raise DroptrackError(f"{address}: is live; a batch takes files: droptrack track {address}")
    try:
        import fsspec
    except ImportError:
        raise DroptrackError(f"{address}: needs fsspec: pip install 'droptrack[batch]'") from None
    try:
        system, path = fsspec.core.url_to_fs(address)
    except ImportError as error:  # of the protocol's own package
        raise DroptrackError(f"{address}: {error}") from None
    except ValueError as error:
        raise DroptrackError(f"{address}: {error}") from None
    system.invalidate_cache()  # others may have written since
    return system, str(path)


@contextmanager
def failures(address: str) -> Iterator[None]:
    """Turn what goes wrong at an address into DroptrackError that names it."""
    try:
        yield
    except FileNotFoundError:
        raise DroptrackError(f"{address}: no such file") from None
    except OSError as error:
        raise DroptrackError(f"{address}: {error.strerror or error}") from error
