"""What can be drawn of droplets and their events, by name: drawing takes long to import."""

from enum import StrEnum

from droptrack.errors import DroptrackError


class Plot(StrEnum):
    """What can be drawn."""

    sizes = "sizes"
    deformation = "deformation"
    speed = "speed"
    kymograph = "kymograph"
    paths = "paths"


def parse_plots(text: str) -> list[Plot]:
    """Plots by their names, with commas between, or all; raises DroptrackError for others."""
    if text == "all":
        return list(Plot)
    try:
        return [Plot(part.strip()) for part in text.split(",")]
    except ValueError:
        raise DroptrackError(
            f"--plots {text}: should be all, or some of {','.join(Plot)}"
        ) from None
