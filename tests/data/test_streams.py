"""Streams over HTTP: a camera's Motion JPEG, which drops and comes again."""

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.video import ReadOptions, Video
from droptrack.errors import DroptrackError

FRAMES = 30  # of one connection


class Camera(BaseHTTPRequestHandler):
    """Frames of one grey level a connection: 40, 80, ..."""

    connections = 0

    def do_GET(self) -> None:
        type(self).connections += 1
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        image = np.full((48, 64, 3), 40 * type(self).connections, np.uint8)
        jpeg = cv2.imencode(".jpg", image)[1].tobytes()
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
        for _ in range(FRAMES):
            self.wfile.write(head.encode() + jpeg + b"\r\n")
            time.sleep(0.01)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def address() -> Iterator[str]:
    Camera.connections = 0
    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/video.mjpg"
    server.shutdown()
    server.server_close()


def test_motion_jpeg_over_http_is_live(address: str) -> None:
    video = Video(address)
    assert video.live
    assert not video.counted
    assert 20 <= len(list(video)) <= FRAMES


def test_a_stream_that_drops_is_reconnected_and_what_is_lost_is_counted(address: str) -> None:
    video = Video(address, ReadOptions(reconnect_s=20))
    found: list[tuple[int, int]] = []
    for number, frame in video.numbered():
        found.append((number, round(int(frame[5, 5, 0]) / 40)))
        if len(found) == 60:
            break
    numbers, connections = zip(*found, strict=True)
    assert list(numbers) == sorted(set(numbers))
    assert max(connections) >= 2
    assert numbers[-1] == 59 + video.n_lost


def test_an_end_that_nobody_asked_for_is_said(address: str, tmp_path: Path) -> None:
    options = ["--size", "64x64", "--backend", "opencv", "--no-video"]
    done = CliRunner().invoke(app, ["track", address, "--out", str(tmp_path / "a"), *options])
    assert done.exit_code == 1
    assert "though nobody asked for it" in done.stderr
    assert (tmp_path / "a" / "report.json").exists()
    options += ["--max-frames", "1"]
    done = CliRunner().invoke(app, ["track", address, "--out", str(tmp_path / "b"), *options])
    assert done.exit_code == 0, done.stderr


def test_a_file_is_not_reconnected(tmp_path: Path) -> None:
    (tmp_path / "v.avi").touch()
    with pytest.raises(DroptrackError, match="leave out --reconnect"):
        Video(str(tmp_path / "v.avi"), ReadOptions(reconnect_s=5))
