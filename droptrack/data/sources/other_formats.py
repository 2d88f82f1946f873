"""What people bring that is no video, or that is not read here, and what to do with it."""

from pathlib import Path

from droptrack.errors import DroptrackError

BIOFORMATS = (
    "save it as OME-TIFF with Fiji (File > Import > Bio-Formats), or bfconvert IN OUT.ome.tif"
)
CONVERT = {
    **dict.fromkeys((".lsm", ".oib", ".oif", ".oir", ".vsi", ".ims", ".dv", ".stk"), BIOFORMATS),
    **dict.fromkeys((".zvi", ".lof", ".xlef", ".mvd2", ".sld", ".zarr"), BIOFORMATS),
    **dict.fromkeys((".seq", ".fmf", ".ufmf"), "save it as TIFF or AVI with the camera's program"),
    ".ser": "save it as AVI with the camera's program, or PIPP",
    ".sif": "save it as TIFF with Andor Solis",
    ".spe": "save it as TIFF with LightField",
    ".his": "save it as TIFF with HCImage",
    ".b16": "save it as TIFF with pco.camware",
    ".heic": "magick IN OUT.png",
    ".pdf": "it holds no frames; ask for the video it was made from",
    **dict.fromkeys((".mat", ".npy", ".npz", ".h5", ".hdf5"), "tifffile.imwrite('OUT.tif', array)"),
    **dict.fromkeys(
        (".dcm", ".dicom"), "tifffile.imwrite('OUT.tif', pydicom.dcmread(IN).pixel_array)"
    ),
    **dict.fromkeys(
        (".zip", ".gz", ".tgz", ".tar", ".xz", ".bz2", ".7z", ".rar"), "unpack it first"
    ),
    **dict.fromkeys(
        (".wav", ".mp3", ".m4a", ".aac", ".flac", ".ogg", ".oga", ".opus", ".wma", ".aiff"),
        "it holds sound, and a picture of it at most",
    ),
}
MAY_BE_READ = (".dv",)  # by FFmpeg: of a camcorder, not of DeltaVision
HEAD = 512  # bytes that are looked at
LFS = b"version https://git-lfs"
PAGES = (b"<!doctype html", b"<html")


def refuse_known(path: Path) -> None:
    """Raise DroptrackError for a file whose name says that it is of a format not read here."""
    cure = CONVERT.get(path.suffix.lower())
    if cure is not None and path.suffix.lower() not in MAY_BE_READ:
        raise DroptrackError(f"{path}: {path.suffix} is not read here; {cure}")


def explain_unread(path: Path) -> None:
    """Raise DroptrackError for a file that nothing could read, where it is known why."""
    cure = CONVERT.get(path.suffix.lower())
    if cure is not None:
        raise DroptrackError(f"{path}: {path.suffix} is not read here; {cure}")
    with path.open("rb") as file:
        head = file.read(HEAD)
    if head.startswith(LFS):
        raise DroptrackError(f"{path}: is a pointer of Git LFS to a file; fetch it: git lfs pull")
    if head.lstrip().lower().startswith(PAGES):
        raise DroptrackError(
            f"{path}: is a web page, as a server may send with an error; download the video again"
        )
