"""Events of an .rtdc file: reading and measurement."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import check_file, parsing
from capsbayes.image.background import blob_of_mask, edge_shift, temporal_median, transmission
from capsbayes.image.by_hand import ByHand
from capsbayes.image.detect import Detection, analyse_blob
from capsbayes.image.edges import pixel_noise
from capsbayes.image.files import MOST_IN_FRAMES, Picture, check_pixels, evenly_spaced
from capsbayes.image.measure import check_flow, completed, measurement_of, speeds_of
from capsbayes.image.walls import WallLines
from capsbayes.measurement import Measurement
from capsbayes.quantity import Given, Quantity

# Files of real-time deformability cytometry (.rtdc): HDF5 with a picture and a mask for each event

_UNITS = {  # of numbers that a file states, with their values in SI
    "imaging:pixel size": ("micrometres", 1e-6),
    "setup:channel width": ("micrometres", 1e-6),
    "imaging:flash duration": ("microseconds", 1e-6),
    "setup:flow rate": ("microlitres a second", 1e-9),
}
_LARGEST_CHUNK = 2**28  # bytes that are in memory together


@dataclass(frozen=True)
class RtdcFile:
    """Contents of an .rtdc file."""

    path: Path
    events: int
    pixel_size: float  # [m]
    channel_width: float  # [m]: full width of the square channel
    sha256: str  # hash of the file
    flash_duration: float | None = None  # [s]: time for which light falls on one picture
    flow_rate: float | None = None  # [m^3/s]: in the channel, of sample and sheath together

    @classmethod
    def open(cls, path: str | Path) -> RtdcFile:
        """Open a file and read all but its pictures."""
        where, path = str(path), Path(path)
        with _opened(path) as file:
            for name in ("events/image", "events/mask"):
                if name not in file:
                    raise InputError(where, name, "pictures and masks", "nothing", "export them with the events")
                _check_pictures(file[name], where, name)
            shapes = [file[name].shape[1:] for name in ("events/image", "events/mask")]
            if shapes[0] != shapes[1]:
                raise InputError(where, "events/mask", f"masks of {_size(shapes[0])}", _size(shapes[1]))
            pixel, width = (_number(file, key, where) for key in ("imaging:pixel size", "setup:channel width"))
            flash, rate = (
                _number(file, key, where) if key in file.attrs else None
                for key in ("imaging:flash duration", "setup:flow rate")
            )
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


def _number(file: Any, key: str, where: str) -> float:
    """Return a positive number that a file states, in SI."""
    value, (unit, size) = file.attrs.get(key), _UNITS[key]
    if not isinstance(value, (int, float, np.number)) or not (np.isfinite(value) and value > 0.0):
        raise InputError(where, key, f"a positive number of {unit}", "nothing" if value is None else f"{value!s:.40}")
    return float(value) * size


# The mask selects the object, whose edge is located in the picture: contours through the pixel centres of a mask lie
# half a pixel inside the edge, and are only initial outlines

_SAMPLED = 101  # events in the median that is the background
_WIDTHS = 0.1  # largest relative difference of the channel's width between file and experiment
_RATES = 2.0  # largest ratio of the flow rates: that of the sample alone is a fraction
_SLOPES = np.linspace(-0.12, 0.12, 121)  # of the channel to the rows
_LINES = 2.0  # px: standard deviation of a wall's bundle of lines
_DARK = 0.03  # of the light between: a wall is darker


@dataclass(frozen=True, eq=False)
class Event:
    """Measurement of one event."""

    number: int  # from 0, as in the file
    picture: Picture
    detection: Detection  # in pixels; the distance of its walls is that of the file
    measurement: Measurement  # lengths over l and the silhouette, or why there are none
    pixel_size: Quantity  # [m]

    def row(self) -> dict[str, object]:
        """Return the event as a row of a table: lengths with their errors and integrals in SI, None where missing."""
        seen, size, ok = self.detection, self.pixel_size, self.measurement.status.ok
        row: dict[str, object] = {"event": self.number, "status": self.measurement.status.name}
        for index, name in enumerate(("axial_extent", "axial_length")):
            length, error = seen.lengths[index], np.sqrt(seen.covariance[index, index])
            known = ok and np.isfinite(length)
            row[f"{name}_m"] = float(length * size.value) if known else None
            row[f"{name}_error_m"] = float(np.hypot(error * size.value, length * size.error)) if known else None
        integrals = seen.integrals if ok else None
        for name, unit, power in (("area", "m2", 2), ("perimeter", "m", 1), ("volume", "m3", 3)):
            row[f"{name}_{unit}"] = integrals and getattr(integrals, name).value * size.value**power
        return row


def measure_rtdc(
    file: RtdcFile | str | Path,
    experiment: Experiment,
    *,
    pixel_size: Given,
    flow_rate: Given | None = None,
    shared_velocity: Given | None = None,
    flow: str | None = None,
    axis: Any = None,
    events: Iterable[int] | None = None,
) -> Iterator[Event]:
    """Measure event after event."""
    file = file if isinstance(file, RtdcFile) else RtdcFile.open(file)
    speed, rate = speeds_of("measure_rtdc", shared_velocity, flow_rate)
    if speed is None and rate is None and experiment.viscous_tension is None:
        raise _without_velocity(file)
    if rate is not None and file.flow_rate and not 1.0 / _RATES < rate.value / file.flow_rate < _RATES:
        expected = f"about the {1e9 * file.flow_rate:.4g} uL/s of {file.path}, of sample and sheath together"
        raise InputError("flow rate", "", expected, f"{1e9 * rate.value:.4g} uL/s", "correct the one that is wrong")
    pixel_size = Quantity.of(pixel_size, where="measure_rtdc", key="pixel_size", units=("m",))
    direction = check_flow(flow)
    _check_channel(file, experiment, pixel_size)
    seen = list(file.pictures(sorted(evenly_spaced(file.events, _SAMPLED))))
    empty = temporal_median([image for image, _ in seen])
    walls = _walls(empty, experiment, pixel_size, axis, str(file.path))
    gain = transmission(np.ones_like(empty), empty)
    shift = float(np.median([edge_shift(image * gain, walls, [blob_of_mask(mask, walls)]) for image, mask in seen]))
    flash = None if file.flash_duration is None else Quantity(file.flash_duration, unit="s")
    known = replace(experiment, exposure=experiment.exposure or flash)
    chosen = range(file.events) if events is None else list(events)
    for number, (image, mask) in zip(chosen, file.pictures(chosen), strict=True):
        picture = replace(Picture.from_array(image), source=f"{file.path}, event {number}", sha256=file.sha256)
        light = picture.grey * gain
        detection = analyse_blob(light, pixel_noise(light), walls, blob_of_mask(mask, walls), direction, shift)
        detection = completed(detection, picture.shape[1], known.camera)
        measured = measurement_of(detection, picture, known, speed, rate)
        yield Event(number, picture, detection, measured, pixel_size)


def _without_velocity(file: RtdcFile) -> InputError:
    """Return the refusal of a file whose flow rate lacks at least its error."""
    stated = "" if file.flow_rate is None else f"{1e9 * file.flow_rate:.6g}"
    advice = f'give --flow-rate "{stated or "0.16"} +/- ERROR uL/s", or --shared-velocity with the spread of v_o'
    expected, got = "a flow rate with its error", f"{stated} uL/s without an error" if stated else "nothing"
    return InputError(str(file.path), "setup:flow rate", expected, got, advice)


def _check_channel(file: RtdcFile, experiment: Experiment, pixel_size: Quantity) -> None:
    width, where = 2.0 * experiment.half_width.mean, experiment.source or "experiment"
    if abs(width / file.channel_width - 1.0) > _WIDTHS:
        expected = f"half of the {1e6 * file.channel_width:g} um of the channel in {file.path}"
        raise InputError(where, "half_width", expected, f"{0.5e6 * width:g} um")
    if abs(pixel_size.value / file.pixel_size - 1.0) > _WIDTHS:
        expected = f"about the {1e6 * file.pixel_size:.4g} um of {file.path}, with an error"
        raise InputError("pixel size", "", expected, f"{1e6 * pixel_size.value:g} um")
    if file.events < 3:
        raise InputError(str(file.path), "events", "at least three", str(file.events))


def _walls(empty: Floats, experiment: Experiment, pixel_size: Quantity, axis: Any, where: str) -> WallLines:
    """Return the walls around the axis that is stated, by default where the empty channel is darkest."""
    walls = ByHand(pixel_size=pixel_size, axis=axis).lines(empty.shape, experiment.half_width)
    assert walls is not None, "a pixel size is stated"
    if axis is not None:
        return walls
    row, tilt, dark = _darkest(empty, walls.half_width)
    if not dark > _DARK:
        expected = f"two dark walls {2.0 * walls.half_width:.0f} px apart, seen in the median of the events"
        got = f"{max(dark, 0.0):.1%} less light there than between"
        raise InputError(where, "events/image", expected, got, "state the row of the channel's axis (--axis)")
    return replace(walls, centre_row=row, tilt=tilt, line_width=_LINES)


def _darkest(empty: Floats, half_width: float) -> tuple[float, float, float]:
    """Return the row [px] at which the axis crosses the middle column, its tilt, and how dark the fainter wall is."""
    # at this magnification a wall is a bundle of dark lines, none of which is the wall by itself
    rows, columns = empty.shape
    middle = 0.5 * (columns - 1)
    slope, level, most = 0.0, empty.mean(axis=1), -np.inf
    for trial in _SLOPES:
        shear = np.array([[1.0, 0.0, 0.0], [-trial, 1.0, trial * middle]])
        sheared = cv2.warpAffine(empty, shear, (columns, rows), borderMode=cv2.BORDER_REPLICATE).mean(axis=1)
        if sheared.var() > most:
            slope, level, most = float(trial), sheared, float(sheared.var())
    vertical = half_width * np.hypot(1.0, slope)  # half the distance between the walls, along a column
    candidates = np.arange(vertical, rows - 1.0 - vertical, 0.25)
    if len(candidates) == 0:
        return 0.5 * (rows - 1), float(np.arctan(slope)), 0.0
    blurred = gaussian_filter1d(level, _LINES)
    at_walls = np.array([np.interp(candidates + side * vertical, np.arange(rows), blurred) for side in (-1.0, 1.0)])
    best = int(np.argmin(at_walls.sum(axis=0)))
    between = np.median(level[np.abs(np.arange(rows) - candidates[best]) < 0.5 * vertical])
    dark = 1.0 - float(at_walls[:, best].max() / between)
    return float(candidates[best]), float(np.arctan(slope)), dark
