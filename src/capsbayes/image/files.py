"""Pictures and films as they are read from files."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import CutOffError, InputError
from capsbayes.files.input_file import PICTURES, check_file, read_bytes
from capsbayes.files.recording import PICTURE_KINDS, VIDEO_KINDS, Images, check_length, cut_off, images_of, kind_of

# A picture as the camera recorded it: read from a file or an array, in grey levels, with its clipped pixels

Pixels = NDArray[Any]

SMALLEST_SIDE = 16  # fewest rows and columns of a picture
_MOST_PIXELS = 2**23
_LONGEST_SIDE = 2**15 - 2  # which OpenCV can turn
MOST_IN_FRAMES = 2**22  # pixels of a frame of a film, tens of which are in memory together
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)  # largest grey level of 8, 10, 12, 14 and 16 bits
_ORIENTATION = 274  # EXIF tag, and what its values mean: rows and columns are exchanged, then quarters clockwise
_ORIENTATIONS = {2: (True, 1), 3: (False, 2), 4: (True, 3), 5: (True, 0), 6: (False, 1), 7: (True, 2), 8: (False, 3)}
_BELOW_ZERO = 0.02  # largest share of such levels, as noise leaves them where the level of the dark was subtracted
_FEW, _DARK = 4, 16  # levels of a picture that shows no edge, unless it is dark and they are next to each other
_DEAD = 0.05  # of the level beside: a row of one level that differs by less does no harm
_ALONE, _SPECK = 2.5, 0.1  # clipped pixels among nine, and of the brightest level: what a speck differs by
_LUMA = (0.299, 0.587, 0.114)  # weights of red, green and blue (ITU-R BT.601)


@dataclass(frozen=True, eq=False)
class Picture:
    """Grey levels of one picture."""

    grey: Floats = field(repr=False)  # (rows, columns): counts of the camera; of a colour picture, the luma (BT.601)
    clipped: Booleans = field(repr=False)  # (rows, columns): pixels at either end of the camera's scale
    source: str = ""  # file that the picture was read from, empty if none
    sha256: str = ""  # hash of that file
    gamma: float | None = None  # that the levels had before they were made linear; None if they are as recorded

    @classmethod
    def read(cls, path: str | Path) -> Picture:
        """Read a PNG, TIFF, JPEG or BMP file, grey or in colour, turned as a viewer turns it."""
        where, raw = str(path), read_bytes(path, "picture")
        if not raw:
            raise InputError(where, "", "a picture", "an empty file")
        kind = kind_of(path, raw[:16])
        if kind not in PICTURE_KINDS:
            got = f"a file of another kind ({kind})" if kind else "a file that cannot be read as one"
            raise InputError(where, "", f"a picture ({', '.join(PICTURE_KINDS)})", got)
        images = check_size(raw, where)
        pixels = decode(raw) if images else None
        if images is None or pixels is None:
            raise cut_off(where, kind)
        check_single(images, where)
        return cls._of(pixels, where, hashlib.sha256(raw).hexdigest())

    @classmethod
    def from_array(cls, pixels: ArrayLike) -> Picture:
        """Take a picture from memory."""
        return cls._of(np.asarray(pixels), "picture", "")

    @classmethod
    def _of(cls, pixels: Pixels, where: str, sha256: str) -> Picture:
        if pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < SMALLEST_SIDE:
            expected = f"a picture of at least {SMALLEST_SIDE} x {SMALLEST_SIDE} pixels"
            raise InputError(where, "", expected, f"an array of shape {pixels.shape}")
        if max(pixels.shape[:2]) > _LONGEST_SIDE:
            rows, columns = pixels.shape[:2]
            raise InputError(where, "", f"sides of at most {_LONGEST_SIDE} pixels", f"{columns} x {rows}")
        is_integer = np.issubdtype(pixels.dtype, np.integer)
        if pixels.dtype.kind not in "buif":
            raise InputError(where, "", "real numbers as grey levels", f"values of another kind ({pixels.dtype})")
        levels = pixels.reshape(*pixels.shape[:2], -1)
        levels = levels[:, :, :3].astype(np.float64) @ _LUMA if levels.shape[2] >= 3 else levels[:, :, 0]
        grey = levels.astype(np.float64)
        if not is_integer and not np.all(np.isfinite(grey)):
            raise InputError(where, "", "finite grey levels", f"{int(np.sum(~np.isfinite(grey)))} NaN or infinite ones")
        if levels.min() < 0 and (below := float(np.mean(levels < 0))) > _BELOW_ZERO:
            got = f"{below:.0%} of them below zero, as after a subtraction"
            raise InputError(where, "", "grey levels of a camera", got, "give the picture as it was recorded")
        few = np.unique(levels if len(np.unique(levels[::16, ::16])) <= _FEW else levels[:0])
        if len(few) == 2 or (2 < len(few) <= _FEW and few[-1] - few[0] > _DARK):
            got = f"{'two' if len(few) == 2 else len(few)} levels, as behind a threshold"
            raise InputError(where, "", "grey levels of a camera", got, "give the picture as it was recorded")
        brightest = levels.max()  # integers where the picture is grey: they are compared faster
        clipped = levels <= 0
        if is_integer and round(float(brightest), 6) in _FULL_SCALES:
            clipped |= levels == brightest
        rows, columns = _dead(levels), _dead(levels.T)
        _fill(grey, clipped, rows)
        _fill(grey.T, clipped.T, columns)
        _smooth_specks(grey, clipped, float(brightest))
        return cls(grey, clipped, "" if where == "picture" else where, sha256)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.grey.shape
        return rows, columns

    def mirrored(self, level: float) -> Picture:
        """Return the picture with its grey levels subtracted from one, so that what was bright is dark."""
        return replace(self, grey=level - self.grey, clipped=self.clipped & (self.grey > 0.0))

    def linear(self, gamma: float | None) -> Picture:
        """Return the picture with levels proportional to the light, of which they are the power 1 / gamma."""
        if gamma is None:
            return self
        full = _FULL_SCALES[0]  # the same for all pictures: a background keeps its ratio to them
        return replace(self, grey=full * (np.maximum(self.grey, 0.0) / full) ** gamma, gamma=gamma)

    def turned(self, quarters: int) -> Picture:
        """Return the picture turned clockwise by some quarters."""
        grey = np.ascontiguousarray(np.rot90(self.grey, -quarters))
        return replace(self, grey=grey, clipped=np.ascontiguousarray(np.rot90(self.clipped, -quarters)))

    def packed(self) -> Picture:
        """Return the picture with its grey levels in a smaller type, in which the counts of a camera are exact."""
        for counts in (np.uint8, np.uint16):
            if self.grey.min() >= 0.0 and self.grey.max() <= np.iinfo(counts).max:
                small: Any = self.grey.astype(counts)
                if np.array_equal(small, self.grey):
                    return replace(self, grey=small)
        return replace(self, grey=self.grey.astype(np.float32))

    def cut(self, part: tuple[slice, slice]) -> Picture:
        """Return a part of the picture, by its rows and columns."""
        return replace(self, grey=self.grey[part], clipped=self.clipped[part])


def _dead(levels: Pixels) -> NDArray[np.intp]:
    """Return the dead rows of levels (rows, columns): those of one level throughout, another one than beside."""
    flat = levels.max(axis=1) == levels.min(axis=1)
    alone = np.flatnonzero(flat[2:-2] & ~(flat[:-4] | flat[1:-3] | flat[3:-1] | flat[4:])) + 2
    beside = np.median(levels[alone[:, None] + [-2, -1, 1, 2]], axis=2)
    low, high = beside.min(axis=1), beside.max(axis=1)
    margin = np.maximum(_DEAD * high, 0.5 * (high - low))  # beyond what a line of the light itself reaches
    return alone[(levels[alone, 0] < low - margin) | (levels[alone, 0] > high + margin)]


def _fill(grey: Floats, clipped: Booleans, rows: NDArray[np.intp]) -> None:
    """Put in place of rows what lies between those beside, whose levels are known as little as clipped ones."""
    clipped[rows] = True
    grey[rows] = (9.0 * (grey[rows - 1] + grey[rows + 1]) - (grey[rows - 2] + grey[rows + 2])) / 16.0


def _smooth_specks(grey: Floats, clipped: Booleans, brightest: float) -> None:
    """Put the median of those around in place of black and white pixels that stand alone."""
    if clipped.any():
        near = cv2.boxFilter(clipped.astype(np.float32), -1, (3, 3), normalize=False)
        around = cv2.medianBlur(grey.astype(np.float32), 3)
        alone = clipped & (near < _ALONE) & (np.abs(grey - around) > _SPECK * brightest)
        grey[alone] = around[alone]


def check_size(file: bytes | Path, where: str, *, most: int = _MOST_PIXELS) -> Images | None:
    """Return the images of a file; refuse one of more pixels than memory and time allow. None if it is no picture."""
    import PIL.Image

    try:
        images = images_of(file, where)
    except PIL.Image.DecompressionBombError:
        raise _too_large(where, most, "far more") from None
    for width, height in images.sizes if images else ():
        check_pixels(width, height, where, most=most)
    return images


def check_single(images: Images, where: str) -> None:
    """Refuse a file of several images where one picture is meant."""
    if images.count > 1:
        advice = "measure it as a film, or save the one that is meant as a picture of its own"
        raise InputError(where, "", "one picture", f"a file of {images.count} images", advice)


def check_pixels(width: int, height: int, where: str, *, most: int) -> None:
    """Refuse a picture of more than `most` pixels."""
    if width * height > most:
        raise _too_large(where, most, f"{width} x {height}")


def _too_large(where: str, most: int, got: str) -> InputError:
    return InputError(where, "", f"at most {most / 1e6:.0f} million pixels", got, "crop it to the channel")


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Keep the messages of OpenCV's libraries, in C, from standard error."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def decode(raw: bytes) -> Pixels | None:
    """Return the pixels of an encoded picture, upright, as red, green and blue; None if it is not a picture."""
    with quietly(), contextlib.suppress(cv2.error):
        pixels = cv2.imdecode(np.frombuffer(raw, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if raw else None
    return None if pixels is None else _upright(in_rgb_order(pixels), raw)


def _upright(pixels: Pixels, raw: bytes) -> Pixels:
    """Turn pixels as the EXIF tag of their file says; OpenCV does it for TIFF files."""
    import PIL.Image

    if kind_of("", raw[:16]) == "TIFF" or not (b"Exif" in raw or b"eXIf" in raw):
        return pixels
    with PIL.Image.open(BytesIO(raw)) as picture:
        exchanged, quarters = _ORIENTATIONS.get(picture.getexif().get(_ORIENTATION, 1), (False, 0))
    return np.rot90(pixels.swapaxes(0, 1) if exchanged else pixels, -quarters)


def in_rgb_order(pixels: Pixels) -> Pixels:
    """Return the pixels with colours in the order red, green, blue: OpenCV keeps them from blue to red."""
    return pixels[:, :, [2, 1, 0]] if pixels.ndim == 3 and pixels.shape[2] >= 3 else pixels


# A film as the camera recorded it: a folder of pictures, a TIFF file of many pages, or an AVI or MP4 file

_PAGES = 32  # of a TIFF file read at once
_LEAST_BYTES = 8  # of a frame in a video


@dataclass(frozen=True)
class Film:
    """Frames of a film, read one after the other when they are asked for."""

    source: Path  # folder of pictures, taken in the order of the numbers in their names, or a file
    count: int  # number of frames that the film should have; a film that was cut short holds fewer
    behind: tuple[int, tuple[int, ...], str] | None = None  # as of `capsbayes.files.recording.Images`
    quarters: int = 0  # by how many quarters the frames are turned clockwise
    gamma: float | None = None  # of their levels, which are made linear

    @classmethod
    def open(cls, path: str | Path) -> Film:
        """Open a film and count its frames."""
        path, where, behind = Path(path), str(path), None
        if path.is_dir():
            pictures = _pictures(path)
            for picture in pictures:
                check_file(picture, "picture")
                with contextlib.suppress(CutOffError):  # a frame that cannot be read, as others
                    if images := check_size(picture, str(picture), most=MOST_IN_FRAMES):
                        check_single(images, str(picture))
            if not pictures:
                raise InputError(where, "", f"pictures ({', '.join(PICTURES)})", "a folder without any")
            return cls(path, len(pictures))
        check_file(path, "film")
        if kind_of(path) in VIDEO_KINDS:
            check_length(path)
            with quietly():
                video = cv2.VideoCapture(where)
                opened = video.isOpened()
                keys = (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
                count, width, height = (int(video.get(key)) if opened else 0 for key in keys)
            check_pixels(width, height, where, most=MOST_IN_FRAMES)
            if count * _LEAST_BYTES > path.stat().st_size:
                raise InputError(where, "", "as many frames as the file says", f"room for fewer than its {count}")
        else:
            images = check_size(path, where, most=MOST_IN_FRAMES)
            count, behind = (images.count, images.behind) if images else (0, None)
        if count < 1:
            raise InputError(where, "", "a film (AVI, MP4, TIFF or a folder)", "a file that cannot be read as one")
        return cls(path, count, behind)

    def frames(
        self, part: tuple[slice, slice] = (slice(None), slice(None)), *, only: Collection[int] | None = None
    ) -> Iterator[Picture | None]:
        """Iterate over a part of the frames; None for one that is unreadable, of another size, or not in `only`."""
        shape = None
        for decoded in self._decoded(only):
            frame = None if decoded is None else np.rot90(decoded, -self.quarters)
            if frame is not None:
                shape = shape or frame.shape
            yield None if frame is None or frame.shape != shape else Picture.from_array(frame[part]).linear(self.gamma)

    @property
    def sha256(self) -> str:
        """Hash of the file, or of all pictures of the folder in their order."""
        digest = hashlib.sha256()
        for path in _pictures(self.source) if self.source.is_dir() else [self.source]:
            with path.open("rb") as file:
                hashlib.file_digest(file, lambda: digest)
        return digest.hexdigest()

    def _decoded(self, only: Collection[int] | None) -> Iterator[Pixels | None]:
        """Iterate over the pixels of the frames; those that are not wanted are skipped, and None."""
        wanted = range(self.count) if only is None else only
        if self.source.is_dir():
            for number, path in enumerate(_pictures(self.source)):
                yield decode(path.read_bytes()) if number in wanted else None
        elif self.behind is not None:
            offset, shape, dtype = self.behind
            frames = np.memmap(self.source, dtype, "r", offset, shape)
            for number in range(self.count):
                yield frames[number] if number in wanted else None
        elif kind_of(self.source) in VIDEO_KINDS:
            with quietly():
                video = cv2.VideoCapture(str(self.source))
            for number in range(self.count):
                with quietly():
                    read, pixels = video.retrieve() if video.grab() and number in wanted else (False, None)
                yield cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if read and pixels is not None else None
        elif only is None:
            for start in range(0, self.count, _PAGES):
                yield from _read_pages(self.source, start, min(_PAGES, self.count - start))
        else:
            for number in range(self.count):
                yield next(iter(_read_pages(self.source, number, 1)), None) if number in wanted else None


def evenly_spaced(total: int, count: int) -> set[int]:
    """Return at most `count` numbers from 0 to ``total - 1`` at about equal distances, both ends included."""
    return set(np.unique(np.linspace(0, total - 1, count).round().astype(int)).tolist())


def _read_pages(path: Path, start: int, count: int) -> list[Pixels]:
    with quietly():
        pages = cv2.imreadmulti(str(path), start, count, flags=cv2.IMREAD_UNCHANGED)[1]
    return [in_rgb_order(page) for page in pages]


def _pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder in the order of the numbers in their names: 9 before 10."""
    return sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in PICTURES),
        key=lambda path: [
            (part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)
        ],
    )
