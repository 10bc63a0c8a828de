"""The walls of the channel, found in a picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.ndimage import gaussian_filter1d

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edge_models import Model, RobustFit, fit_without_outliers, locate, median, robust_spread

_MARGIN = 20.0  # px beyond the walls: edges next to a wall are located in what is within it
_WHOLE = 16  # px: neighbouring pixels are compared in tiles
_CLEAR = 2.0  # of the width of a wall's dark line: nearer to it, blur mixes the two, and an edge is found too far out
_STRIPS = 12
_SLOPES = np.linspace(-0.12, 0.12, 25)
_SMOOTHING = 2.0  # px
_APART = 0.15  # of the picture's height, at least
_NARROWEST = 20.0  # px: or so much; the reaches of two nearer lines would overlap
_SIGNIFICANCE = 8.0  # of a wall's darkness over the spread of that of all lines
_INSIDE = 0.7  # of a wall's darkness: a line between the two that is darker is the wall of another channel
_REACH = 9  # px around a wall that are searched
_FLOOR = 0.005  # px: smallest spread of the strips about a wall
_SCATTER = 0.7  # px: largest spread of the strips about walls that bend or open, or are seen in parts
_SEEN = 0.75  # of the strips: rough walls are seen in as many, what is no wall in less than two thirds
_OWN = 0.1  # of the squares about parallel lines: bent or open walls leave less about a curve of their own each
_ROUGH = 0.2  # px: spread from which on a wall is rough, and l differs from place to place by as much
_UNLIKE = 0.09  # of the width of a wall's line: if both differ by more, as by a shadow, the walls are off by as much
_MISFIT = 0.03  # of the width of a wall's line: how far the model's middle may be from the wall
_OF_STEP = 0.13  # 1/px: of the square of that width, times the step of the light there over the line's darkness
_BROAD, _OF_BROAD = 3.4, 0.5  # px: width from which on a line is not seen whole; its error over its width


@dataclass(frozen=True)
class WallLines:
    """Walls of the channel in a picture."""

    centre_row: float  # [px]: row at which the centre line crosses the middle column
    centre_column: float  # [px]: that column
    tilt: float  # [rad]: angle of the centre line to the rows, from x towards y
    half_width: float  # [px]: l
    half_width_error: float
    line_width: float  # [px]: standard deviation of the dark lines across
    stated: str = ""  # how the walls were stated by hand; empty if they were found in the picture
    off_band: tuple[float, float] = (0.0, 0.0)  # [px]: of stated walls, outside the nearest dark line if clearly off it
    rough: float = 0.0  # [px]: spread of the places of walls that are found as rough ones, 0 of others

    @property
    def change(self) -> float:
        """How much larger l is if the nearest dark lines are the walls [px]."""
        return -0.5 * sum(self.off_band)

    @property
    def doubt(self) -> str:
        """What is doubtful about the walls, a sentence; empty if nothing."""
        off = [f"{abs(away):.1f} px {'outside' if away > 0.0 else 'inside'}" for away in self.off_band if away]
        if not off:
            return ""
        names = [name for name, away in zip(("upper", "lower"), self.off_band, strict=True) if away]
        which = f"The {names[0]} wall lies {off[0]}" if len(off) == 1 else f"The walls lie {off[0]} and {off[1]}"
        return (
            f"{which} the nearest dark line of the picture; if that is the wall, l is "
            f"{abs(self.change) / self.half_width:.1%} {'smaller' if self.change < 0.0 else 'larger'}."
        )

    @property
    def middle(self) -> Floats:
        """Point (x, y) of the centre line, in the middle column."""
        return np.array([self.centre_column, self.centre_row])

    @property
    def along(self) -> Floats:
        """Unit vector (x, y) to the right along the centre line."""
        return np.array([np.cos(self.tilt), np.sin(self.tilt)])

    @property
    def across(self) -> Floats:
        """Unit vector (x, y) downwards across the centre line."""
        return np.array([-np.sin(self.tilt), np.cos(self.tilt)])

    def rows_around(self, shape: tuple[int, ...]) -> slice:
        """Return the rows of a picture that show the walls and what lies between, from a multiple of 16 on."""
        aside = max(self.centre_column, shape[1] - self.centre_column)
        reach = self.half_width + _MARGIN + abs(np.tan(self.tilt)) * aside
        first = max(0, min(int(self.centre_row - reach), shape[0] - _WHOLE)) // _WHOLE * _WHOLE
        return slice(first, min(shape[0], max(int(self.centre_row + reach) + 2, first + _WHOLE)))

    def offset(self, shape: tuple[int, ...]) -> Floats:
        """Return the distance of each pixel of a picture from the centre line, positive below : array of `shape`."""
        rows, columns = (np.arange(count, dtype=float) for count in shape)
        below, right = rows[:, None] - self.centre_row, columns - self.centre_column
        return np.asarray(below * self.across[1] + right * self.across[0])

    def between(self, shape: tuple[int, ...], aside: float = 0.0) -> Booleans:
        """Return which pixels of a picture lie between the walls and farther from them than so much [px]."""
        return np.asarray(np.abs(self.offset(shape)) < self.half_width - aside)

    def moved(self, right: float, down: float) -> WallLines:
        """Return the same lines in a picture whose first pixel lies further left and further up by so much [px]."""
        row, column = float(self.centre_row + down), float(self.centre_column + right)
        return replace(self, centre_row=row, centre_column=column)

    def centred_at(self, column: float) -> WallLines:
        """Return the same lines, their centre at another column."""
        row = self.centre_row + np.tan(self.tilt) * (column - self.centre_column)
        return replace(self, centre_row=float(row), centre_column=column)

    def clearance(self, points: Floats) -> Floats:
        """Return the distance of points (n, 2) from the nearer wall, negative beyond it : (n,) array [px]."""
        return np.asarray(self.half_width - np.abs((points - self.middle) @ self.across))

    def is_clear(self, clearance: Floats) -> Booleans:
        """Return which points are far enough from the walls for their edge, by their distances from the nearer one."""
        return np.asarray(clearance > _CLEAR * np.hypot(self.line_width, self.rough))


def find_walls(grey: Floats) -> WallLines | None:
    """Find the walls in a picture, preferably of the empty channel; None unless two parallel dark lines cross it."""
    columns = grey.shape[1] // _STRIPS
    strips = grey[:, : columns * _STRIPS].reshape(len(grey), _STRIPS, columns).mean(axis=2).T
    middle = 0.5 * (grey.shape[1] - 1)
    places = columns * (np.arange(_STRIPS) + 0.5) - 0.5 - middle
    start = _coarse(strips, places)
    return None if start is None else _fine(strips, places, start, middle)


def _coarse(strips: Floats, places: Floats) -> Floats | None:
    """Return the rows of the upper and the lower wall in each strip : (2, strips) array, to a pixel or two."""
    ridge = gaussian_filter1d(strips, _SMOOTHING, axis=1, order=2, mode="nearest")
    rows = np.arange(strips.shape[1])
    dark = _dark_lines(ridge, np.rint(_SLOPES[:, None] * places).astype(np.int64))
    first, each = dark.argmax(axis=1), np.arange(len(_SLOPES))
    for apart, aside in ((_APART * len(rows), 0), (_NARROWEST, len(rows))):  # of a narrow one, no line is seen beyond
        second = np.where(np.abs(rows - first[:, None]) > apart, dark, -np.inf).argmax(axis=1)
        fainter = dark[each, second]
        best = int(np.argmax(dark[each, first] + fainter))
        line, (upper, lower) = dark[best], np.sort([first[best], second[best]])
        others = np.minimum(np.abs(rows - upper), np.abs(rows - lower)) >= _REACH
        others &= (rows > upper - aside) & (rows < lower + aside)
        least = max(_SIGNIFICANCE * robust_spread(line[np.isfinite(line)]), 1e-3 * median(strips))
        if fainter[best] > least and line[others].max(initial=-np.inf) <= _INSIDE * fainter[best]:
            return np.array([upper, lower])[:, None] + _SLOPES[best] * places
    return None


@njit(cache=True, nogil=True, error_model="numpy")
def _dark_lines(ridge, shifts):  # type: ignore[no-untyped-def]
    """Return how dark the line is that begins at each row and is shifted from strip to strip : (s, rows) array."""
    # The ridge is an array (strips, rows), the shifts (s, strips). A line that leaves the picture is none. A capsule
    # darkens some strips only: a wall is dark in three of four.
    strips, rows = ridge.shape
    rank = strips // 4
    dark, value = np.empty((len(shifts), rows)), np.empty(rows)
    least = np.empty((rank + 1, rows))  # the least values of each line in their order
    for s in range(len(shifts)):
        least[:] = np.inf
        for strip in range(strips):
            for row in range(rows):
                at = row + shifts[s, strip]
                value[row] = ridge[strip, at] if 0 <= at < rows else -np.inf
            for place in range(rank + 1):
                for row in range(rows):  # a processor compares several rows at once
                    smaller = value[row] < least[place, row]
                    low, high = least[place, row], value[row]
                    least[place, row], value[row] = (high, low) if smaller else (low, high)
        dark[s] = least[rank]
    return dark


def _fine(strips: Floats, places: Floats, start: Floats, middle: float) -> WallLines | None:
    """Locate the line in each strip, and fit two parallel lines to the places."""
    nearest = np.rint(start).astype(int).ravel()
    samples = np.arange(-_REACH, _REACH + 1)
    rows = nearest[:, None] + samples
    within = (rows >= 0) & (rows < strips.shape[1])
    profiles = np.concatenate([strips, strips])[np.arange(2 * _STRIPS)[:, None], np.clip(rows, 0, strips.shape[1] - 1)]
    lines = locate(
        profiles / median(strips),
        samples.astype(float),
        Model.LINE,
        np.zeros(2 * _STRIPS),
        np.full(2 * _STRIPS, _SMOOTHING),
        within.astype(float),
    )
    located = (lines.coefficients[:, 0] < 0.0) & (np.abs(lines.place) < 0.6 * _REACH)
    below = np.repeat([0.0, 1.0], _STRIPS)
    fit = fit_without_outliers(
        np.stack([1.0 - below, below, np.concatenate([places, places])], axis=1),
        nearest + lines.place,
        located,
        rounds=3,
        floor=_FLOOR,
        enough=lambda kept: min(kept[:_STRIPS].sum(), kept[_STRIPS:].sum()) >= _STRIPS // 3,
    )
    if fit is None or (fit.spread > _SCATTER and not _are_rough(fit, nearest + lines.place, below, places)):
        return None
    upper, lower, slope = fit.coefficients
    covariance = fit.cofactor * fit.variance
    tilt = float(np.arctan(slope))
    half = 0.5 * np.cos(tilt)
    width = median(lines.width[fit.kept])
    variance = half**2 * (covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]) + 0.5 * (_MISFIT * width) ** 2
    walls = [(side == below) & fit.kept for side in (0.0, 1.0)]
    dark, step = (np.array([median(lines.coefficients[wall, of]) for wall in walls]) for of in (0, 2))
    variance += (_OF_STEP * width**2 * float(np.mean(step / dark * [1.0, -1.0]))) ** 2
    of_upper, of_lower = (median(lines.width[wall]) for wall in walls)
    if width > _BROAD:
        variance += (_OF_BROAD * width) ** 2
    if fit.spread > _ROUGH:
        variance += fit.spread**2
    if abs(of_upper - of_lower) > _UNLIKE * width:
        variance += (of_upper - of_lower) ** 2
    return WallLines(
        centre_row=float(0.5 * (upper + lower)),
        centre_column=middle,
        tilt=tilt,
        half_width=float(half * (lower - upper)),
        half_width_error=float(np.sqrt(variance)),
        line_width=width,
        rough=fit.spread if fit.spread > _SCATTER else 0.0,
    )


def _are_rough(fit: RobustFit, values: Floats, below: Floats, places: Floats) -> bool:
    """Return whether walls scatter about their lines everywhere, and not because they bend or open."""
    curve = np.tile(np.vander(places / np.ptp(places), 3), (2, 1))
    curves = np.hstack([curve * side[:, None] for side in (1.0 - below, below)])[fit.kept]
    left, about_lines = (
        np.linalg.lstsq(design, values[fit.kept], rcond=None)[1].sum() for design in (curves, fit.design)
    )
    seen = min(fit.kept[:_STRIPS].sum(), fit.kept[_STRIPS:].sum())
    return bool(seen >= _SEEN * _STRIPS and left > _OWN * about_lines)
