"""Folders of images as people have them."""

import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from droptrack.data.darknet_dataset import read_image
from droptrack.data.video import ReadOptions, Video
from droptrack.errors import DroptrackError


def make(folder: Path, *names: str) -> None:
    """Write images; the n-th of them has the grey level n."""
    folder.mkdir(exist_ok=True)
    for level, name in enumerate(names):
        Image.fromarray(np.full((8, 12), level, np.uint8)).save(folder / name)


def found(source: Path | str, **options: object) -> list[tuple[int, int]]:
    """Number and grey level of each frame."""
    video = Video(str(source), ReadOptions(**options))  # type: ignore[arg-type]
    return [(number, int(frame[0, 0, 0])) for number, frame in video.numbered()]


def test_hidden_files_are_no_frames(tmp_path: Path) -> None:
    make(tmp_path, "frame_1.png", "frame_2.png")
    (tmp_path / "._frame_1.png").write_bytes(b"\0\5\26\7")
    (tmp_path / "Thumbs.db").write_bytes(b"thumbs")
    assert found(tmp_path) == [(0, 0), (1, 1)]


def test_what_is_called_like_an_image_may_be_a_folder_or_a_pipe(tmp_path: Path) -> None:
    make(tmp_path, "frame_1.png", "frame_2.png")
    (tmp_path / "frame_3.png").mkdir()
    os.mkfifo(tmp_path / "frame_4.png")
    assert found(tmp_path) == [(0, 0), (1, 1)]


def test_an_image_that_is_away_ends_the_video_with_its_name(tmp_path: Path) -> None:
    make(tmp_path, "frame_1.png", "frame_2.png")
    (tmp_path / "frame_3.png").symlink_to("gone")
    frames = Video(str(tmp_path)).numbered()
    assert [number for number, _ in (next(frames), next(frames))] == [0, 1]
    with pytest.raises(DroptrackError, match=r"frame_3\.png: no such file"):
        next(frames)


@pytest.mark.parametrize("suffix", ["png", "webp"])
def test_an_animation_is_not_taken_for_one_image(tmp_path: Path, suffix: str) -> None:
    images = [Image.fromarray(np.full((8, 12), 50 * t, np.uint8)) for t in range(3)]
    path = tmp_path / f"a.{suffix}"
    images[0].save(path, save_all=True, append_images=images[1:], lossless=True)
    with pytest.raises(DroptrackError, match="is an animation of 3 images; save each as a file"):
        Video(str(path))
    images[0].save(path, save_all=True, lossless=True)
    assert found(path) == [(0, 0)]


def test_an_image_in_text_needs_no_last_line(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_text("P2 3 1 255 10 20 30")
    (frame,) = Video(str(tmp_path / "a.pgm"))
    assert frame[0, :, 0].tolist() == [10, 20, 30]


def test_missing_numbers_are_missing_frames(tmp_path: Path) -> None:
    names = ("frame_0007.png", "frame_0009.png", "frame_0010.png", "frame_0013.png")
    make(tmp_path, *names)
    video = Video(str(tmp_path))
    assert video.info.n_frames == 7
    assert video.n_absent == 3
    assert found(tmp_path) == [(0, 0), (2, 1), (3, 2), (6, 3)]
    (note,) = video.notes
    assert "3 of the numbers 7 to 13 are missing, the first is 8" in note
    assert found(tmp_path, renumber=True) == [(0, 0), (1, 1), (2, 2), (3, 3)]
    assert Video(str(tmp_path), ReadOptions(renumber=True)).notes == ()


@pytest.mark.parametrize(
    "names",
    [
        ("exp3_run2_0009_t0.36.png", "exp3_run2_0010_t0.40.png", "exp3_run2_0011_t0.44.png"),
        ("2024-01-01 12.00.59.png", "2024-01-01 12.01.00.png", "2024-01-01 12.01.01.png"),
        ("b.png", "dark.png", "frame.png"),
        ("IMG_1.PNG", "img_2.png", "Img_3.png"),
    ],
    ids=["several numbers", "times", "no numbers", "capitals"],
)
def test_the_number_that_counts_is_found(tmp_path: Path, names: tuple[str, ...]) -> None:
    make(tmp_path, *names)
    assert found(tmp_path) == [(0, 0), (1, 1), (2, 2)]


def test_times_in_names_are_no_frames(tmp_path: Path) -> None:
    make(tmp_path, "img_20240101120000123.png", "img_20240101120010456.png")
    assert found(tmp_path) == [(0, 0), (1, 1)]
    assert "no frames" in Video(str(tmp_path)).notes[0]


def test_several_sequences_are_refused_with_their_names(tmp_path: Path) -> None:
    make(tmp_path, "a_1.png", "a_2.png", "b_1.png", "b_2.png")
    with pytest.raises(DroptrackError, match=r"several sequences of images: a_#\.png, b_#\.png"):
        Video(str(tmp_path))
    assert found(tmp_path / "b_*.png") == [(0, 2), (1, 3)]
    make(tmp_path / "two", "run1_1.png", "run1_2.png", "run2_1.png", "run2_2.png")
    with pytest.raises(DroptrackError, match=r"run1_#\.png, run2_#\.png"):
        Video(str(tmp_path / "two"))
    make(tmp_path / "one", "frame_1.png", "frame_2.png", "background.png")
    with pytest.raises(DroptrackError, match=r"frame_#\.png"):
        Video(str(tmp_path / "one"))
    make(tmp_path / "same", "frame_1.png", "frame_01.png")
    with pytest.raises(DroptrackError, match="have one number"):
        Video(str(tmp_path / "same"))


def test_the_first_image_of_another_size_is_named(tmp_path: Path) -> None:
    make(tmp_path, "frame_1.png", "frame_2.png")
    Image.fromarray(np.zeros((8, 13), np.uint8)).save(tmp_path / "frame_3.png")
    with pytest.raises(DroptrackError, match=r"frame 2 is 13 x 8 px.*frame_3\.png"):
        list(Video(str(tmp_path)))


def test_what_is_no_image_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="the folder is empty"):
        Video(str(tmp_path))
    (tmp_path / "a.doc").touch()
    with pytest.raises(DroptrackError, match=r"no image .*, only 1 other entries \(\.doc\)"):
        Video(str(tmp_path))
    with pytest.raises(DroptrackError, match="no image whose name is"):
        Video(str(tmp_path / "*.png"))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["jpg", "png", "tif"])
def test_images_are_turned_upright_alike_everywhere(
    tmp_path: Path, orientation: int, kind: str
) -> None:
    """Pillow's transposition is the independent answer."""
    stored = np.zeros((16, 32), np.uint8)
    stored[:8, :8] = 250  # the top left corner, and less at its right
    stored[:8, 8:16] = 120
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"0.{kind}"
    Image.fromarray(stored).save(path, exif=exif, quality=100)
    turns = [
        *(None, Image.Transpose.FLIP_LEFT_RIGHT, Image.Transpose.ROTATE_180),
        *(Image.Transpose.FLIP_TOP_BOTTOM, Image.Transpose.TRANSPOSE, Image.Transpose.ROTATE_270),
        *(Image.Transpose.TRANSVERSE, Image.Transpose.ROTATE_90),
    ]
    turn = turns[orientation - 1]
    upright = Image.fromarray(stored)
    expected = np.asarray(upright if turn is None else upright.transpose(turn))
    (tracked,) = Video(str(tmp_path))
    for frame in (tracked, read_image(path), next(iter(Video(str(path))))):
        assert frame.shape == (*expected.shape, 3)
        assert np.abs(frame[..., 0].astype(int) - expected).max() <= 3


def test_an_image_with_a_name_that_is_no_utf8_is_read(tmp_path: Path) -> None:
    make(tmp_path, "a.png")
    name = bytes(tmp_path) + b"/tropf\xe4n.png"
    try:
        (tmp_path / "a.png").rename(Path(name.decode("utf-8", "surrogateescape")))
    except OSError:
        pytest.skip("this file system has names in UTF-8 only")
    assert found(tmp_path) == [(0, 0)]


def test_one_numbered_image_is_one_frame(tmp_path: Path) -> None:
    """OpenCV would go on with the next number."""
    make(tmp_path, "frame_1.png", "frame_2.png")
    assert found(tmp_path / "frame_1.png") == [(0, 0)]


def test_colours_of_an_image_keep_their_order(tmp_path: Path) -> None:
    image = np.zeros((4, 5, 3), np.uint8)
    image[:] = (10, 20, 30)  # BGR
    for name in ("a.png", "b.tif"):
        cv2.imwrite(str(tmp_path / name), image)
        (frame,) = Video(str(tmp_path / name))
        assert (frame == image).all()


def test_an_image_that_claims_to_be_huge_is_not_decoded(tmp_path: Path) -> None:
    """Found by random bytes: OpenCV takes half a minute, and gigabytes."""
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((20, 30), np.uint8))
    data = bytearray((tmp_path / "0.png").read_bytes())
    data[16:20] = (30_000).to_bytes(4, "big")
    data[20:24] = (30_000).to_bytes(4, "big")
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (tmp_path / "0.png").write_bytes(data)
    with pytest.raises(DroptrackError, match="no frame that can be decoded"):
        Video(str(tmp_path))
