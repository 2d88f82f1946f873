"""Cameras and streams: they have no end of their own, and some are away for a while."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import cv2

from droptrack.data.sources.source import Image, ReadOptions, Source, refuse_channel
from droptrack.data.sources.video_files import open_capture, read_capture
from droptrack.errors import DroptrackError

STREAMS = ("rtsp://", "rtmp://", "rtp://", "udp://", "srt://")
SILENCE_MS = 10_000  # after which a stream is taken to be away
PAUSE_S = 0.5  # between two attempts


@dataclass
class Outages:
    """Frames that came while a stream was away, by its rate: an estimate."""

    n_frames: int = 0


def open_stream(source: str, options: ReadOptions, outages: Outages) -> tuple[Source, bool]:
    """A camera by its index, or an address; and whether it is live, not a file on a server.

    What is lost while it is away is counted in `outages`, and in the frames' numbers.
    """
    refuse_channel(source, options)
    is_camera = "://" not in source
    capture = _connect(source, options)
    n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    live = is_camera or source.startswith(STREAMS) or not n_frames
    if options.reconnect_s and not live:
        raise DroptrackError(f"{source}: is no live stream; leave out --reconnect")
    fps = float(capture.get(cv2.CAP_PROP_FPS))
    images = _stay_connected(capture, source, options, outages) if live else None
    return Source(
        images=images or read_capture(capture, n_frames),
        n_frames=n_frames,
        counted=False,
        fps=fps,
    ), live


def _connect(source: str, options: ReadOptions) -> cv2.VideoCapture:
    if "://" not in source:
        return open_capture(int(source), source)
    if not options.reconnect_s:
        return open_capture(source, source)
    limits = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
    return open_capture(source, source, [part for one in limits for part in (one, SILENCE_MS)])


def _stay_connected(
    capture: cv2.VideoCapture, source: str, options: ReadOptions, outages: Outages
) -> Iterator[tuple[int, Image]]:
    """Frames as they come; after an outage, the numbers go on as if none had been lost."""
    number = 0
    began = time.monotonic()
    while True:
        for _, image in read_capture(capture, 0):
            yield number, image
            number += 1
        away = time.monotonic()
        rate = number / max(away - began, 1e-3)
        again = _reconnected(source, options, away + options.reconnect_s)
        if again is None:
            return
        capture = again
        lost = round(rate * (time.monotonic() - away))
        outages.n_frames += lost
        number += lost


def _reconnected(source: str, options: ReadOptions, deadline: float) -> cv2.VideoCapture | None:
    while time.monotonic() < deadline:
        try:
            return _connect(source, options)
        except DroptrackError:
            time.sleep(PAUSE_S)
    return None
