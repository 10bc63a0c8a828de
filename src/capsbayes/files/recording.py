"""What a file of pictures says of itself: its kind by the first bytes, its images, and whether all are there."""

from __future__ import annotations

import contextlib
import math
import os
import re
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from capsbayes.errors import CutOffError, InputError

KINDS = {  # first bytes of each kind of file, and the endings of its name
    "PNG": (rb"\x89PNG\r\n\x1a\n", (".png",)),
    "TIFF": (rb"II[*+]\0|MM\0[*+]", (".tif", ".tiff")),
    "JPEG": (rb"\xff\xd8\xff", (".jpg", ".jpeg")),
    "BMP": (rb"BM", (".bmp",)),
    "AVI": (rb"RIFF.{4}AVI ", (".avi",)),
    "MP4 or MOV": (rb".{4}(ftyp|moov|mdat|wide|free|skip)", (".mp4", ".mov")),
    "MKV": (rb"\x1aE\xdf\xa3", (".mkv",)),
    "HDF5": (rb"\x89HDF\r\n\x1a\n", (".rtdc",)),
}
PICTURE_KINDS = ("PNG", "TIFF", "JPEG", "BMP")
VIDEO_KINDS = ("AVI", "MP4 or MOV", "MKV")

# numbers of tags of a TIFF file
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _DESCRIPTION, _COLOURS, _FORMAT = 256, 257, 258, 259, 270, 277, 339
_PARTS = ((273, 279), (324, 325))  # offsets and lengths of strips and of tiles
_SMALLER = 330  # directories of smaller copies
_PER_UNIT = 282  # columns of pixels in a unit of length, which a description of ImageJ names
_MICROMETRES = r"micron|um|[µμ]m|\\u00B5m|\\u03BCm"
_NUMBERS = {2: "i", 3: "f"}  # kinds of pixels but for unsigned integers
_LABELS = 2**16  # bytes of a file that may lie outside all images and tags
_BROKEN = (OSError, ValueError, SyntaxError, KeyError, TypeError, OverflowError, IndexError, struct.error)


@dataclass(frozen=True)
class Images:
    """Images of a file."""

    count: int
    sizes: frozenset[tuple[int, int]]  # width and height of all
    # of a TIFF file with one directory: bytes before the first image; images, rows, columns and colours; type of a
    # pixel
    behind: tuple[int, tuple[int, ...], str] | None = None


def kind_of(path: str | Path, first: bytes | None = None) -> str:
    """Return the kind of a file by its first bytes, as ``"PNG"``, empty if unknown; refuse one that its name denies."""
    if first is None:
        if not os.path.isfile(path):
            return ""
        with open(path, "rb") as file:
            first = file.read(16)
    found = next((kind for kind, (start, _) in KINDS.items() if re.match(start, first, re.DOTALL)), "")
    named = next((kind for kind, (_, endings) in KINDS.items() if str(path).lower().endswith(endings)), found)
    if found and found != named:
        got = f"one that its first bytes show to be {found}"
        raise InputError(str(path), "", f"a file of the kind that its name says, {named}", got, "rename it")
    return found


def is_film(path: Path) -> bool:
    """Return True for a folder, a video or a TIFF file of several images."""
    kind = kind_of(path)
    if kind != "TIFF":
        return path.is_dir() or kind in VIDEO_KINDS
    import PIL.Image

    try:
        images = images_of(path, str(path))
    except PIL.Image.DecompressionBombError:  # said when it is read
        return False
    return images is not None and images.count > 1


def cut_off(where: str, kind: str, got: str = "one that is cut off, damaged or of a rare kind") -> CutOffError:
    """Return the error of a file that says it holds more than can be read."""
    advice = "copy it again from where it was recorded, or save it again in a common form"
    return CutOffError(where, "", f"a whole {kind} file", got, advice)


def check_length(path: Path) -> None:
    """Refuse an AVI, MP4 or MOV file that is shorter than the blocks it begins: its last frame may be half a frame."""
    kind, length, start = kind_of(path), os.path.getsize(path), 0
    if kind not in ("AVI", "MP4 or MOV"):
        return
    with path.open("rb") as file:
        while start + 16 <= length:
            file.seek(start)
            head = file.read(16)
            if kind == "AVI":
                size = 8 + int.from_bytes(head[4:8], "little") if head[:4] == b"RIFF" else 0
            else:
                size = int.from_bytes(head[8:16] if head[:4] == b"\0\0\0\1" else head[:4])
            start += size
            if size < 8:  # not stated, or something else behind the blocks
                return
    if start > length:
        raise cut_off(str(path), kind, f"{length} of its {start} bytes")


def unknown(where: str) -> InputError:
    """Return the error of a file that is nothing that shows a capsule."""
    kinds = ", ".join(kind for kind in KINDS if kind != "HDF5")
    expected = f"a file that shows a capsule: {kinds}, .rtdc, or a contour (.csv, .txt, .roi, .json)"
    return InputError(where, "", expected, "one that is none of them by its first bytes")


def images_of(file: bytes | Path, where: str) -> Images | None:
    """Return what a PNG, TIFF, JPEG or BMP file says of its images; None if it is no picture."""
    import PIL.Image

    length = len(file) if isinstance(file, bytes) else os.path.getsize(file)
    with warnings.catch_warnings(action="ignore"), contextlib.ExitStack() as opened:
        try:
            picture = opened.enter_context(PIL.Image.open(BytesIO(file) if isinstance(file, bytes) else file))
            first = dict(getattr(picture, "tag_v2", {}))
        except (*_BROKEN, EOFError):
            return None
        count, sizes, spare = 0, set(), length - _LABELS
        try:
            while True:
                picture.seek(count)
                sizes.add(picture.size)
                spare -= _held(dict(getattr(picture, "tag_v2", {})), length)
                count += 1
        except EOFError:
            pass
        except _BROKEN:
            raise cut_off(where, str(picture.format), f"one that ends after {count} of its images") from None
        if picture.format != "TIFF":
            return Images(1 if picture.format == "MPO" else count, frozenset(sizes))  # of a camera, with a preview
        try:
            return _of_tiff(first, picture.tag_v2.prefix == b"II", count, frozenset(sizes), where, length, spare)  # type: ignore[attr-defined]
        except (*_BROKEN, ZeroDivisionError):
            return None


def pixel_size_of(path: Path) -> float | None:
    """Return the size of a pixel that ImageJ or OME state in a TIFF file [m]; None if they do not."""
    import PIL.Image

    quiet, whole = warnings.catch_warnings(action="ignore"), contextlib.suppress(*_BROKEN, ZeroDivisionError)
    with quiet, whole, PIL.Image.open(path) as picture:
        tags = dict(getattr(picture, "tag_v2", {}))
        text = str(tags.get(_DESCRIPTION, ""))
        if text.startswith("ImageJ=") and re.search(rf"^unit=({_MICROMETRES})\s*$", text, re.MULTILINE):
            return 1e-6 / float(tags[_PER_UNIT])
        sizes = re.search(r'\bPhysicalSizeX="([\d.eE+-]+)"', text)
        if sizes and re.search(rf'\bPhysicalSizeXUnit="(?!({_MICROMETRES})")', text) is None:
            return 1e-6 * float(sizes[1])
    return None


def _held(tags: Mapping[int, Any], length: int) -> int:
    """Return the bytes of an image and of the texts of its directory; refuse them if they lie beyond the file's end."""
    parts = [part for names in _PARTS for part in zip(*(tags.get(name, ()) for name in names), strict=False)]
    if any(start + size > length for start, size in parts):
        raise ValueError
    return sum(size for _, size in parts) + sum(len(text) for text in tags.values() if isinstance(text, (bytes, str)))


def _of_tiff(
    tags: Mapping[int, Any],
    little: bool,
    count: int,
    sizes: frozenset[tuple[int, int]],
    where: str,
    length: int,
    spare: int,
) -> Images:
    """Return the images of a TIFF file with `count` directories, `spare` bytes of which are in none of them."""
    said, channels, planes, frames = _said(tags)
    if max(said, count) > 1 and (channels > 1 or min(planes, frames) > 1):
        got = f"channels x planes x frames = {channels} x {planes} x {frames}"
        advice = "split it, and save one channel of one plane"
        raise InputError(where, "", "images of one channel and one plane", got, advice)
    shape = (tags[_HEIGHT], tags[_WIDTH], *((tags[_COLOURS],) if tags.get(_COLOURS, 1) > 1 else ()))
    bits = tags.get(_BITS, (1,))[0]
    plain = count == 1 and tags.get(_COMPRESSION, 1) == 1 and bits % 8 == 0 and _PARTS[0][0] in tags
    offset, each = (tags[_PARTS[0][0]][0], math.prod(shape) * bits // 8) if plain else (0, 0)
    if plain and said > 1 and offset + said * each <= length:
        dtype = f"{'<' if little else '>'}{_NUMBERS.get(tags.get(_FORMAT, (1,))[0], 'u')}{bits // 8}"
        return Images(said, sizes, behind=(offset, (said, *shape), dtype))
    if said > count:
        raise cut_off(where, "TIFF", f"{max(count, (length - offset) // each if plain else 0)} of its {said} images")
    if plain and spare >= each and _SMALLER not in tags:
        expected = "a TIFF file that lists all of its images"
        raise InputError(where, "", expected, f"one, and {spare} bytes behind it", "save it as a TIFF of several pages")
    return Images(count, sizes)


def _said(tags: Mapping[int, Any]) -> tuple[int, int, int, int]:
    """Return images, channels, planes and frames that a TIFF file's description states (ImageJ, OME), each 1 if not."""
    text = str(tags.get(_DESCRIPTION, ""))
    if text.startswith("ImageJ="):
        found = dict(re.findall(r"^(images|channels|slices|frames)=(\d{1,9})\s*$", text, re.MULTILINE))
        images, channels, planes, frames = (int(found.get(n, 1)) for n in ("images", "channels", "slices", "frames"))
        return images, channels, planes, frames
    if "<OME" not in text or len(set(re.findall(r'FileName="([^"]*)"', text))) > 1:
        return 1, 1, 1, 1
    found = dict(re.findall(r'\bSize([ZCT])="(\d{1,9})"', text)[:3])
    channels, planes, frames = (int(found.get(letter, 1)) for letter in "CZT")
    channels //= tags.get(_COLOURS, 1)
    return channels * planes * frames, channels, planes, frames
