"""Files of real-time deformability cytometry (.rtdc): HDF5 with a picture and a mask for each event."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans
from capsbayes.errors import InputError
from capsbayes.files.input_file import check_file, parsing
from capsbayes.image.files.picture import MOST_IN_FRAMES, check_pixels

_MICROMETRE = 1e-6  # the unit of the file's lengths
_MICROSECOND = 1e-6
_MICROLITRE = 1e-9
_LARGEST_CHUNK = 2**28  # bytes that are in memory together


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
    flash_duration : float, optional [s]
        Time for which light falls on one picture.
    flow_rate : float, optional [m^3/s]
        In the channel, of sample and sheath together.

    References
    ----------
    The format is described at https://dclab.readthedocs.io/en/stable/sec_av_datasets.html.
    """

    path: Path
    events: int
    pixel_size: float
    channel_width: float
    sha256: str
    flash_duration: float | None = None
    flow_rate: float | None = None

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
                _check_pictures(file[name], where, name)
            shapes = [file[name].shape[1:] for name in ("events/image", "events/mask")]
            if shapes[0] != shapes[1]:
                raise InputError(where, "events/mask", f"masks of {_size(shapes[0])}", _size(shapes[1]))
            keys = ("imaging:pixel size", "setup:channel width")
            pixel, width = (_positive(file.attrs.get(key), where, key) * _MICROMETRE for key in keys)
            flash = file.attrs.get("imaging:flash duration")
            if flash is not None:
                flash = _positive(flash, where, "imaging:flash duration", "microseconds") * _MICROSECOND
            rate = file.attrs.get("setup:flow rate")
            if rate is not None:
                rate = _positive(rate, where, "setup:flow rate", "microlitres a second") * _MICROLITRE
            count, masks = len(file["events/image"]), len(file["events/mask"])
            if not min(count, masks):
                raise InputError(where, "events", "at least one event", "none")
            stated = file.attrs.get("experiment:event count", count)
            for name, number in (("events/image", count), ("events/mask", masks)):
                if number != max(count, masks) or number != stated:
                    expected = f"those of all {max(count, masks) if stated in (count, masks) else stated} events"
                    raise InputError(where, name, expected, str(number), "export the file again")
        with path.open("rb") as raw:
            digest = hashlib.file_digest(raw, "sha256").hexdigest()
        return cls(path, count, pixel, width, digest, flash, rate)

    def pictures(self, events: Iterable[int] | None = None) -> Iterator[tuple[NDArray[np.uint8], Booleans]]:
        """Iterate over the picture and the mask of each event, or of some by number : (rows, columns) arrays."""
        with _opened(self.path) as file:
            for index in range(self.events) if events is None else events:
                yield np.asarray(file["events/image"][index]), np.asarray(file["events/mask"][index]) > 0


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file, and refuse it where something in it cannot be read."""
    try:
        import h5py
        import hdf5plugin  # noqa: F401
    except ImportError as error:
        advice = 'install it with pip install "capsbayes[rtdc]"'
        raise InputError(str(path), "", "a package that reads .rtdc files", f"no {error.name}", advice) from None
    check_file(path, ".rtdc file")
    with parsing(str(path), "an .rtdc file (HDF5)"), h5py.File(path, "r") as file:
        yield file


def _check_pictures(dataset: Any, where: str, name: str) -> None:
    """Refuse what are no pictures, or pictures too large for memory, by the sizes that the file declares."""
    if not hasattr(dataset, "shape") or len(dataset.shape) != 3 or dataset.dtype.kind not in "uib":
        raise InputError(where, name, "grey pictures of all events, in one array of integers", _kind(dataset))
    count, rows, columns = dataset.shape
    check_pixels(columns, rows, f"{where}: {name}", most=MOST_IN_FRAMES)
    if dataset.chunks is None:
        held = dataset.id.get_storage_size() // max(rows * columns * dataset.dtype.itemsize, 1)
    else:
        if math.prod(dataset.chunks) * dataset.dtype.itemsize > _LARGEST_CHUNK:
            raise InputError(where, name, f"chunks of at most {_LARGEST_CHUNK >> 20} MiB", str(dataset.chunks))
        across = math.prod(-(-size // part) for size, part in zip(dataset.shape[1:], dataset.chunks[1:], strict=True))
        held = dataset.id.get_num_chunks() // max(across, 1) * dataset.chunks[0]
    if held < count:
        raise InputError(where, name, f"pictures of all {count} events", f"those of {held}")


def _kind(dataset: Any) -> str:
    return f"{dataset.dtype} of {_size(dataset.shape) or 'one'}" if hasattr(dataset, "dtype") else "a folder"


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape[::-1]))


def _positive(value: object, where: str, key: str, unit: str = "micrometres") -> float:
    if not isinstance(value, (int, float, np.number)) or not (np.isfinite(value) and value > 0.0):
        raise InputError(where, key, f"a positive number of {unit}", "nothing" if value is None else f"{value!s:.40}")
    return float(value)
