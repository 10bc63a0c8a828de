"""A film as the camera recorded it: a folder of pictures, a TIFF file of many pages, or an AVI or MP4 file."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capsbayes.errors import CutOffError, InputError
from capsbayes.files.input_file import PICTURES, check_file
from capsbayes.files.recording import VIDEO_KINDS, check_length, kind_of
from capsbayes.image.files.picture import (
    MOST_IN_FRAMES,
    Picture,
    Pixels,
    check_pixels,
    check_single,
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
    behind : (int, tuple of int, str), optional
        As of `capsbayes.files.recording.Images`.
    quarters : int
        By how many quarters the frames are turned clockwise.
    """

    source: Path
    count: int
    behind: tuple[int, tuple[int, ...], str] | None = None
    quarters: int = 0

    @classmethod
    def open(cls, path: str | Path) -> Film:
        """Open a film and count its frames.

        Raises
        ------
        InputError
            If the film is missing, empty or not a film.
        """
        path, behind = Path(path), None
        where = str(path)
        if not path.is_dir():
            check_file(path, "film")
        if path.is_dir():
            pictures = _pictures(path)
            count = len(pictures)
            for picture in pictures:
                check_file(picture, "picture")
                with contextlib.suppress(CutOffError):  # a frame that cannot be read, as others
                    if images := check_size(picture, str(picture), most=MOST_IN_FRAMES):
                        check_single(images, str(picture))
            if not pictures:
                raise InputError(where, "", f"pictures ({', '.join(FRAMES)})", "a folder without any")
        elif kind_of(path) in VIDEO_KINDS:
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
        """Iterate over some rows and columns of the frames; one that cannot be read, or is of another size, is None.

        If `only` holds numbers of frames, all others are None as well.
        """
        shape = None
        for frame in self._decoded(only):
            pixels = None if frame is None else np.rot90(frame, -self.quarters)
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
        (path for path in folder.iterdir() if path.suffix.lower() in FRAMES),
        key=lambda path: [
            (part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)
        ],
    )
