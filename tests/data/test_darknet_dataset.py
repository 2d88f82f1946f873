"""Data sets in Darknet's format, and what is wrong with some."""

from pathlib import Path

import pytest

from droptrack.data.darknet_dataset import read_data_file, read_labels
from droptrack.errors import DroptrackError


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("-1 0.5 0.5 0.1 0.1", "has class -1"),
        ("0.5 0.5 0.5 0.1 0.1", "has class 0.5"),
        ("nan 0.5 0.5 0.1 0.1", "has class nan"),
        ("1e300 0.5 0.5 0.1 0.1", "has class 1e"),
        ("0 0.5 0.5 0 0.1", "a box needs a centre, a width and a height above 0"),
        ("0 0.5 0.5 0.1 0", "a box needs a centre, a width and a height above 0"),
        ("0 0.5 0.5 0.1 nan", "coordinates should lie between 0 and 1"),
        ("0 0.5 0.5 0.1", "each line should be"),
    ],
)
def test_labels_that_are_none_are_refused_with_their_line(
    tmp_path: Path, line: str, problem: str
) -> None:
    (tmp_path / "a.txt").write_text(f"0 0.5 0.5 0.1 0.1\n{line}\n")
    with pytest.raises(DroptrackError, match=rf"a\.txt:2: {problem}"):
        read_labels(tmp_path / "a.jpg")


def test_a_key_given_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "obj.data").write_text("classes = 1\nclasses = 2\n")
    with pytest.raises(DroptrackError, match=r"obj\.data:2: classes is given twice"):
        read_data_file(tmp_path / "obj.data")


def test_text_of_another_encoding_is_said_to_be(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("0 0.5 0.5 0.1 0.1\n", encoding="utf-16")
    with pytest.raises(
        DroptrackError, match=r"a\.txt: cannot be read as text: it is no UTF-8; save it as UTF-8"
    ):
        read_labels(tmp_path / "a.jpg")


def test_a_mark_before_the_text_is_no_part_of_it(tmp_path: Path) -> None:
    """Notepad's, before UTF-8."""
    mark = b"\xef\xbb\xbf"
    (tmp_path / "obj.data").write_bytes(mark + b"classes = 1\ntrain = t.txt\nnames = obj.names\n")
    (tmp_path / "obj.names").write_bytes(mark + b"droplet\n")
    (tmp_path / "t.txt").write_bytes(mark + b"a.jpg\n")
    (tmp_path / "a.jpg").touch()
    (tmp_path / "a.txt").write_bytes(mark + b"0 0.5 0.5 0.1 0.1\n")
    data = read_data_file(tmp_path / "obj.data")
    assert (data.names, data.train) == (("droplet",), (tmp_path / "a.jpg",))
    assert read_labels(data.train[0])[0].tolist() == [0]
