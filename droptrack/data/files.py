"""Reading and writing files so that nobody ever finds half of one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from droptrack.errors import DroptrackError, UnwritableError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to, which takes the place of `path` once the block has ended well.

    Until then `path` is what it was; of a block that fails nothing is left. The suffix is kept,
    since some writers choose the format by it. Raises DroptrackError where that cannot be written.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with replacing(Path(folder) / "table.csv") as partial:
    ...         _ = partial.write_text("1,2")
    ...     [file.name for file in Path(folder).iterdir()]
    ['table.csv']
    """
    if path.exists() and not path.is_file():  # such as /dev/stdout
        yield path
        return
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    except (FileNotFoundError, UnwritableError):  # of what is read meanwhile, or of another file
        partial.unlink(missing_ok=True)
        raise
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        reason = os.strerror(error.errno) if error.errno else error
        raise UnwritableError(f"{path}: cannot be written: {reason}", error.errno) from None
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def reading(path: Path, kind: str = "text") -> Iterator[None]:
    """Turn what prevents reading a file of a `kind` into DroptrackError that names it."""
    try:
        yield
    except FileNotFoundError:
        raise DroptrackError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise DroptrackError(
            f"{path}: cannot be read as {kind}: it is no UTF-8; save it as UTF-8"
        ) from None
    except (OSError, ValueError) as error:
        raise DroptrackError(f"{path}: cannot be read as {kind}: {error}") from None


def user_cache() -> Path:
    """The folder where a user's programs keep what they can make again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "droptrack"


def read_text(path: Path) -> str:
    """Read a text file, without the mark that some editors put before UTF-8.

    Raises DroptrackError naming it where that is not possible.
    """
    with reading(path):
        return path.read_text(encoding="utf-8-sig")
