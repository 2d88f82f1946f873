"""What is said where loops are compiled first."""

import time

import pytest

from droptrack import compiled


@pytest.mark.parametrize(("seconds", "n_said"), [(0.0, 0), (0.4, 1)])
def test_who_has_to_wait_is_told_why(
    seconds: float, n_said: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(compiled, "SLOW", 0.2)
    with compiled.explained(said.append):
        time.sleep(seconds)
    time.sleep(0.3)
    assert len(said) == n_said
