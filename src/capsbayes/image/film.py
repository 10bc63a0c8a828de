"""A film as the camera gave it: a folder of pictures, a TIFF file of many pages, or an AVI or MP4 file."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.image.frames import Picture

__all__ = ["Film", "is_film"]

Pixels = NDArray[Any]

PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
VIDEOS = (".avi", ".mp4", ".mov", ".mkv")
_PAGES = 32  # of a TIFF file read at once


@dataclass(frozen=True)
class Film:
    """Frames of a film, read one after the other whenever they are asked for.

    Parameters
    ----------
    source : Path
        Folder of pictures, taken in the order of the numbers in their names, or a file.
    count : int
        Frames there should be; a film that was cut short holds fewer.
    """

    source: Path
    count: int

    @classmethod
    def open(cls, path: str | Path) -> Film:
        """Find out how many frames there are.

        Parameters
        ----------
        path : path

        Returns
        -------
        Film

        Raises
        ------
        InputError
            If it is missing, empty or no film.
        """
        path = Path(path)
        where = str(path)
        if path.is_dir():
            count = len(_pictures(path))
            if not count:
                raise InputError(where, "", f"pictures ({', '.join(PICTURES)})", "a folder without any")
        elif not path.is_file():
            raise InputError(where, "", "a film", "nothing there")
        elif path.suffix.lower() in VIDEOS:
            video = cv2.VideoCapture(where)
            count = int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
        else:
            count = _pages(path)
        if count < 1:
            raise InputError(where, "", "a film (AVI, MP4, TIFF or a folder)", "a file that cannot be read as one")
        return cls(path, count)

    def frames(self, rows: slice = slice(None), *, only: Collection[int] | None = None) -> Iterator[Picture | None]:
        """The frames in their order, or some rows of them; None for one that cannot be read or is of another size.

        Parameters
        ----------
        rows : slice
        only : collection of int, optional
            Numbers of the frames that are wanted; all the others are None too.
        """
        shape = None
        for pixels in self._decoded(only):
            if pixels is not None:
                shape = shape or pixels.shape
            yield None if pixels is None or pixels.shape != shape else Picture.from_array(_in_order(pixels[rows]))

    def spread(self, count: int) -> list[Picture]:
        """Frames at about equal distances, those that cannot be read left out.

        Parameters
        ----------
        count : int
            At most so many.

        Returns
        -------
        list of Picture
        """
        wanted = set(np.unique(np.linspace(0, self.count - 1, count).round().astype(int)).tolist())
        return [picture for picture in self.frames(only=wanted) if picture is not None]

    @property
    def sha256(self) -> str:
        """Fingerprint of the file, or of all pictures of the folder one after the other."""
        digest = hashlib.sha256()
        for path in _pictures(self.source) if self.source.is_dir() else [self.source]:
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()

    def _decoded(self, only: Collection[int] | None) -> Iterator[Pixels | None]:
        """The frames as they lie in the file; those that are not wanted are passed over, and None."""
        wanted = range(self.count) if only is None else only
        if self.source.is_dir():
            for number, path in enumerate(_pictures(self.source)):
                raw = np.fromfile(path, dtype=np.uint8) if number in wanted else np.empty(0, np.uint8)
                yield cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
        elif self.source.suffix.lower() in VIDEOS:
            video = cv2.VideoCapture(str(self.source))
            for number in range(self.count):
                read, pixels = video.retrieve() if video.grab() and number in wanted else (False, None)
                yield cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if read and pixels is not None else None
        elif only is None:
            for start in range(0, self.count, _PAGES):
                yield from _read_pages(self.source, start, min(_PAGES, self.count - start))
        else:
            for number in range(self.count):
                yield next(iter(_read_pages(self.source, number, 1)), None) if number in wanted else None


def _read_pages(path: Path, start: int, count: int) -> Sequence[Pixels]:
    return cv2.imreadmulti(str(path), start, count, flags=cv2.IMREAD_UNCHANGED)[1]


def is_film(path: Path) -> bool:
    """Whether a path is a folder, a video or a TIFF file of several pages."""
    suffix = path.suffix.lower()
    return path.is_dir() or suffix in VIDEOS or (suffix in (".tif", ".tiff") and path.is_file() and _pages(path) > 1)


def _pages(path: Path) -> int:
    return cv2.imcount(str(path)) if cv2.haveImageReader(str(path)) else 0


def _pictures(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in PICTURES]
    return sorted(
        found,
        key=lambda path: [
            (part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)
        ],
    )


def _in_order(pixels: Pixels) -> Pixels:
    """Colours as red, green, blue: OpenCV keeps them from blue to red."""
    return pixels[:, :, [2, 1, 0]] if pixels.ndim == 3 and pixels.shape[2] >= 3 else pixels
