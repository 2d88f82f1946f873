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
    monkeypatch.setattr(compiled, "compiled", lambda _: time.sleep(seconds))
    compiled.load_all(said.append)
    time.sleep(0.3)
    assert len(said) == n_said
