"""A picture as the camera gave it: read from a file or an array, grey, with its clipped pixels counted."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError

__all__ = ["Picture"]

Floats = NDArray[np.float64]

_FULL_SCALES = (255, 1023, 4095, 16383, 65535)  # largest grey level of 8, 10, 12, 14 and 16 bits


@dataclass(frozen=True, eq=False)
class Picture:
    """Grey levels of one picture.

    Parameters
    ----------
    grey : (rows, columns) array
        Grey levels, as counted by the camera; the mean of the colours of a colour picture weighted as the eye does.
    clipped : (rows, columns) array of bool
        Pixels at the end of the camera's scale, black or white: what they have seen is not known.
    source : str
        File it was read from, empty if none.
    sha256 : str
        Fingerprint of that file.
    """

    grey: Floats = field(repr=False)
    clipped: NDArray[np.bool_] = field(repr=False)
    source: str = ""
    sha256: str = ""

    @classmethod
    def read(cls, path: str | Path) -> Picture:
        """Read a PNG, TIFF or JPEG file of 8 or 16 bits, grey or in colour.

        Parameters
        ----------
        path : path
            The first page is read of a file of several.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            If the file is missing, empty or no picture.
        """
        where = str(path)
        try:
            raw = Path(path).read_bytes()
        except FileNotFoundError:
            raise InputError(where, "", "a picture", "nothing there") from None
        except OSError as error:
            raise InputError(where, "", "a readable picture", str(error.strerror)) from None
        if not raw:
            raise InputError(where, "", "a picture", "an empty file")
        decoded = cv2.imdecode(np.frombuffer(raw, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if decoded is None:
            raise InputError(where, "", "a picture (PNG, TIFF or JPEG)", "a file that cannot be read as one")
        if decoded.ndim == 3 and decoded.shape[2] >= 3:
            decoded = decoded[:, :, [2, 1, 0]]  # OpenCV keeps colours from blue to red
        return cls._of(decoded, where, hashlib.sha256(raw).hexdigest())

    @classmethod
    def from_array(cls, pixels: ArrayLike) -> Picture:
        """Take a picture that is in memory.

        Parameters
        ----------
        pixels : (rows, columns) or (rows, columns, colours) array
            Of unsigned integers as the camera gave them, or of any real numbers; colours are red, green, blue.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            If it has another shape, or a value that is not finite.
        """
        return cls._of(np.asarray(pixels), "picture", "")

    @classmethod
    def _of(cls, pixels: NDArray[Any], where: str, sha256: str) -> Picture:
        if pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < 16:
            raise InputError(where, "", "a picture of at least 16 x 16 pixels", f"an array of shape {pixels.shape}")
        whole = np.issubdtype(pixels.dtype, np.integer)
        levels = pixels.reshape(*pixels.shape[:2], -1)
        if levels.shape[2] >= 3:
            grey = levels[:, :, :3].astype(np.float64) @ [0.299, 0.587, 0.114]
            levels = grey
        else:
            levels = levels[:, :, 0]
            grey = levels.astype(np.float64)
        if not whole and not np.all(np.isfinite(grey)):
            raise InputError(where, "", "finite grey levels", f"{int(np.sum(~np.isfinite(grey)))} NaN or infinite ones")
        brightest = levels.max()  # of integers, which are compared faster
        clipped = levels <= 0
        if whole and round(float(brightest), 6) in _FULL_SCALES:
            clipped |= levels == brightest
        return cls(grey, clipped, "" if where == "picture" else where, sha256)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.grey.shape
        return rows, columns
