"""Files of high-speed cameras and microscopes."""

import struct
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest

from droptrack.data.video import ReadOptions, Video, VideoInfo
from droptrack.errors import DroptrackError

N, HEIGHT, WIDTH = 3, 16, 20
EIGHT = np.random.default_rng(0).integers(0, 256, (N, HEIGHT, WIDTH)).astype(np.uint16)


def pack(levels: np.ndarray, bits: int) -> bytes:
    """Levels one after the other, the highest bits first, by their digits."""
    digits = "".join(f"{level:0{bits}b}" for level in levels.ravel().tolist())
    return int(digits, 2).to_bytes(len(digits) // 8, "big")


def cine(images: list[bytes], bits: int, packing: int, real_bits: int, rate: int = 7000) -> bytes:
    """A file as the Cine File Format (Vision Research, 2011) has it."""
    setup = bytearray(10_000)
    struct.pack_into("<H2sH", setup, 138, 0, b"ST", len(setup))
    struct.pack_into("<I", setup, 768, rate)
    struct.pack_into("<I", setup, 896, real_bits)
    info = struct.pack(
        "<IiiHHIIiiII", 40, WIDTH, HEIGHT, 1, bits, packing, len(images[0]), 0, 0, 0, 2**real_bits
    )
    table = 44 + len(info) + len(setup)
    head = struct.pack(
        "<2sHHHiIiIIIIII", b"CI", 44, 0, 1, 0, N, 0, N, 44, 44 + len(info), table, 0, 0
    )
    place, offsets, blocks = table + 8 * N, [], []
    for image in images:
        block = struct.pack("<I", 8) + struct.pack("<I", len(image)) + image
        offsets.append(place)
        blocks.append(block)
        place += len(block)
    return head + info + bytes(setup) + struct.pack(f"<{N}Q", *offsets) + b"".join(blocks)


CINES: dict[str, tuple[np.ndarray, Callable[[np.ndarray], bytes], int, int, int]] = {
    "8": (EIGHT, lambda x: x[::-1].astype(np.uint8).tobytes(), 8, 0, 8),
    "12 in 16": (EIGHT * 16, lambda x: x[::-1].astype("<u2").tobytes(), 16, 0, 12),
    "10 packed": (EIGHT * 4, lambda x: pack(x, 10), 16, 256, 10),
    "12 packed": (EIGHT * 16, lambda x: pack(x, 12), 16, 1024, 12),
}


@pytest.mark.parametrize("kind", CINES)
def test_phantoms_files_are_read(tmp_path: Path, kind: str) -> None:
    stored, write, bits, packing, real_bits = CINES[kind]
    path = tmp_path / "v.cine"
    path.write_bytes(cine([write(image) for image in stored], bits, packing, real_bits))
    video = Video(str(path))
    assert (video.info.width, video.info.height, video.info.n_frames) == (WIDTH, HEIGHT, N)
    assert video.info.fps == 7000
    np.testing.assert_array_equal(np.array(list(video))[..., 0], EIGHT)


def test_phantoms_files_are_read_as_ffmpeg_does(tmp_path: Path) -> None:
    stored, write, bits, packing, real_bits = CINES["8"]
    path = tmp_path / "v.cine"
    path.write_bytes(cine([write(image) for image in stored], bits, packing, real_bits))
    capture = cv2.VideoCapture(str(path))
    for frame in Video(str(path)):
        ok, expected = capture.read()
        assert ok
        np.testing.assert_array_equal(frame, expected)


def test_a_cut_or_foreign_cine_file_is_no_problem(tmp_path: Path) -> None:
    stored, write, bits, packing, real_bits = CINES["8"]
    whole = cine([write(image) for image in stored], bits, packing, real_bits)
    path = tmp_path / "v.cine"
    path.write_bytes(whole[:-5])
    video = Video(str(path))
    assert [number for number, _ in video.numbered()] == [0, 1]
    assert video.info.n_frames == 3
    for content in (b"", b"CI", whole[:200], b"RIFF" + whole[4:]):
        path.write_bytes(content)
        with pytest.raises(DroptrackError, match=r"v\.cine"):
            Video(str(path))
    path.write_bytes(whole[:4] + b"\2\0" + whole[6:])
    with pytest.raises(DroptrackError, match=r"is in colour, .* save it as TIFF"):
        Video(str(path))


def photron(folder: Path, bits: int, pixels: bytes, **more: object) -> Path:
    """A recording as FASTCAM Viewer writes it."""
    about = {
        "Record Rate(fps)": 5000,
        "Total Frame": N,
        "Image Width": WIDTH,
        "Image Height": HEIGHT,
        "Color Type": "Mono",
        "Color Bit": bits,
        "File Format": "MRaw",
        "EffectiveBit Depth": min(bits, 12),
        "EffectiveBit Side": "Lower",
        **more,
    }
    lines = "".join(f"{key} : {value}\n" for key, value in about.items())
    (folder / "v.cih").write_text(f"#Camera Information Header\n{lines}\n")
    (folder / "v.mraw").write_bytes(pixels)
    return folder / "v.mraw"


MRAWS = {
    8: EIGHT.astype(np.uint8).tobytes(),
    12: b"".join(pack(image * 16, 12) for image in EIGHT),
    16: (EIGHT * 16).astype("<u2").tobytes(),
}


@pytest.mark.parametrize("bits", MRAWS)
@pytest.mark.parametrize("name", ["v.mraw", "v.cih"])
def test_photrons_files_are_read(tmp_path: Path, bits: int, name: str) -> None:
    photron(tmp_path, bits, MRAWS[bits])
    video = Video(str(tmp_path / name))
    assert (video.info.width, video.info.height) == (WIDTH, HEIGHT)
    assert (video.info.fps, video.info.n_frames) == (5000, N)
    np.testing.assert_array_equal(np.array(list(video))[..., 0], EIGHT)


def test_photrons_levels_may_fill_the_upper_bits(tmp_path: Path) -> None:
    pixels = (EIGHT * 256).astype("<u2").tobytes()
    path = photron(tmp_path, 16, pixels, **{"EffectiveBit Side": "Higher"})
    np.testing.assert_array_equal(np.array(list(Video(str(path))))[..., 0], EIGHT)


def test_photrons_header_may_be_xml(tmp_path: Path) -> None:
    path = photron(tmp_path, 12, MRAWS[12])
    (tmp_path / "v.cih").unlink()
    (tmp_path / "v.cihx").write_bytes(
        f"""\0\1binary<cih><recordInfo><recordRate>5000</recordRate></recordInfo>
        <frameInfo><totalFrame>{N}</totalFrame></frameInfo><imageDataInfo><resolution>
        <width>{WIDTH}</width><height>{HEIGHT}</height></resolution><effectiveBit><depth>12</depth>
        <side>Lower</side></effectiveBit><colorInfo><type>Mono</type><bit>12</bit></colorInfo>
        </imageDataInfo><imageFileInfo><fileFormat>MRaw</fileFormat></imageFileInfo></cih>
        """.encode()
    )
    video = Video(str(path))
    assert video.info.fps == 5000
    np.testing.assert_array_equal(np.array(list(video))[..., 0], EIGHT)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ({"Color Bit": 36}, "36 bits, as MRaw, is not read here; save it as TIFF"),
        ({"Color Type": "Color"}, "Color, 16 bits"),
        ({"Image Width": 0}, "claims 3 images of 0 x 16 px"),
        ({"Image Width": 10**9}, "claims 3 images of 1000000000 x 16 px"),
        ({"Total Frame": "many"}, "Total Frame has 'many'; it should be a number"),
    ],
)
def test_what_photrons_header_cannot_be_is_refused(
    tmp_path: Path, more: dict[str, object], problem: str
) -> None:
    path = photron(tmp_path, 16, MRAWS[16], **more)
    with pytest.raises(DroptrackError, match=problem):
        Video(str(path))


def test_what_is_missing_of_photrons_files_is_said(tmp_path: Path) -> None:
    path = photron(tmp_path, 16, MRAWS[16][:-1])
    assert [number for number, _ in Video(str(path)).numbered()] == [0, 1]
    (tmp_path / "v.cih").unlink()
    with pytest.raises(DroptrackError, match=r"needs v\.cih or \.cihx beside it"):
        Video(str(path))


class FakeNd2:
    """The part of ``nd2.ND2File`` that is used: 3 times, 2 channels, 12 bits."""

    def __init__(self, _: Path) -> None:
        self.sizes = {"T": N, "C": 2, "Y": HEIGHT, "X": WIDTH}
        self.attributes = SimpleNamespace(bitsPerComponentSignificant=12)
        loop = SimpleNamespace(type="TimeLoop", parameters=SimpleNamespace(periodMs=4.0))
        self.experiment = [loop]

    def voxel_size(self) -> SimpleNamespace:
        return SimpleNamespace(x=0.65)

    def read_frame(self, number: int) -> np.ndarray:
        return np.stack([EIGHT[number] * 16, 4095 - EIGHT[number] * 16])


def test_a_microscopes_channels_units_and_bits_are_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = ModuleType("nd2")
    fake.ND2File = FakeNd2  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "nd2", fake)
    (tmp_path / "v.nd2").touch()
    video = Video(str(tmp_path / "v.nd2"), ReadOptions(channel=0))
    assert (video.info.fps, video.pixel_size_um) == (250, 0.65)
    assert str(video.levels) == "0 to 4095, 12 bits, as the file says"
    np.testing.assert_array_equal(np.array(list(video))[..., 0], EIGHT)
    other = Video(str(tmp_path / "v.nd2"), ReadOptions(channel=1))
    np.testing.assert_array_equal(np.array(list(other))[..., 0], 255 - EIGHT)


def test_zeiss_files_have_times_channels_colours_and_pixels() -> None:
    """`reference/microscopy/make.py` wrote them with Zeiss' own library."""
    pytest.importorskip("czifile")
    folder = Path(__file__).parents[1] / "reference" / "microscopy"
    for channel in (0, 1):
        options = ReadOptions(channel=channel, levels=(0, 4095))
        video = Video(str(folder / "grey.czi"), options)
        assert video.info == VideoInfo(16, 8, 25.0, 3)
        assert video.pixel_size_um == pytest.approx(0.65)
        levels = [np.unique(frame).tolist() for frame in video]
        assert levels == [[100 * channel + 10 * t + 1] for t in range(3)]
    assert "has 2 channels, of which 0 is read" in Video(str(folder / "grey.czi")).notes[0]
    colours = [frame[3, 5].tolist() for frame in Video(str(folder / "colour.czi"))]
    assert colours == [[10, 20, 30], [11, 21, 31]]


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("v.nd2", r"pip install 'droptrack\[microscopy\]'"),
        ("v.czi", r"pip install 'droptrack\[microscopy\]'"),
        ("v.lif", r"pip install 'droptrack\[microscopy\]'"),
        ("v.oib", "Bio-Formats"),
        ("v.sif", "Andor"),
        ("v.npy", "tifffile.imwrite"),
    ],
)
def test_what_is_not_read_here_is_said_with_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, cure: str
) -> None:
    for package in ("nd2", "czifile", "liffile"):
        monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / name).write_bytes(b"content")
    with pytest.raises(DroptrackError, match=cure):
        Video(str(tmp_path / name))
