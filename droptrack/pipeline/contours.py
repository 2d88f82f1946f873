"""Outlines of a video's droplets, kept until it is known which track each is of."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.formats.contours import ContourFile, Contours, ContoursFormat, ContourWriter
from droptrack.data.report import Value
from droptrack.data.trajectories import Trajectories
from droptrack.pipeline.classes import CLASS_ID, Classes

PLACE = "place"  # the column of rows that says which of its frame's outlines a row has
AREA = "area_px2"


class ContourLog:
    """Outlines (N, K, 2) of frames, and the file that gets them once rows are final."""

    def __init__(self, writer: ContourWriter, size: tuple[int, int]) -> None:
        self._writer, self._size = writer, size
        self._kept: dict[int, Floats] = {}

    def keep(self, frame: int, outlines: Floats) -> None:
        """Take the outlines of a frame's N droplets, NaN where they were not measured."""
        self._kept[frame] = outlines

    def write(self, rows: Trajectories) -> None:
        """Take final rows of some frames, all of these, with a column PLACE, NaN in gaps."""
        for frame in np.unique(rows.frame).tolist():
            of_frame = rows[(rows.frame == frame) & np.isfinite(rows.columns[PLACE])]
            if not len(of_frame):
                continue
            points = self._kept[frame][of_frame.columns[PLACE].astype(int)]
            measured = np.isfinite(points).all(axis=(1, 2))
            some = of_frame[measured]
            self._writer.write(
                Contours(
                    image=f"{frame:06d}.png",
                    frame=frame,
                    size=self._size,
                    ids=some.track_id,
                    points=points[measured],
                    boxes=some.boxes,
                    areas=some.columns[AREA],
                    scores=some.scores,
                    class_ids=some.columns.get(CLASS_ID, np.zeros(len(some))).astype(np.int64),
                )
            )
        done = int(rows.frame.max(initial=-1))
        self._kept = {frame: kept for frame, kept in self._kept.items() if frame > done}


@contextmanager
def contour_log(
    kind: ContoursFormat | None,
    folder: Path,
    about: Mapping[str, Value],
    classes: Classes | None,
    size: tuple[int, int],
) -> Iterator[ContourLog | None]:
    """What keeps outlines for a file of a kind in a folder, which says what made it.

    `size`: of the frames, px. None where no outlines are wanted.
    """
    if kind is None:
        yield None
        return
    file = ContourFile(
        folder=folder,
        kind=kind,
        about=dict(about),
        id_name="track_id",
        classes=classes.names if classes else (),
    )
    with file.open() as writer:
        yield ContourLog(writer, size)
