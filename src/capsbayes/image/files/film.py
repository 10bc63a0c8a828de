"""A film as the camera recorded it: a folder of pictures, a TIFF file of many pages, or an AVI or MP4 file."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capsbayes.errors import InputError
from capsbayes.files.input_file import PICTURES, VIDEOS, check_file
from capsbayes.image.files.picture import (
    MOST_IN_FRAMES,
    Picture,
    Pixels,
    check_pixels,
    check_size,
    decode,
    in_rgb_order,
    quietly,
)

FRAMES = (*PICTURES, ".bmp")
_PAGES = 32  # of a TIFF file read at once
_LEAST_BYTES = 8  # of a frame in a video


@dataclass(frozen=True)
class Film:
    """Frames of a film, read one after the other when they are asked for.

    Parameters
    ----------
    source : Path
        Folder of pictures, taken in the order of the numbers in their names, or a file.
    count : int
        Number of frames that the film should have; a film that was cut short holds fewer.
    """

    source: Path
    count: int

    @classmethod
    def open(cls, path: str | Path) -> Film:
        """Open a film and count its frames.

        Raises
        ------
        InputError
            If the film is missing, empty or not a film.
        """
        path = Path(path)
        where = str(path)
        if not path.is_dir():
            check_file(path, "film")
        if path.is_dir():
            pictures = _pictures(path)
            count = len(pictures)
            for picture in pictures:
                check_file(picture, "picture")
                check_size(picture, str(picture), most=MOST_IN_FRAMES)
            if not pictures:
                raise InputError(where, "", f"pictures ({', '.join(FRAMES)})", "a folder without any")
        elif path.suffix.lower() in VIDEOS:
            with quietly():
                video = cv2.VideoCapture(where)
                opened = video.isOpened()
                keys = (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
                count, width, height = (int(video.get(key)) if opened else 0 for key in keys)
            check_pixels(width, height, where, most=MOST_IN_FRAMES)
            if count * _LEAST_BYTES > path.stat().st_size:
                raise InputError(where, "", "as many frames as the file says", f"room for fewer than its {count}")
        else:
            count = _pages(path) if check_size(path, where, most=MOST_IN_FRAMES) else 0
        if count < 1:
            raise InputError(where, "", "a film (AVI, MP4, TIFF or a folder)", "a file that cannot be read as one")
        return cls(path, count)

    def frames(
        self, part: tuple[slice, slice] = (slice(None), slice(None)), *, only: Collection[int] | None = None
    ) -> Iterator[Picture | None]:
        """Iterate over some rows and columns of the frames; one that cannot be read, or is of another size, is None.

        If `only` holds numbers of frames, all others are None as well.
        """
        shape = None
        for pixels in self._decoded(only):
            if pixels is not None:
                shape = shape or pixels.shape
            yield None if pixels is None or pixels.shape != shape else Picture.from_array(pixels[part])

    def spread(self, count: int) -> Iterator[Picture]:
        """Iterate over at most `count` frames at about equal distances; those that cannot be read are omitted."""
        return (picture for picture in self.frames(only=evenly_spaced(self.count, count)) if picture is not None)

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
        elif self.source.suffix.lower() in VIDEOS:
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


def is_film(path: Path) -> bool:
    """Return True for a folder, a video or a TIFF file of several pages."""
    suffix = path.suffix.lower()
    return path.is_dir() or suffix in VIDEOS or (suffix in (".tif", ".tiff") and path.is_file() and _pages(path) > 1)


def _read_pages(path: Path, start: int, count: int) -> list[Pixels]:
    with quietly():
        pages = cv2.imreadmulti(str(path), start, count, flags=cv2.IMREAD_UNCHANGED)[1]
    return [in_rgb_order(page) for page in pages]


def _pages(path: Path) -> int:
    with quietly():
        return cv2.imcount(str(path)) if cv2.haveImageReader(str(path)) else 0


def _pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder in the order of the numbers in their names: 9 before 10."""
    return sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in FRAMES),
        key=lambda path: [
            (part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)
        ],
    )
