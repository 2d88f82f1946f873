"""The examples in docstrings run, in a folder with the paper's test video and its ground truth."""

import doctest
import pkgutil
import shutil
from importlib import import_module
from pathlib import Path

import pytest

import droptrack


def modules_with_examples() -> list[str]:
    root = Path(droptrack.__file__).parent
    names = [module.name for module in pkgutil.walk_packages([str(root)], "droptrack.")]
    files = {name: root.parent.joinpath(*name.split(".")) for name in names}
    texts = {
        name: (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text()
        for name, path in files.items()
    }
    return [name for name, text in texts.items() if ">>>" in text]


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_give_what_they_say(
    name: str, sine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in ("video.avi", "truth.csv"):
        shutil.copy(sine / file, tmp_path)
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS)
    assert tried
    assert not failed


def test_public_names_have_examples_or_are_told_in_full() -> None:
    for name in droptrack.__all__:
        if name != "__version__":
            assert getattr(droptrack, name).__doc__, name


def test_the_command_s_module_can_be_called_like_the_function() -> None:
    import droptrack.track  # puts the module in the place of the function

    with pytest.raises(droptrack.DroptrackError, match="no such video"):
        droptrack.track("missing.avi")
