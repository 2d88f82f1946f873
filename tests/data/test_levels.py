"""Grey levels of more than 8 bits: the same droplets as a camera of 8 bits shows."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from droptrack.data.frames import as_frame
from droptrack.data.levels import levels_in
from droptrack.data.video import ReadOptions, Video, VideoInfo
from droptrack.errors import DroptrackError

EIGHT = np.random.default_rng(0).integers(0, 256, (20, 30)).astype(np.uint8)  # what is to be seen


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_every_depth_shows_what_a_camera_of_8_bits_does(
    tmp_path: Path, bits: int, suffix: str
) -> None:
    """The low bits are noise, which an 8-bit camera cuts off."""
    rng = np.random.default_rng(bits)
    for t in range(3):
        noise = rng.integers(0, 2 ** (bits - 8), EIGHT.shape)
        stored = EIGHT.astype(np.uint16) * 2 ** (bits - 8) + noise
        cv2.imwrite(str(tmp_path / f"{t}.{suffix}"), stored.astype(np.uint16))
    video = Video(str(tmp_path))
    assert str(video.levels) == f"0 to {2**bits - 1}, {bits} bits, as its values show"
    for frame in video:
        assert (frame == EIGHT[..., None]).all()


def test_levels_are_those_of_the_whole_video_not_of_its_first_image(tmp_path: Path) -> None:
    """12 bits, of which the first image uses 9; grey levels of all can be compared."""
    for t, level in enumerate((400, 400, 3000)):
        cv2.imwrite(str(tmp_path / f"{t}.png"), np.full((8, 8), level, np.uint16))
    levels = [int(frame[0, 0, 0]) for frame in Video(str(tmp_path))]
    assert levels == [400 // 16, 400 // 16, 3000 // 16]


def test_a_video_of_16_bits_has_its_depth(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "v.avi"),
        cv2.CAP_FFMPEG,
        cv2.VideoWriter.fourcc(*"FFV1"),
        20.0,
        (30, 20),
        [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0],
    )
    for _ in range(3):
        writer.write(EIGHT.astype(np.uint16) * 16)
    writer.release()
    video = Video(str(tmp_path / "v.avi"))
    assert video.info == VideoInfo(30, 20, 20.0, 3)
    frames = list(video)
    assert len(frames) == 3
    assert all((frame == EIGHT[..., None]).all() for frame in frames)


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.array([[0, 51, 255]], np.uint16), [0, 51, 255]),
        (np.array([[0.0, 0.2, 1.0]], np.float32), [0, 51, 255]),
        (np.array([[0.0, 51.0, 255.0]], np.float32), [0, 51, 255]),
        (np.array([[0.0, 819.0, 4095.0]]), [0, 51, 255]),
        (np.array([[-1.0, 0.0, 1.0]], np.float32), [0, 127, 255]),
        (np.array([[-1.0, np.nan, 1.0]], np.float32), [0, 127, 255]),
        (np.array([[0.0, np.inf, -np.inf, 1.0]], np.float32), [0, 255, 0, 255]),
        (np.array([[30_000, 30_128, 30_255]], np.uint16), [0, 128, 255]),
        (np.array([[-128, 0, 127]], np.int16), [0, 128, 255]),
        (np.array([[0, 1]], np.bool_), [0, 255]),
        (np.array([[7, 7]], np.uint16), [7, 7]),
        (np.array([[-3.0, -3.0]], np.float32), [0, 0]),
    ],
    ids=[
        *("8 bits in 16", "fractions", "floats of 8 bits", "floats of 12 bits", "below 0"),
        *(
            "with a NaN",
            "with infinity",
            "a high dark level",
            "signed",
            "one bit",
            "all alike",
            "all below 0",
        ),
    ],
)
def test_levels_are_those_in_use(image: np.ndarray, expected: list[int]) -> None:
    assert as_frame(image)[0, :, 0].tolist() == expected


def test_hot_pixels_do_not_darken_a_small_range() -> None:
    image = np.random.default_rng(1).integers(30_000, 31_000, (200, 200)).astype(np.uint16)
    image[3, 4] = 65_535
    levels = levels_in([image])
    assert 29_990 <= levels.black <= 30_010
    assert 30_990 <= levels.white <= 31_010


def test_levels_can_be_given(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", np.array([[[0, 100, 150, 199, 300]]] * 2, np.uint16))
    video = Video(str(tmp_path / "v.tif"), ReadOptions(levels=(100, 199)))
    assert next(iter(video))[0, :, 0].tolist() == [0, 0, 128, 255, 255]  # 50 / 99 * 255 = 128.8
    with pytest.raises(DroptrackError, match="the first should be the lower one"):
        Video(str(tmp_path / "v.tif"), ReadOptions(levels=(5, 5)))


def test_a_file_that_says_its_depth_is_believed(tmp_path: Path) -> None:
    """Of a dark image of 14 bits; TIFF's tag 281, MaxSampleValue."""
    tag = [(281, "H", 1, 2**14 - 1, True)]
    tifffile.imwrite(tmp_path / "v.tif", np.full((4, 4), 640, np.uint16), extratags=tag)
    video = Video(str(tmp_path / "v.tif"))
    assert "14 bits, as the file says" in str(video.levels)
    assert (next(iter(video)) == 10).all()


def test_images_of_other_depths_are_not_mixed(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((8, 8), np.uint16))
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((8, 8), np.uint8))
    with pytest.raises(DroptrackError, match="frame 1 is of type uint8, those before it of uint16"):
        list(Video(str(tmp_path)))
