"""The capsule in a picture: which blob it is, and its outline."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import correlate1d, map_coordinates, maximum_filter1d, uniform_filter1d
from scipy.spatial import KDTree
from scipy.special import ndtr

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.image.background import Blob, between_walls
from capsbayes.image.edge_models import median, quantile, rounded
from capsbayes.image.edges import (
    EDGE_FLOOR,
    EdgeOutline,
    FurthestPoint,
    RearBand,
    SilhouetteIntegrals,
    centroid,
    find_rear,
    furthest_point,
    integrate_silhouette,
    locate_edge,
    shows_second_nose,
)
from capsbayes.image.walls import WallLines
from capsbayes.measurement import MeasuredOutline
from capsbayes.quantity import Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


_SYMMETRIC = 0.005  # of the length: a centroid nearer to the middle does not distinguish front from rear
_LOPSIDED = 0.08  # of the breadth: real beads and cells stay below 0.04
_ENDS = 0.17  # of the length, omitted at either end
_FACING, _BESIDE = 0.8, 0.6  # cosines of a normal's angle to the channel: least at the ends, largest at the flanks
_FOUND = 0.5  # of an end: part along which the edge must be located
_MAY_BE_COMBED = (Status.DONE, Status.DOUBLET, Status.TOO_CLOSE, Status.NO_EDGE)
_FEWEST_ROWS = 8
_COMB = 0.2  # of the darkness of a blob: a shift by half a pixel; in pictures of one moment rows differ by up to 0.06
_CHANCE = 10.0  # standard deviations of the noise over the root of the rows: in one of a hundred columns it makes 6
_WIDEST = 3.3  # px: a blur of 3 px, up to which intervals were counted, leaves 2.8 to 3.2 in the upper quartile
_SMEARED = 4.0  # px of motion during the exposure; where 3 px are seen as 2.7 to 3.5, intervals are right
_WALL_SMOOTHING = 4.0  # points of an outline: standard deviation of the Gaussian that smooths it
_CLEAR_OF_WALL = 3.0  # of the width of a wall's line
# 1/px: error of the located edge over its width squared, beside what all edges share; at the rear end it is larger, as
# a concave rear darkens what lies behind it. Both were set on drawn pictures, other ones than those counted.
_NOSE_MISFIT, _END_MISFIT = 0.039, 0.06


@dataclass(frozen=True, eq=False)
class Detection:
    """What was detected in a picture, in pixels; outline, rear and integrals are as the camera saw them."""

    status: Status  # ``DONE``, or why nothing can be measured; what could not be located is then None
    walls: WallLines | None = None
    outline: EdgeOutline | None = None
    flow: int = 0  # 1 to the right, -1 to the left, 0 if the shape does not tell
    nose: FurthestPoint | None = None  # downstream, as a distance along the flow from the picture's origin
    end: FurthestPoint | None = None  # upstream
    rear: RearBand | None = None  # the concave rear where it is seen
    blob: Blob | None = None  # the dark blob that was analysed
    shift: float = 0.0  # [px]: standard error of all edges that follows from smoothing of the picture
    offset: float = 0.0  # [px]: that of all edges, alike all around, from all causes
    line: float = 0.0  # [px]: half the breadth of a membrane that is seen as a line or a thin shell, 0 where it is not
    inwards: float = 0.0  # [px]: how far the edge is taken within the outer side of this line, in the mean
    fringe: float = 0.0  # light of a bright fringe outside the edge over the darkness at it; 0 if the offset is stated
    factors: Floats = field(default_factory=lambda: np.ones(2))  # L_z and L_a over those seen by the camera : (2,)
    further: Floats = field(default_factory=lambda: np.zeros((2, 2)))  # [px^2]: errors by the camera and if askew
    silhouette: MeasuredOutline | None = None  # over l, without the faults of the camera

    def located(self) -> tuple[WallLines, EdgeOutline]:
        """Return walls and outline of a detection that has both."""
        if self.walls is None or self.outline is None:
            raise ValueError(f"nothing was located: {self.status.name}")
        return self.walls, self.outline

    @property
    def axis(self) -> Floats:
        """Point (x, y) of the capsule's axis nearest to the picture's origin : (2,) array [px]; NaN where missing."""
        if self.walls is None or self.outline is None:
            return np.full(2, np.nan)
        across = self.outline.points @ self.walls.across
        return np.asarray(0.5 * (across.max() + across.min()) * self.walls.across)

    @property
    def lengths(self) -> Floats:
        """L_z, L_a, L_p and l, without known faults of the camera : (4,) array [px]; NaN where missing."""
        if self.walls is None or self.nose is None or self.end is None:
            return np.full(4, np.nan)
        extent = self.nose.distance + self.end.distance
        depth = np.nan if self.rear is None else self.rear.depth
        extent, length = np.array([extent, extent - depth]) * self.factors
        return np.array([extent, length, extent - length, self.walls.half_width])

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of `lengths`, from all causes : (4, 4) array [px^2]; NaN where missing."""
        return self._covariance(systematic=False)

    @property
    def systematic_covariance(self) -> Floats:
        """The part of `covariance` that is the same in all pictures of a capsule : (4, 4) array [px^2]."""
        return self._covariance(systematic=True)

    @property
    def integrals(self) -> SilhouetteIntegrals | None:
        """Area, perimeter, volume of revolution and stretch ratio of the silhouette, with errors."""
        if self.walls is None or self.outline is None:
            return None
        return integrate_silhouette(self.outline, self.axis, self.walls.across, _NOSE_MISFIT, self.offset)

    def rear_line(self) -> Floats | None:
        """Return points along the concave rear, from rim to rim : (21, 2) array [px]; None where it is not seen."""
        if self.rear is None or self.walls is None or self.end is None:
            return None
        downstream = (self.flow or 1) * self.walls.along
        on_axis = self.axis + (self.rear.depth - self.end.distance) * downstream
        y = np.linspace(-self.rear.breadth, self.rear.breadth, 21)[:, None]
        return np.asarray(on_axis + y * self.walls.across + 0.5 * self.rear.curvature * y**2 * downstream)

    @property
    def ends(self) -> Floats:
        """Columns of the ends of L_z and L_a : (3,) array [px]; NaN where missing."""
        if self.walls is None or self.nose is None:
            return np.full(3, np.nan)
        distances = self.nose.distance - np.append(0.0, self.lengths[:2] / self.factors)
        return np.asarray(self.axis[0] + distances * (self.flow or 1) * self.walls.along[0])

    def moved(self, right: int, down: int) -> Detection:
        """Return the same in the coordinates of a picture whose first pixel lies further left and up by so much."""
        if self.walls is None or (right, down) == (0, 0):
            return self
        by = np.array([right, down], dtype=float)
        along = (self.flow or 1) * float(by @ self.walls.along)
        return replace(
            self,
            walls=self.walls.moved(*by),
            outline=self.outline and replace(self.outline, points=self.outline.points + by),
            nose=self.nose and replace(self.nose, distance=self.nose.distance + along),
            end=self.end and replace(self.end, distance=self.end.distance - along),
            blob=self.blob and replace(self.blob, polygon=self.blob.polygon + by),
        )

    def table(self) -> pd.DataFrame:
        """Tabulate lengths and integrals in powers of a pixel and of l."""
        import pandas as pd

        errors = np.sqrt(np.diag(self.covariance))
        half_width, half_width_error = float(self.lengths[3]), float(errors[3])
        rows = [(name, 1, *pair) for name, *pair in zip(("L_z", "L_a", "L_p", "l"), self.lengths, errors, strict=True)]
        if (over := self.integrals) is not None:
            named = ("perimeter", 1, over.perimeter), ("area", 2, over.area), ("volume", 3, over.volume)
            rows += [(name, power, q.value, q.error) for name, power, q in (*named, ("Lambda", 0, over.stretch_ratio))]
        table = pd.DataFrame(rows, columns=["quantity", "power", "value_px", "error_px"]).set_index("quantity")
        table["value_over_l"] = table["value_px"] / half_width ** table["power"]
        share = np.hypot(table["error_px"] / table["value_px"], table["power"] * half_width_error / half_width)
        table["error_over_l"] = table["value_over_l"] * share
        table.loc["l", "error_over_l"] = 0.0
        return table

    def _covariance(self, *, systematic: bool) -> Floats:
        if self.walls is None or self.nose is None or self.end is None:
            return np.full((4, 4), np.nan)
        nose, end = (point.systematic if systematic else point.variance for point in (self.nose, self.end))
        # the rays that find the rear start at the located end: its error does not enter that of the rear's place
        depth = math.nan
        if self.rear is not None:
            depth = self.rear.systematic if systematic else self.rear.depth_error**2
        shared = self.offset * np.array([2.0, 1.0])  # nose and end move apart, the rear stays
        seen = np.array([[nose + end, nose], [nose, nose + depth]]) + np.outer(shared, shared)
        (extent, both), (_, length) = seen * np.outer(self.factors, self.factors) + self.further
        return np.array(
            [
                [extent, both, extent - both, 0.0],
                [both, length, both - length, 0.0],
                [extent - both, both - length, extent + length - 2.0 * both, 0.0],
                [0.0, 0.0, 0.0, self.walls.half_width_error**2],
            ]
        )


def analyse_blob(
    light: Floats,
    noise: float,
    walls: WallLines,
    blob: Blob,
    flow: int = 0,
    shift: float = 0.0,
    edge_offset: Quantity | None = None,
) -> Detection:
    """Locate the edge of a blob, its ends and its rear; the offset is as `ByHand` states it."""
    if blob.status in _MAY_BE_COMBED and _combed(light, noise, blob):
        return Detection(Status.INTERLACED, walls, blob=blob)
    if not blob.status.ok:
        return Detection(blob.status, walls, blob=blob)
    outline = locate_edge(light, blob.polygon, noise, blob.erased, lambda outline: _ends_located(outline, walls))
    if outline is None:
        return Detection(Status.NO_EDGE, walls, blob=blob)
    outline = _smoothed_by_walls(outline, walls)
    if smear(outline, walls) > _SMEARED:
        return Detection(Status.SMEARED, walls, outline, blob=blob)
    if _asymmetry(outline, walls) > _LOPSIDED:
        return Detection(Status.LOPSIDED, walls, outline, blob=blob)
    of_shape = _flow_of_shape(outline, walls)
    if flow and of_shape == -flow:
        return Detection(Status.WRONG_FLOW, walls, outline, of_shape, blob=blob)
    beyond = _OF_WIDTH * float(np.mean(np.square(outline.edge_width[~outline.erased])))
    inwards, half_breadth, fringe, line = np.zeros(len(outline.points)), 0.0, 0.0, None
    if (edge := _Edge.of(light, outline, walls)) is not None:
        if edge.dark_outside > _OUTSIDE:
            return Detection(Status.OVERLAP, walls, outline, of_shape, blob=blob)
        beyond, fringe = np.hypot(beyond, edge.diffraction), edge.fringe
        line = edge.line(light, outline, walls)
    if line is not None:
        half_breadth, beyond = line.half_breadth, np.hypot(beyond, line.error)
        inwards = line.middle * (_HALFWAY if line.is_shell and edge_offset is None else 1.0)
    offset, outwards = np.hypot(shift, beyond), 0.0
    if edge_offset is not None:  # of a line it is stated from the middle
        fringe, offset, outwards = 0.0, edge_offset.sd, edge_offset.mean
    outline = replace(outline, points=outline.points + (outwards - inwards)[:, None] * outline.normals)
    found = Detection(
        Status.DONE,
        walls,
        outline,
        flow or of_shape,
        blob=blob,
        shift=shift,
        offset=float(np.hypot(EDGE_FLOOR, offset)),
        line=half_breadth,
        inwards=float(np.mean(inwards)),
        fringe=fringe,
    )
    return _with_ends(light, noise, found, unsure=0.0 if line is None else _BEHIND_SHELL)


# The error that all edges share, by their width, the dark ring and the bright fringe outside them. Width and ring were
# set on drawn pictures with rings of wavelengths from 4 to 7 px in halos of up to a quarter of the light; where these
# are blurred, none is seen. The fringe was set on pictures as a microscope makes them: light that is bent at the edge
# is bright next to it, and moves it, if the fringe is as narrow as the edge. Drawn halos, which fall off more slowly,
# moved it by 0.4 of the width times their light at most

_OF_WIDTH = 0.056  # 1/px: of the square of the edge's width
_OF_RING = 3.2  # px: of the depth of the ring over the darkness inside the edge
_OF_FRINGE = 10.0  # of the edge's width, and of the light of a fringe as narrow, over that darkness
_OF_HALO = 1.0  # of the same, of a halo that falls off more slowly; what is between counts in part
_SLOWLY = 4.0  # factor by which a halo falls at most over 2.5 widths of the edge
_RING = 2.5, 5.0, 9, 3  # of the edge's width, from and up to which it is sought; px, to which at least; beyond, level
_INSIDE = 3  # px: depth at which the edge's darkness is full
_FEWEST_NORMALS = 20
_EVERY, _MOST = 3, 0.75  # rows and columns of the channel, and the quantile of its light
_OUTSIDE = 0.15  # of the darkness at an edge: of drawn capsules up to 0.015 are left outside, where two overlap 0.36


# A membrane that is seen as a line: both flanks are steep, and what is darker inside begins at its middle. The membrane
# may lie anywhere in a dark line. A band with a steep flank outside alone is that of a membrane at its outer end. What
# is between, as a thin shell that is darkest along its tangents, has its edge between. Where the inside is dark, a
# narrow band cannot be told from such a shell, nor one that is lost in it: the edge stays, with a wider error

_IN_LINE = 0.5  # of half its breadth: standard error of the place of the membrane
_IN_SHELL = 0.4  # of the edge's width: that of what may be a shell; of drawn shells the edge is found 0.5 too far out
_LARGE = 25.0  # px: least half height, as a small sphere is a lens, whose middle is bright
_EVEN = 0.87  # least slope of its inner flank over that of the outer: of drawn lines 0.9 and more, of bands up to 0.7
_UNEVEN, _PALE, _SEEN = 0.6, 0.45, 1.1  # of a thin shell: least such slope, most darkness inside, and width in px
_HALFWAY = 0.45  # of the depth of its middle: the edge of a thin shell
_MAYBE = 0.68  # least such slope where it may be a shell; of drawn bands up to 0.57
_BEHIND_SHELL = 0.9  # of the blur: error of the rear of line or shell, whose dark band may end at it
_FAINT = 0.2  # of its darkness: at its inner end, and the least beyond that of the inside
_DEEP, _BREADTH = 12, 0.3  # px, and of the half height: depths that are looked at
_ALIKE = 9  # points over which the line is averaged
_FINE = 300  # depths between which its breadth is read


class _MembraneLine(NamedTuple):
    """Line as which a membrane is seen."""

    error: float  # [px]: of the place of the membrane
    middle: Floats  # (n,) [px]: depth of its middle at each point of the outline; 0 where the edge stays
    half_breadth: float = 0.0  # [px]: where it is half as dark; 0 where it is not seen as a line
    is_shell: bool = False  # whether its inner flank is less steep, as of a thin shell


@dataclass(frozen=True)
class _Edge:
    """Usual light across an edge, where no wall is near."""

    kept: Booleans  # (n,): points of the outline
    width: float  # [px]: of most of the edge
    level: float  # light outside
    full: float  # light of most of the channel
    darkest: float  # darkness at the edge, beyond that outside
    diffraction: float  # [px]: error of all edges, by the ring and the fringe outside
    fringe: float  # light of the bright fringe outside over the darkness at the edge

    @classmethod
    def of(cls, light: Floats, outline: EdgeOutline, walls: WallLines) -> _Edge | None:
        """Return what is seen along the normals of an outline; None where too few are free."""
        first, last, least, level_over = _RING
        width = median(outline.edge_width)
        beyond = max(least, math.ceil(last * width))
        away = np.arange(beyond + level_over)  # px outwards
        along = np.concatenate([np.arange(-_INSIDE, 0), away])
        clear = walls.clearance(outline.points) > away[-1] + _CLEAR_OF_WALL * walls.line_width
        kept = clear & outline.located
        if np.count_nonzero(kept) < _FEWEST_NORMALS:
            return None
        profile = _across(light, outline, along)[kept].mean(axis=0)
        level = float(profile[along >= beyond].mean())
        darkest = max(level - float(profile.min()), 1e-6)
        outside = (profile[_INSIDE:] - level) / darkest
        ring = max(-float(outside[away >= first * width].min()), 0.0)
        peak = int(np.argmax(outside[: beyond + 1]))
        fringe = max(float(outside[peak]), 0.0)
        further = peak + width * np.linspace(first - 0.5, first + 0.5, 5)  # over some pixels, where the edge is wide
        halo = max(float(np.interp(further, away, outside).mean()), 0.0)
        of_fringe = width * math.hypot(_OF_FRINGE * max(fringe - _SLOWLY * halo, 0.0), _OF_HALO * fringe)
        every = slice(None, None, _EVERY), slice(None, None, _EVERY)
        full = quantile(light[every][between_walls(walls, light.shape)[every]], _MOST)
        return cls(kept, width, level, full, darkest, math.hypot(_OF_RING * ring, of_fringe), fringe)

    @property
    def dark_outside(self) -> float:
        """Darkness outside the edge over that at it."""
        return (self.full - self.level) / (abs(self.full - self.level) + self.darkest)

    def line(self, light: Floats, outline: EdgeOutline, walls: WallLines) -> _MembraneLine | None:
        """Return the line or the thin shell as which a membrane is seen, if only perhaps; None where it is neither."""
        half = 0.5 * float(np.ptp(outline.points @ walls.across))
        if half < _LARGE:
            return None
        depth = np.arange(-_INSIDE, max(_DEEP, round(_BREADTH * half)) + 1)
        dark = self.level - self._usual(light, outline, depth)
        top = int(np.argmax(dark))
        if top == 0 or dark[top] < 1e-6:
            return None
        inside = max(float(dark[top:].min()), 0.0)
        end = top + int(np.argmax(dark[top:] <= inside + _FAINT * (dark[top] - inside)))
        within = depth[: end + 1]
        own, _ = _line_and_middle(dark[None, : end + 1], within, inside, self.width)
        slope = np.gradient(own[0])
        outer, inner = slope[: top + 1].max(), -slope[top:].min()
        is_seen, is_sharp = dark[top] - inside >= _FAINT * dark[top], self.width <= _SEEN
        is_line = is_seen and inner >= _EVEN * outer
        is_shell = is_seen and is_sharp and inner >= _UNEVEN * outer and inside <= _PALE * dark[top]
        if not (is_line or is_shell):
            may_be_shell = is_sharp and (not is_seen or inner >= _MAYBE * outer)
            return _MembraneLine(_IN_SHELL * self.width, np.zeros(len(self.kept))) if may_be_shell else None
        fine = np.linspace(within[0], within[-1], _FINE)
        above = np.interp(fine, within, own[0]) > 0.5 * own[0].max()
        line = self.level - uniform_filter1d(_across(light, outline, -within), _ALIKE, axis=0, mode="wrap")
        _, middle = _line_and_middle(line, within, inside, self.width)
        middle = np.where(self.kept, middle, median(middle[self.kept]))
        half_breadth = 0.5 * float(np.mean(above) * np.ptp(within))
        return _MembraneLine(_IN_LINE * half_breadth, middle, half_breadth, not is_line)

    def _usual(self, light: Floats, outline: EdgeOutline, depth: Integers) -> Floats:
        """Return the median light at depths : (m,) array."""
        return np.asarray(np.median(_across(light, outline, -depth)[self.kept], axis=0))


def _line_and_middle(dark: Floats, depth: Integers, inside: float, width: float) -> tuple[Floats, Floats]:
    """Return lines (n, m) without the darkness inside, which begins at their middles, and these (n,)."""
    middle = depth[np.argmax(dark, axis=1)].astype(np.float64)
    for _ in range(4):
        own = dark - inside * ndtr((depth - middle[:, None]) / width)
        core = np.maximum(own - 0.5 * own.max(axis=1, keepdims=True), 0.0)
        middle = core @ depth / np.maximum(core.sum(axis=1), 1e-9)
    return own, middle


def _across(light: Floats, outline: EdgeOutline, along: Integers) -> Floats:
    """Return the light at distances outwards along the normals of an outline : (n, m) array."""
    places = outline.points[:, None] + along[:, None] * outline.normals[:, None]
    return np.asarray(map_coordinates(light, np.moveaxis(places[..., ::-1], -1, 0), order=1, mode="nearest"))


def _combed(light: Floats, noise: float, blob: Blob) -> bool:
    """Return whether the odd rows of a blob show it elsewhere along the channel than the even ones."""
    # in each column every other row is compared with its neighbours, away from the flanks
    (left, top), (right, bottom) = blob.polygon.min(axis=0).astype(int), blob.polygon.max(axis=0).astype(int)
    aside = (bottom - top) // 4
    part = light[top + aside : bottom - aside + 1, left : right + 1]
    if len(part) < _FEWEST_ROWS:
        return False
    second = part[1:-1] - 0.5 * (part[:-2] + part[2:])
    apart = 0.5 * np.abs(np.mean(second[::2], axis=0) - np.mean(second[1::2], axis=0))
    depth = 1.0 - quantile(part, 0.05)
    return bool(apart.max() > max(_COMB * depth, _CHANCE * noise / np.sqrt(len(second))))


def _smoothed_by_walls(outline: EdgeOutline, walls: WallLines) -> EdgeOutline:
    """Return the outline smoothed where it is close to a wall, and nowhere beyond one."""
    # the wall's line and what a filter made of it disturb the edge point by point: the curve would have loops
    clearance = walls.clearance(outline.points)
    if walls.is_clear(clearance).all():
        return outline
    smooth = np.where(walls.is_clear(clearance)[:, None], outline.points, rounded(outline.points, _WALL_SMOOTHING))
    beyond = np.minimum(walls.clearance(smooth), 0.0)
    upwards = np.sign((smooth - walls.middle) @ walls.across)
    return replace(outline, points=smooth + (beyond * upwards)[:, None] * walls.across)


def _ends_located(outline: EdgeOutline, walls: WallLines) -> bool:
    """Return whether the edge is not blurred beyond what was tried, and was located along most of either end."""
    facing = outline.normals @ walls.along
    ends = [outline.located[side * facing > _FACING] for side in (1.0, -1.0)]
    sharp = quantile(outline.edge_width, 0.75) < _WIDEST
    return sharp and all(len(end) > 0 and np.mean(end) > _FOUND for end in ends)


def smear(outline: EdgeOutline, walls: WallLines) -> float:
    """Return the way of the capsule during the exposure [px], by the edges that face along it and those beside."""
    # a motion by s adds s^2 / 12 to the square of the width of the edges at the ends, and nothing at the flanks
    facing = outline.normals @ walls.along
    width = np.square(outline.edge_width)
    clear = walls.clearance(outline.points) > _CLEAR_OF_WALL * walls.line_width
    flank = (np.abs(facing) < _BESIDE) & clear
    if not flank.any():
        return 0.0
    ends = [median(width[side * facing > _FACING]) for side in (1.0, -1.0)]
    return float(np.sqrt(12.0 * max(float(np.mean(ends)) - median(width[flank]), 0.0)))


def _asymmetry(outline: EdgeOutline, walls: WallLines) -> float:
    """Return how far the middle between the two flanks wanders, over the breadth."""
    along, across = outline.points @ walls.along, outline.points @ walls.across
    places = along.min() + np.ptp(along) * np.linspace(_ENDS, 1.0 - _ENDS, 9)
    below = across > 0.5 * (across.max() + across.min())
    flanks = []
    for side in (below, ~below):
        order = np.argsort(along[side])
        flanks.append(np.interp(places, along[side][order], across[side][order]))
    return float(0.5 * np.ptp(flanks[0] + flanks[1]) / np.ptp(across))


def _flow_of_shape(outline: EdgeOutline, walls: WallLines) -> int:
    """Return the direction of the flow: the rear is blunt, so that the centroid lies on its side of the middle."""
    along = outline.points @ walls.along
    lead = (0.5 * (along.max() + along.min()) - centroid(outline.points) @ walls.along) / np.ptp(along)
    return 0 if abs(lead) < _SYMMETRIC else int(np.sign(lead))


# Dirt on an edge is a bump on a smooth curve. The rims of a rear are bumps too, in pairs on either side of the axis

# of a bump: deviation and reach in points of an outline, least height in px and in standard errors, and distance from
# the axis [px] nearer to which it has no mirror image. Dirt is beyond both limits, and what is clean is not
_SPECK, _BROAD = (1.6, 10, 0.6, 4.5, 8.0), (6.4, 32, 1.5, 7.0, 27.0)
_FEW, _MANY = 200, 500  # points of an outline: ends of smaller ones are sharper, and larger ones show more of a tip
_NEAR_MIRROR = 15  # points about a mirror image
_OF_END, _OF_BREADTH = 2.0, 0.4  # px behind an end, and distance from the axis over the breadth, where bumps are sought


@lru_cache
def _weights_of_bump(deviation: float, reach: int) -> Floats:
    """Return the weights of the points around another that tell the height of a bump at it on a smooth curve."""
    away = np.arange(-reach, reach + 1)
    functions = np.column_stack([np.vander(away / reach, 5), np.exp(-0.5 * (away / deviation) ** 2)])
    return np.asarray(np.linalg.pinv(functions)[-1])


def _bears_dirt(detection: Detection) -> bool:
    """Return whether the edge at an end has a bump that its mirror image about the axis lacks."""
    walls, outline = detection.located()
    count, error = len(outline.points), np.hypot(outline.point_error, _END_MISFIT * outline.edge_width**2)
    z, y = np.stack([(detection.flow or 1) * walls.along, walls.across]) @ (outline.points - detection.axis).T
    mirror = KDTree(np.stack([z, y], axis=1)).query(np.stack([z, -y], axis=1))[1]
    nose, rear = (end & (np.abs(y) < _OF_BREADTH * np.ptp(y)) for end in (z > z.max() - _OF_END, z < z.min() + _OF_END))
    most = max(1.0 + detection.line, _FEW / count, count / _MANY)
    broad = detection.flow != 0 and count > _FEW  # a rear, or what is small, may be as bent as a broad bump
    for (deviation, reach, least, sure, near), end in (_SPECK, nose | rear), (_BROAD, nose & broad):
        weights = _weights_of_bump(deviation, reach)
        height = np.sum(correlate1d(outline.points, weights, axis=0, mode="wrap") * outline.normals, axis=1)
        limit = np.maximum(least * most, sure * np.linalg.norm(weights) * error)
        image = np.maximum(maximum_filter1d(height, _NEAR_MIRROR, mode="wrap")[mirror], 0.0) * (np.abs(y) > near)
        erased = maximum_filter1d(outline.erased, len(weights), mode="wrap")
        if np.any(end & ~erased & ~erased[mirror] & (height - image > limit)):
            return True
    return False


def _with_ends(light: Floats, noise: float, detection: Detection, unsure: float) -> Detection:
    """Add the ends and the rear, unsure by so many blurs; no concave rear is sought without a direction of the flow."""
    walls, outline = detection.located()
    downstream = (detection.flow or 1) * walls.along
    nose = furthest_point(outline, downstream, _NOSE_MISFIT)
    end = furthest_point(outline, -downstream, _END_MISFIT)
    if _bears_dirt(detection):
        return Detection(Status.DOUBLET, walls, outline, detection.flow, blob=detection.blob)
    detection = replace(detection, nose=nose, end=end)
    half_height, length = 0.5 * float(np.ptp(outline.points @ walls.across)), nose.distance + end.distance
    tips = [(downstream, nose), (-downstream, end)]
    for outwards, tip in tips if detection.flow == 0 else tips[:1]:
        if shows_second_nose(light, detection.axis + tip.distance * outwards, -outwards, length, half_height, noise):
            return Detection(Status.OVERLAP, walls, outline, detection.flow, blob=detection.blob)
    if detection.flow == 0:
        return detection
    start = detection.axis - end.distance * downstream
    flank = np.abs(outline.normals @ walls.across) > 0.8
    blur = median(outline.edge_width[flank] if flank.any() else outline.edge_width)
    rear = find_rear(light, start, downstream, length, half_height, blur, noise, unsure * blur)
    return replace(detection, rear=rear)
