"""The empty channel and what differs from it: background, contrast, light, blobs and noise of a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.image.edge_models import bridged, median, quantile, robust_spread, within
from capsbayes.image.edges import pixel_noise
from capsbayes.image.files import Picture
from capsbayes.image.walls import WallLines, find_walls
from capsbayes.status import Status

# The empty channel behind a capsule: given, the temporal median of a film, or estimated from the picture itself

_BRIGHT = 85.0  # percentile along the channel that is taken for the empty channel
_ROWS = 16  # of all frames that are held in memory a second time
_CORE = 0.8  # of the half width: part of the channel whose light is averaged along it
_FAINT = 0.01  # of the light: larger differences from a smooth trend are objects
_TILE = 8  # px: side of the squares over which light is averaged, in every second row, where frames are compared
FLICKER, _STEADY = 5.0, 0.01  # largest factor, and smallest change, by which the light of frames is evened out
_FEWEST_TURNS = 4  # frames that tell that two kinds of them take turns
_APART = 0.4  # of the logarithm of a level: a lamp that flickers by a fifth to either side changes it by as much
_KINDS, _BLACK = (0.01, 0.5, 0.99), 4.0  # quantiles of the grey levels of a frame; levels that make no difference
_DARKEST = 0.02  # of the median of the background: below, the ratio to it is meaningless


def temporal_median(
    frames: Sequence[NDArray[Any]], covered: Sequence[Booleans] | None = None, *, share: float = 0.5
) -> Floats:
    """Return the median over three frames or more, or another quantile, at each pixel, where it is not covered."""
    shapes = {np.shape(frame) for frame in frames}
    if len(frames) < 3 or len(shapes) != 1:
        got = f"{len(frames)} of shapes {', '.join(map(str, sorted(shapes)))}" if len(frames) else "none"
        raise InputError("background", "frames", "at least three frames of one shape", got)
    levels = []
    for rows in np.array_split(np.arange(len(frames[0])), max(1, len(frames[0]) // _ROWS)):
        level = np.stack([frame[rows] for frame in frames])
        if covered is not None:  # what is covered comes last
            level = np.where([each[rows] for each in covered], np.inf, level).astype(np.float32)
        _put_in_order(level)
        place = share * (np.count_nonzero(np.isfinite(level), axis=0) - 1)
        around = np.stack([np.floor(place), np.ceil(place)]).astype(int)
        levels.append(np.take_along_axis(level, around, axis=0).mean(axis=0, dtype=np.float64))
    return np.concatenate(levels)


def _put_in_order(levels: NDArray[Any]) -> None:
    """Sort tens of frames of levels (n, rows, columns) at each pixel; np.sort takes ten times as long."""
    for turn in range(len(levels)):  # neighbours are exchanged, even and odd ones in turn
        low, high = levels[turn % 2 : -1 : 2], levels[turn % 2 + 1 :: 2]
        least = np.minimum(low, high)
        np.maximum(low, high, out=high)
        low[:] = least


def _quantiles(values: NDArray[Any], share: float) -> Floats:
    """Return a quantile of the finite values of each row (n, m), linear between two : (n,) array."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    place = share * (np.count_nonzero(np.isfinite(ordered), axis=1) - 1)
    below, each = np.floor(place).astype(int), np.arange(len(ordered))
    low, high = ordered[each, below], ordered[each, np.ceil(place).astype(int)]
    return np.asarray(low + (place - below) * (high - low))


def tiles_of(grey: NDArray[Any]) -> Floats:
    """Return the light of a frame (rows, columns) averaged over its tiles."""
    size = max(1, grey.shape[1] // _TILE), max(1, grey.shape[0] // _TILE)
    return np.asarray(cv2.resize(grey[::2].astype(np.float64), size, interpolation=cv2.INTER_AREA), dtype=np.float64)


def brightness(tiles: Floats, empty: Floats, share: float = 0.5) -> float:
    """Return the light of a frame over that of another or of the empty channel, by the tiles of both."""
    # a ratio beyond a factor of five is no lamp that flickers
    ratio = quantile(transmission(tiles, empty), share) if median(empty) > 0.0 else 1.0
    return ratio if 1.0 / FLICKER < ratio < FLICKER and abs(ratio - 1.0) > _STEADY else 1.0


def take_turns(frames: Iterable[NDArray[Any]]) -> bool:
    """Return whether successive frames are of two kinds that take turns, as those of two channels or exposures."""
    # a capsule that comes and goes changes the levels too, but not in half of the steps from frame to frame
    dark, level, bright = np.log([np.quantile(frame[::2, ::2], _KINDS) + _BLACK for frame in frames]).T
    for value in (level, dark - level, bright - level):
        ordered = np.sort(value)
        if len(ordered) < _FEWEST_TURNS or (steps := np.diff(ordered)).max() < _APART:
            continue
        turns = np.count_nonzero(np.diff(value > ordered[np.argmax(steps)]))
        if 2 * turns >= len(ordered):
            return True
    return False


def estimate_background(grey: Floats, walls: WallLines, percentile: float = _BRIGHT) -> Floats:
    """Estimate the background from one picture: the bright end of the levels on each line parallel to the walls."""
    bright, across = line_levels(grey, walls, percentile)
    return np.interp(walls.offset(grey.shape), across, bright)


def line_levels(grey: Floats, walls: WallLines, percentile: float) -> tuple[Floats, Floats]:
    """Return a percentile of the levels on each line parallel to the walls, and the lines' distances from the axis."""
    rows, columns = grey.shape
    turn = cv2.getRotationMatrix2D((walls.centre_column, walls.centre_row), float(np.degrees(walls.tilt)), 1.0)
    level = cv2.warpAffine(
        grey, turn, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    seen = np.isfinite(level).sum(axis=1) > columns // 2
    return _quantiles(level[seen], 0.01 * percentile), (np.flatnonzero(seen) - walls.centre_row).astype(np.float64)


def flatten(light: Floats, walls: WallLines) -> Floats:
    """Divide light (rows, columns) by its smooth trend along the channel, as of vignetting."""
    core = np.abs(walls.offset(light.shape)) < _CORE * walls.half_width
    seen, rows = core.any(axis=0), core.any(axis=1)
    level = _quantiles(np.where(core[rows], light[rows], np.nan)[:, seen].T, 0.5)
    design = np.vander(np.linspace(-1.0, 1.0, light.shape[1]), 3)
    start = np.array([0.0, 0.0, np.percentile(level, _BRIGHT)])

    def residuals(trend: Floats) -> Floats:
        return design[seen] @ trend - level

    fit = least_squares(residuals, start, loss="cauchy", f_scale=_FAINT)
    return np.asarray(light / np.maximum(design @ fit.x, _DARKEST))


def transmission(grey: Floats, background: Floats) -> Floats:
    """Return the light over that of the empty channel : (rows, columns) array."""
    return np.asarray(grey / np.maximum(background, _DARKEST * median(background)))


# A wall may be stated off the dark line that shows it: lengths over l are then wrong by as much as l is

_BAND_SMOOTHING = 2.0  # px
_BAND_REACH = 20.0  # px to either side of a wall that are searched
_BAND_SIGNIFICANCE = 8.0  # of a line's darkness over the spread of that of all rows
_OF_LINE = 0.5  # px: least error of a stated wall beside the line
_DOUBTED, _REFUSED = 2.0, 5.0  # standard errors of a wall, and of l, beyond which they are doubted and refused
_PERCENTILE = 75.0  # of the levels along a line: a capsule darkens less than three quarters of it


def compared_with_bands(walls: WallLines, grey: Floats) -> WallLines:
    """Return walls with their distances from the dark lines of a picture (rows, columns), see `WallLines.off_band`."""
    levels, across = line_levels(grey, walls, _PERCENTILE)
    ridge = gaussian_filter1d(levels, _BAND_SMOOTHING, order=2, mode="nearest")
    least = max(_BAND_SIGNIFICANCE * robust_spread(ridge), 1e-3 * float(np.median(levels)))
    before, inner, after = ridge[:-2], ridge[1:-1], ridge[2:]
    dark = (inner > before) & (inner >= after) & (inner > least)
    vertex = 0.5 * (after - before)[dark] / (2.0 * inner - before - after)[dark]
    lines = across[1:-1][dark] + vertex
    upper, lower = (_off(side * lines - walls.half_width, walls) for side in (-1.0, 1.0))
    return replace(walls, off_band=(upper, lower))


def _off(outwards: Floats, walls: WallLines) -> float:
    """Return how far a wall lies outside the nearest line, by the lines' distances from it outwards; 0 if on it."""
    near = outwards[np.abs(outwards) < _BAND_REACH]
    if not len(near):
        return 0.0
    nearest = float(near[np.argmin(np.abs(near))])
    return -nearest if abs(nearest) > _DOUBTED * max(np.sqrt(2.0) * walls.half_width_error, _OF_LINE) else 0.0


def are_misplaced(walls: WallLines) -> bool:
    """Return whether walls are stated so far from the dark lines that l, and so every length, is wrong."""
    return abs(walls.change) > _REFUSED * max(walls.half_width_error, np.sqrt(0.5) * _OF_LINE)


# Whether capsules are darker or brighter than the liquid; bright ones are measured in the mirrored picture

CONTRASTS = ("dark", "bright")
_ENDS = 0.001, 0.999  # quantiles of what differs from the empty channel
_BRIGHTER = 2.0  # of the largest darkening: a dark capsule may gather light in its middle
_EVERY = 2  # px: neighbours in a smoothed picture are alike, and percentiles of many pixels take time
_CLEAR = 2.0  # of the width of a wall's line: nearer to it, the line itself differs


def is_brighter(frames: Sequence[NDArray[Any]], empty: Floats, walls: WallLines) -> bool:
    """Return True if what differs most from the empty channel between the walls is brighter than it."""
    rows = walls.rows_around(empty.shape)
    empty = empty[rows]
    clear = walls.moved(0, -rows.start).between(empty.shape, _CLEAR * walls.line_width)[::_EVERY, ::_EVERY]
    darkening = brightening = 0.0
    for frame in frames:
        change = cv2.GaussianBlur(np.subtract(frame[rows], empty, dtype=np.float32), (0, 0), 1.0)
        change = change[::_EVERY, ::_EVERY][clear]
        least, most = (quantile(change, share) for share in _ENDS) if change.size else (0.0, 0.0)
        darkening, brightening = max(darkening, -least), max(brightening, most)
    return brightening > _BRIGHTER * darkening


def runs_upright(picture: NDArray[Any], contrast: str | None) -> bool:
    """Return True if walls are found up and down a picture (rows, columns), and none along its rows."""
    ways = (picture, np.ascontiguousarray(picture.T))
    along, upright = (Contrast.of([way], None, None, contrast).walls for way in ways)
    return along is None and upright is not None


@dataclass(frozen=True)
class Contrast:
    """How pictures of one view are made such that capsules are dark, and the walls in them."""

    mirror: float | None
    walls: WallLines | None  # as stated or found; None where none were found

    @classmethod
    def of(
        cls, frames: Sequence[NDArray[Any]], empty: Floats | None, stated: WallLines | None, contrast: str | None
    ) -> Contrast:
        """Find out whether capsules and walls are darker or brighter than the liquid."""
        # the walls tell it where they are found in one of the two ways only, else the capsules do
        base = frames[0] if empty is None else empty
        walls = stated or (None if contrast == "bright" else find_walls(base))
        if contrast == "dark":
            return cls(None, walls)
        if contrast is None and walls is not None:
            ground = estimate_background(base, walls, percentile=50.0) if empty is None else empty
            if not is_brighter(frames, ground, walls):
                return cls(None, walls)
        # the empty channel becomes as bright as the brightest place, but for a single faulty pixel, and that as dark
        brightest = max(float(cv2.medianBlur(frame.astype(np.float32), 3).max()) for frame in (base, *frames))
        level = brightest + float(np.median(base))
        bright_walls = stated or find_walls(level - base)
        if contrast is None and bright_walls is None:
            return cls(None, walls)
        return cls(level, bright_walls)

    def darkened(self, grey: NDArray[Any]) -> NDArray[Any]:
        """Return grey levels as they are analysed."""
        return grey if self.mirror is None else self.mirror - grey

    def shown(self, picture: Picture) -> Picture:
        """Return a picture as it is analysed."""
        return picture if self.mirror is None else picture.mirrored(self.mirror)


# Light that falls off towards the borders, as by a lens or a lamp off the middle: taken out where it is strong

_FOLLOWED_CORE = 0.6  # of the half width: part of the channel whose light is followed along it
_STRONG = 0.18  # fall of the light along the channel up to which lengths and walls are right as they are
_BEYOND, _FEWEST_ROWS = 3.0, 8  # of the width of a wall's line, beyond which light is followed; rows that this needs
_DARK, _LITTLE = 0.02, 0.01  # below the trend by more than this share of it, and how little such a column then counts
_FREE = 0.4  # of the columns, that need to follow the trend
_ROUNDS = 30


def falling_light(grey: Floats, walls: WallLines) -> Floats | None:
    """Return the light of a picture (rows, columns) where it falls off along the channel; None where it hardly does."""
    # 1 + b x + c (x^2 + y^2) with c <= 0, as a lens loses light alike in all directions; from what lies beyond the
    # walls, or from the columns of the channel that a dark capsule leaves free
    rows, columns = grey.shape
    away = np.abs(walls.offset(grey.shape))
    strip = away > walls.half_width + _BEYOND * walls.line_width
    if strip.sum(axis=0).min() < _FEWEST_ROWS:
        strip = away < _FOLLOWED_CORE * walls.half_width
    if not strip.any(axis=0).all():
        return None
    level = _quantiles(np.where(strip, grey, np.nan)[strip.any(axis=1)].T, 0.5)
    x = np.arange(columns) - 0.5 * (columns - 1)
    weight, powers = np.ones(columns), 3
    for _ in range(_ROUNDS):  # least squares that leave dark columns out
        design = np.stack([x**power for power in range(powers)], axis=1) * weight[:, None]
        fit = np.append(np.linalg.lstsq(design, level * weight, rcond=None)[0], 0.0)[:3]
        before, powers = (weight, powers), 3 if fit[2] < 0.0 else 2
        trend = fit[0] + fit[1] * x + min(fit[2], 0.0) * x**2
        weight = np.where(level < (1.0 - _DARK) * trend, _LITTLE, 1.0)
        if powers == before[1] and np.array_equal(weight, before[0]):  # the next fit is the same
            break
    if trend.min() <= 0.0 or 1.0 - trend.min() / trend.max() < _STRONG or np.mean(weight) < _FREE:
        return None
    y = np.arange(rows)[:, None] - 0.5 * (rows - 1)
    return np.asarray(np.maximum(1.0 + (fit[1] * x + min(fit[2], 0.0) * (x**2 + y**2)) / fit[0], 0.1))


# Dark blobs between the walls: those that are capsules to measure, and the reasons why the others are not

_SMALLEST_AREA = 0.2  # l^2: smaller blobs are debris
_SPECK = 0.02  # l^2: smaller blobs are ignored
CONTRAST, FAINTEST = 0.03, 0.015  # of the light: fainter blobs are ignored; where the empty channel is given
_SIGNIFICANCE = 5.0  # of the contrast over the noise of a smoothed pixel
_BORDER = 3  # px: nearer to the border of the picture the outline cannot be located
_NOTCH = 1.5, 0.1  # px, and of the radius of a circle of the same area: concave rears leave up to 0.07
_RIM, _CENTRAL = 0.5, 0.3  # of the breadth: least opening of a rear; of it, how far off its middle it is deepest
_CLEARANCE = 12.0  # px that an edge needs on its outside to be located
_DARKEST_PIXELS = 0.01, 0.1  # of the pixels between the walls, of l^2: half as dark as these is the level of a blob
_BY_WALL = 0.5  # of the half width from the axis: a capsule that leaves the picture is nearer to it
_LINE = 6.0  # px: a capsule that leaves the picture is wider there
_BUMPS = 3.0  # of the spread of rough walls, whose bumps within it are dark before an estimated background
_PIECE = 0.02  # of the largest piece of a mask: smaller pieces are ignored


@dataclass(frozen=True, eq=False)
class Blob:
    """A dark blob."""

    polygon: Floats = field(repr=False)  # (p, 2) [px]: outline to a pixel
    area: float  # [px^2]
    status: Status = Status.DONE  # ``DONE`` if it can be a capsule to measure
    erased: Booleans | None = field(default=None, repr=False)  # (p,): where the outline was erased, and is a bridge

    @property
    def middle(self) -> Floats:
        """Middle (x, y) of the bounding box : (2,) array [px]."""
        return np.asarray(0.5 * (self.polygon.min(axis=0) + self.polygon.max(axis=0)))


def find_blobs(
    light: Floats, walls: WallLines, noise: float, erased: Floats | None = None, contrast: float = CONTRAST
) -> list[Blob]:
    """Find the dark blobs between the walls, from left to right, without what lies in erased boxes (k, 4) [px]."""
    dark = cv2.GaussianBlur(np.subtract(1.0, light, dtype=np.float32), (0, 0), 1.0)
    between = between_walls(walls, light.shape)
    least = max(contrast, _SIGNIFICANCE * 0.3 * noise)
    # half as dark as the darkest pixels is the level: where fewer are twice as dark as the least one, there is no blob
    darkest = dark[between & (dark >= 2.0 * least)]
    share, squares = _DARKEST_PIXELS
    rank = round(min(share * np.count_nonzero(between), squares * walls.half_width**2)) + 1
    if len(darkest) < rank:
        return []

    def half_as_dark(number: int) -> list[Blob]:
        level = 0.5 * float(np.partition(darkest, -number)[-number])
        mask = ((dark > level) & between).astype(np.uint8)
        closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), dtype=np.uint8))
        return _pieces(np.asarray(closed, dtype=np.uint8))

    pieces, smallest = half_as_dark(rank), _SMALLEST_AREA * walls.half_width**2
    if len(darkest) >= round(smallest) and all(piece.area < smallest for piece in pieces):
        fainter = half_as_dark(round(smallest))  # the darkest pixels may all be those of a particle in a capsule
        if any(piece.area >= smallest for piece in fainter):
            pieces = fainter
    blobs = [piece for piece in pieces if piece.area > _SPECK * walls.half_width**2]
    if erased is not None:
        blobs = [left for blob in blobs if (left := _erased(blob, erased)) is not None]
    blobs.sort(key=lambda blob: float(blob.middle[0]))
    return [replace(blob, status=_status(blob, blobs, dark.shape, walls.half_width)) for blob in blobs]


def blobs_in_empty(empty: Floats, walls: WallLines) -> list[Blob]:
    """Find what is dark in a picture that should be of the empty channel."""
    light = flatten(transmission(empty, estimate_background(empty, walls)), walls)
    return find_blobs(light, walls, pixel_noise(light))


def _erased(blob: Blob, boxes: Floats) -> Blob | None:
    """Return a blob without what lies within boxes, None if that is all of it."""
    left = bridged(blob.polygon, within(blob.polygon, boxes))
    return None if left is None else replace(blob, polygon=left[0], erased=left[1])


def is_shadow(blob: Blob, walls: WallLines, columns: int) -> bool:
    """Return True for a blob that runs through a picture of so many columns, or leaves it by one wall or as a line."""
    x = blob.polygon[:, 0]
    left, right = x < _BORDER, x > columns - 1.0 - _BORDER
    if left.any() and right.any():
        return True
    ends = (left, x < _CLEARANCE), (right, x > columns - 1.0 - _CLEARANCE)
    if any(out.any() and np.ptp(blob.polygon[end] @ walls.across) < _LINE for out, end in ends):
        return True
    leaving = (blob.polygon[left | right] - walls.middle) @ walls.across / walls.half_width
    return len(leaving) > 0 and bool(np.abs(leaving).min() > _BY_WALL and abs(np.sign(leaving).mean()) == 1.0)


def blob_of_mask(mask: Booleans, walls: WallLines) -> Blob:
    """Return the object that a mask (rows, columns) shows; an object in several pieces is refused."""
    pieces = sorted(_pieces(mask.astype(np.uint8)), key=lambda blob: blob.area)
    if not pieces:
        return Blob(np.zeros((1, 2)), 0.0, Status.NO_CAPSULE)
    *others, blob = pieces
    if others and others[-1].area > _PIECE * blob.area:
        return replace(blob, status=Status.BROKEN_MASK)
    return replace(blob, status=_status(blob, [], mask.shape, walls.half_width))


def _pieces(mask: NDArray[np.uint8]) -> list[Blob]:
    """Return the connected pieces of a mask, their status not yet judged."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    areas = ((contour, cv2.contourArea(contour, oriented=True)) for contour in contours)
    return [Blob(contour[:: 1 if area > 0.0 else -1, 0].astype(float), abs(area)) for contour, area in areas]


@lru_cache(maxsize=1)  # the frames of a film share it
def between_walls(walls: WallLines, shape: tuple[int, ...]) -> Booleans:
    """Return which pixels of a picture lie between the walls and off their lines and bumps."""
    mask = walls.between(shape, 0.5 * walls.line_width + _BUMPS * walls.rough)
    mask.flags.writeable = False
    return mask


def _status(blob: Blob, blobs: list[Blob], shape: tuple[int, ...], half_width: float) -> Status:
    """Judge a blob in a picture of a shape with other blobs."""
    rows, columns = shape
    if blob.polygon.min() < _BORDER or np.any(blob.polygon > np.array([columns, rows]) - 1.0 - _BORDER):
        return Status.TOUCHES_BORDER
    if blob.area < _SMALLEST_AREA * half_width**2:
        return Status.DEBRIS
    deep = _hollows(blob.polygon, max(_NOTCH[0], _NOTCH[1] * np.sqrt(blob.area / np.pi)))
    if len(deep):
        is_rear = len(deep) == 1 and _is_rear(deep[0], float(np.ptp(blob.polygon[:, 1])))
        return Status.NO_EDGE if is_rear else Status.DOUBLET
    low, high = blob.polygon.min(axis=0) - _CLEARANCE, blob.polygon.max(axis=0) + _CLEARANCE
    others = (other.polygon for other in blobs if other is not blob)
    close = any(np.any(np.all((polygon > low) & (polygon < high), axis=1)) for polygon in others)
    return Status.TOO_CLOSE if close else Status.DONE


def _is_rear(hollow: Floats, breadth: float) -> bool:
    """Return whether a hollow (3, 2) is that of a concave rear, whose rim is too faint, and not of dirt."""
    first, last, deepest = hollow
    along, across = np.abs(last - first)
    aside = abs(2.0 * deepest[1] - first[1] - last[1])
    return bool(across > max(_RIM * breadth, along) and aside < _CENTRAL * across)


def _hollows(polygon: Floats, deeper: float) -> Floats:
    """Return first, last and deepest point of the hollows of an outline deeper than so many px : (n, 3, 2) array."""
    corners = np.rint(polygon).astype(np.int32)[:, None]
    hull = cv2.convexHull(corners, returnPoints=False)
    hull[::-1].sort(axis=0)  # where a contour passes a pixel twice, OpenCV needs the hull in one sense
    defects = cv2.convexityDefects(corners, hull)
    defects = np.zeros((0, 4), dtype=int) if defects is None else defects.reshape(-1, 4)
    return np.asarray(polygon[defects[defects[:, 3] > 256.0 * deeper, :3]])


# Whether a picture of the empty channel belongs to that of a capsule: its light, its place, and that it is empty

_END_COLUMNS = 0.05  # of the columns at either border, which a capsule that can be measured does not reach
_GAIN = 1.3  # largest ratio of the lights of picture and background; lengths are right up to it
_WIDER = 0.2  # px: largest difference of the two half widths
_FAINT_DIFFERENCE = 0.1  # of the range of the picture's levels: smaller differences are those of a dark ground
_DEPTHS = (8, 10, 12, 14, 16)  # bits of a camera
_SHIFT = 1.2  # px: largest shift across the channel; 1.5 px leave lengths right, at 2 px a wall becomes a blob
_TURN = 0.2  # px at the distance l from the axis, by which an end of the capsule is shifted
_BETTER = 0.8  # of the difference, left when the background is laid onto the picture
_BY_WALLS = 12.0  # px from a wall, where it counts
_BRIGHTER_PIXEL = 1.05  # light of a pixel that is dark in the background alone
_UNLIKE = 0.1  # of something dark in the background: share that is not in the picture


def check_light(picture: Picture, background: Picture, most: float = _GAIN) -> None:
    """Refuse a background that was taken with another exposure or depth, whose light differs by a factor `most`."""
    seen, empty = picture.grey, background.grey
    columns = max(3, round(_END_COLUMNS * seen.shape[1]))
    ends = np.r_[:columns, -columns:0]
    if np.mean(picture.clipped[:, ends]) > 0.5:  # said when its walls are known
        return
    level, ground = float(np.median(seen[:, ends])), float(np.median(empty[:, ends]))
    low, high = quantile(seen, 0.01), quantile(seen, 0.99)
    if abs(level - ground) <= _FAINT_DIFFERENCE * (high - low) or 1.0 / most <= level / max(ground, 1e-9) <= most:
        return
    way = "darker" if ground < level else "brighter"
    got = f"one that is {way}: its median is {ground / max(level, 1e-9):.2g} of the picture's"
    bits = [next((depth for depth in _DEPTHS if grey.max() < 2**depth), 32) for grey in (empty, seen)]
    if bits[0] != bits[1]:
        got += f" ({bits[0]} bits, and the picture {bits[1]})"
    raise _error(background, "a background as bright as the picture", got, "take both with the same exposure and depth")


def check_place(seen: Floats, background: Picture, walls: WallLines | None) -> None:
    """Refuse a background that lies elsewhere or is turned or of another channel, or not empty as the picture is."""
    empty = background.grey
    found = walls is not None and not walls.stated  # in the background, where it is given
    in_picture, in_background = find_walls(seen), walls if found else find_walls(empty)
    if in_picture is not None and in_background is None and find_walls(np.ascontiguousarray(empty.T)) is not None:
        got = "one whose channel runs up and down"
        raise _error(background, "a background of the same channel", got, "take both the same way round")
    if walls is None and (in_picture or find_walls(seen.max() + np.median(seen) - seen)):
        raise _error(background, "a background of the same channel", "one without its walls", "take both at one place")
    if in_picture is not None and in_background is not None:
        down = float(in_background.centre_row - in_picture.centre_row)
        turn = float(np.degrees(in_background.tilt - in_picture.tilt))
        askew = np.radians(abs(turn)) * in_picture.half_width > _TURN
        wide = in_background.half_width / in_picture.half_width
        unlike = abs(in_background.half_width - in_picture.half_width) > _WIDER
        lies = f"lies {abs(down):.1f} px {'lower' if down > 0.0 else 'higher'} than it" if abs(down) > _SHIFT else ""
        turned = f"is turned by {abs(turn):.1f} degrees" if askew else ""
        other = f"shows a channel {abs(wide - 1.0):.1%} {'wider' if wide > 1.0 else 'narrower'}" if unlike else ""
        if (lies or turned or other) and _lies_better(seen, empty, in_picture, down, turn, wide):
            got = f"one that {' and '.join(filter(None, (lies, turned, other)))}"
            raise _error(
                background, "a background that fits the picture", got, "take both at one place and magnification"
            )
    if walls is None or not np.any(walls.between(empty.shape, 0.5 * walls.half_width)):
        return
    over = transmission(seen, empty)
    for blob in blobs_in_empty(empty, walls):
        inside = np.zeros(empty.shape, np.uint8)
        cv2.fillPoly(inside, [blob.polygon.astype(np.int32)], 1)
        fuller = np.mean(over[inside > 0] > _BRIGHTER_PIXEL) > _UNLIKE or np.array_equal(seen, empty)
        if blob.status is not Status.DEBRIS and fuller:
            got = "one with something dark at column {:.0f}, row {:.0f}".format(*blob.middle)
            raise _error(background, "the empty channel", got, "take it without a capsule")


def _lies_better(seen: Floats, empty: Floats, walls: WallLines, down: float, turn: float, wide: float) -> bool:
    """Return whether the background differs less from the picture by the walls when it is moved, turned and scaled."""
    move = cv2.getRotationMatrix2D((walls.centre_column, walls.centre_row + down), turn, 1.0 / wide)
    move[1, 2] -= down
    moved = cv2.warpAffine(empty, move, empty.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    near = np.abs(np.abs(walls.offset(empty.shape)) - walls.half_width) < _BY_WALLS
    return bool(np.mean(np.abs(seen - moved)[near]) < _BETTER * np.mean(np.abs(seen - empty)[near]))


def _error(background: Picture, expected: str, got: str, advice: str) -> InputError:
    return InputError(background.source or "background", "", expected, got, f"{advice}, or leave the background out")


# A filter makes the noise of a camera alike over some pixels; compression too, and leaves steps between blocks of 8 x
# 8. Both flatten the dark line along the edge of a capsule, which is then found further out

_LAGS = np.array([1, 2, 3, 4, 6])  # px; over the last, noise is independent in all but the widest filters
_NOISE_TILE = 16  # px
_FEWEST_TILES = 4  # the median over them is that of the noise, also where some show specks
_ENOUGH = 400  # tiles: of a large picture, every second, third ... is taken
_BLOCK = 8  # px
_STEPS = 4.0  # least ratio of the steps between blocks to those within, both axes multiplied; by chance it is below 1.8
_LOST = 0.3  # least loss of noise that is no chance
_ALL = 2.0  # loss of a picture whose noise is lost altogether, and the largest one of a compressed picture
_FILTERED, _COMPRESSED = 0.10, 0.05  # px: error of an edge over the square of the loss; over the loss
_AROUND, _CLEAR_OF_LINE = 12.0, 3.0  # px around a blob, and widths of a wall's line, that are left out


def edge_shift(light: Floats, walls: WallLines, blobs: list[Blob]) -> float:
    """Return the standard error [px] that all edges share where the picture was smoothed; 0 where none is seen."""
    free = _free(light.shape, walls, blobs)
    sums, counts = _tile_sums(light, free, _LAGS, _NOISE_TILE, max(1, light.size // (_ENOUGH * _NOISE_TILE**2)))
    whole = counts[:, -1] >= _NOISE_TILE**2 // 2
    if np.count_nonzero(whole) < _FEWEST_TILES:
        return 0.0
    squares = np.median(sums[whole] / np.maximum(counts[whole], 1), axis=0)
    loss = float(np.sum(np.maximum(1.0 - squares[:-1] / squares[-1], 0.0))) if squares[-1] > 0.0 else _ALL
    if loss < _LOST:
        return 0.0
    if _has_blocks(light, free):
        return _COMPRESSED * min(loss, _ALL)
    return _FILTERED * loss**2 if squares[-1] > 0.0 else 0.0


def _free(shape: tuple[int, ...], walls: WallLines, blobs: list[Blob]) -> Booleans:
    """Return which pixels show the liquid alone : (rows, columns) array."""
    free = walls.between(shape, _CLEAR_OF_LINE * walls.line_width)
    for blob in blobs:
        low = np.maximum(np.floor(blob.polygon.min(axis=0) - _AROUND), 0.0).astype(int)
        high = np.ceil(blob.polygon.max(axis=0) + _AROUND).astype(int)
        free[low[1] : high[1], low[0] : high[0]] = False
    return free


@njit(cache=True, nogil=True, error_model="numpy")
def _tile_sums(light, free, lags, size, every):  # type: ignore[no-untyped-def]
    """Return sums of squared second differences at each lag along rows and columns, and their numbers, of each tile."""
    # a slope of the light has no second difference; of the tiles, only every so many are summed
    rows, columns = light.shape
    across = (columns + size - 1) // size
    sums = np.zeros((((rows + size - 1) // size) * across, len(lags)))
    counts = np.zeros(sums.shape, dtype=np.int64)
    for tile in range(0, len(sums), every):
        top, left = size * (tile // across), size * (tile % across)
        for i in range(top, min(top + size, rows)):
            for j in range(left, min(left + size, columns)):
                if not free[i, j]:
                    continue
                for n in range(len(lags)):
                    k = lags[n]
                    if k <= i < rows - k and free[i - k, j] and free[i + k, j]:
                        sums[tile, n] += (light[i, j] - 0.5 * (light[i - k, j] + light[i + k, j])) ** 2
                        counts[tile, n] += 1
                    if k <= j < columns - k and free[i, j - k] and free[i, j + k]:
                        sums[tile, n] += (light[i, j] - 0.5 * (light[i, j - k] + light[i, j + k])) ** 2
                        counts[tile, n] += 1
    return sums, counts


def _has_blocks(light: Floats, free: Booleans) -> bool:
    """Return whether the steps from pixel to pixel are larger at every eighth row and column than between."""
    ratio = 1.0
    for along, clear in ((light, free), (light.T, free.T)):
        inside = clear[1:] & clear[:-1]
        steps = np.sum(np.square(np.diff(along, axis=0)), axis=1, where=inside)
        number = np.count_nonzero(inside, axis=1)
        phase = np.arange(len(steps)) % _BLOCK
        mean = np.bincount(phase, steps, _BLOCK) / np.maximum(np.bincount(phase, number, _BLOCK), 1)
        if mean.max() > 0.0:
            ratio *= float(mean.max() / max(np.median(mean), 1e-12))
    return ratio > _STEPS
