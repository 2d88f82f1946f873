"""What a report prints."""

from pathlib import Path

import pytest

from droptrack.data.report import Report


def printed(n: int, capsys: pytest.CaptureFixture[str], all_in: Path | str = "") -> list[str]:
    droplets = [{"track_id": 1000 + k, "path_px": 1.5} for k in range(n)]
    Report("Droplets", {}, {"n_droplets": n}, droplets).print(all_in=all_in)
    return capsys.readouterr().out.splitlines()


def n_rows(lines: list[str]) -> int:
    return sum("1.5" in line for line in lines)


def test_a_long_table_is_cut_with_a_line_that_says_where_all_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = printed(21, capsys, Path("out") / "report.json")
    assert n_rows(lines) == 20
    assert f"20 of 21: all are in {Path('out') / 'report.json'}" in lines
    assert lines[-1] == "n droplets  21"


def test_a_table_is_whole_where_it_is_short_or_nowhere_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert n_rows(printed(20, capsys, "report.json")) == 20
    whole = printed(300, capsys)
    assert n_rows(whole) == 300
    assert not any("all are in" in line for line in whole)
