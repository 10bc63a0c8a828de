"""Files of real-time deformability cytometry (.rtdc): HDF5 with a picture and a mask for each event."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans
from capsbayes.errors import InputError

_MICROMETRE = 1e-6  # the unit of the file's lengths


@dataclass(frozen=True)
class RtdcFile:
    """Contents of an .rtdc file.

    Parameters
    ----------
    path : Path
    events : int
        Number of events.
    pixel_size, channel_width : float [m]
        Size of a pixel, and full width of the square channel.
    sha256 : str
        Hash of the file.

    References
    ----------
    The format is described at https://dclab.readthedocs.io/en/stable/sec_av_datasets.html.
    """

    path: Path
    events: int
    pixel_size: float
    channel_width: float
    sha256: str

    @classmethod
    def open(cls, path: str | Path) -> RtdcFile:
        """Open a file and read all but its pictures.

        Raises
        ------
        InputError
            If the file is missing or not HDF5, if it lacks pictures, masks, pixel size or channel width, or if the
            extra ``rtdc`` is not installed.
        """
        where, path = str(path), Path(path)
        with _opened(path) as file:
            for name in ("events/image", "events/mask"):
                if name not in file:
                    raise InputError(where, name, "pictures and masks", "nothing", "export them with the events")
            keys = ("imaging:pixel size", "setup:channel width")
            pixel, width = (_positive(file.attrs.get(key), where, key) * _MICROMETRE for key in keys)
            count = min(len(file["events/image"]), len(file["events/mask"]))
        with path.open("rb") as raw:
            digest = hashlib.file_digest(raw, "sha256").hexdigest()
        return cls(path, count, pixel, width, digest)

    def pictures(self) -> Iterator[tuple[NDArray[np.uint8], Booleans]]:
        """Iterate over the picture and the mask of each event : (rows, columns) arrays."""
        with _opened(self.path) as file:
            for index in range(self.events):
                yield np.asarray(file["events/image"][index]), np.asarray(file["events/mask"][index]) > 0


def _opened(path: Path) -> Any:
    try:
        import h5py
        import hdf5plugin  # noqa: F401
    except ImportError as error:
        advice = 'install it with pip install "capsbayes[rtdc]"'
        raise InputError(str(path), "", "a package that reads .rtdc files", f"no {error.name}", advice) from None
    if not path.is_file():
        raise InputError(str(path), "", "a file", "nothing there")
    try:
        return h5py.File(path, "r")
    except OSError:
        raise InputError(str(path), "", "an .rtdc file (HDF5)", "a file that cannot be read as one") from None


def _positive(value: object, where: str, key: str) -> float:
    if not isinstance(value, (int, float, np.number)) or not (np.isfinite(value) and value > 0.0):
        raise InputError(where, key, "a positive number of micrometres", "nothing" if value is None else repr(value))
    return float(value)
