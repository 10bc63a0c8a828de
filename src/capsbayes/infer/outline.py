"""Measured outlines: their normal distances from predicted ones, and their likelihood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.interpolate import RectBivariateSpline
from scipy.linalg.lapack import dtrtrs
from scipy.ndimage import binary_erosion

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import InputError
from capsbayes.footing import Footing, normal_distances, posed_on
from capsbayes.infer.checks import Gate
from capsbayes.measurement import MOST_ASKEW, MeasuredOutline, OutlineNoise, Pose, askew_size
from capsbayes.model import ForwardModel
from capsbayes.parameters import COORDINATES
from capsbayes.profile import arc_length, vertex_normals

# Capsules askew: what of a measured outline no symmetric shape of a model explains, and what it does to the rest.
#
# The shapes of a model are symmetric about the flow, and so is what an outline tells of them. The odd part of a
# measured outline is therefore known apart from them: by half its distance from its own mirror image. Where it is
# larger than its noise explains, it is a nuisance of the likelihood: displacements of the outline that are smooth along
# it, as those of a capsule off the axis are in simulations, with amplitudes that are normally distributed about zero.
# Their size is that of the odd part.
#
# What makes a capsule askew changes the even part as well, which is not known apart. An offset along the line of sight
# tilts the rim, of which a silhouette shows the side that is further back: in simulations the rear is seen further back
# by about the size of the odd part that is seen at a right angle. An offset across it changes the even part in second
# order, by a twentieth to a fifth of the odd part, and sharply at the rim: an error along arcs has that size

EVEN, EVEN_LENGTH = 0.2, 0.2
"""Error of the even part over the size of the odd one, and the length [l] along the outline over which it is alike."""

_WAVES = 4  # along an outline: capsules followed on their way to the axis are odd by less than a twentieth besides


def odd_directions(outline: Floats, place: Floats, normal: Floats) -> Floats:
    """Return how smooth odd displacements of an outline change the normal distances from it."""
    arc = arc_length(outline)
    phase = 2.0 * np.pi * np.interp(place, np.arange(len(arc)), arc / arc[-1])
    waves = np.arange(1, _WAVES + 1)
    size = 1.0 / (waves * np.sqrt(0.5 * np.sum(1.0 / waves**2)))
    along, across = (size * turn(waves * phase[:, None]) for turn in (np.sin, np.cos))
    return np.concatenate([normal[:, :1] * along, normal[:, 1:] * across], axis=1)


def rear_direction(outline: Floats, place: Floats, normal: Floats) -> Floats:
    """Return how the normal distances from an outline change if its rear is seen further back between the rims."""
    y = np.interp(place, np.arange(len(outline) + 1), np.append(outline[:, 1], outline[0, 1]))
    share = np.clip(1.0 - np.square(y / np.abs(outline[:, 1]).max()), 0.0, None)
    return np.maximum(-normal[:, 0], 0.0) * np.sqrt(share)


# Likelihood of a measured outline: normal distances with errors that are correlated along the arc.
#
# An edge that is found too far out at one place is found too far out next to it as well: taken as independent, the
# errors of neighbouring points would make the posterior far too narrow. Where on the picture the capsule is, how it is
# tilted and by how much all edges are found too far out is no property of its shape, nor is how far it is askew; these
# nuisances are integrated out, each with a Gaussian prior, as is the model's own error. All of it is one covariance
# matrix, computed at a pilot shape near the posterior and used for all others.
#
# A silhouette hides a concave rear. Where its depth was measured all the same, L_a is one more number next to the
# normal distances; it ends at the nose of the same picture, whose error it shares

_SHARED = 0.9  # largest share of the error of L_a that is the error of the nose: the rest is that of the rear
_PART = 2000  # predicted outlines at a time, at most


class SilhouetteLength(NamedTuple):
    """L_a measured together with a silhouette."""

    value: float  # [l]
    error: float
    own_error: float = 0.0  # of the model


@dataclass(frozen=True, eq=False)
class OutlineLikelihood:
    """Density of a measured outline given predicted ones."""

    points: Floats  # (m, 2) [l]: consecutive, columns (z, y), counter-clockwise; of any place and tilt
    noise: OutlineNoise
    pilot: Floats  # (p, 2) [l]: a predicted outline near the posterior
    pose: Pose = field(default_factory=Pose)
    modes: Floats | None = None  # (k, p) [l]: displacements along normals by the model's own error
    length: SilhouetteLength | None = None

    @cached_property
    def _stand(self) -> tuple[Floats, Footing]:
        """The measured points moved onto the pilot, and their nearest places on it."""
        return aligned_with(self.points, self.pilot)

    @cached_property
    def _factor(self) -> Floats:
        """Lower triangular factor of the covariance of the normal distances, and of L_a."""
        aligned, feet = self._stand
        covariance = self.noise.covariance(self.points)
        spread = self.pose.directions(aligned, feet.normal)
        covariance = covariance + spread @ spread.T
        covariance += self._of_rear_and_askew(feet)
        if self.modes is not None:
            own = _at_places(self.modes, feet.place)
            covariance += own.T @ own
        covariance[np.diag_indices_from(covariance)] += 1e-8 * self.noise.scale**2
        if self.length is not None:
            covariance = self._bordered(covariance, self.length, int(np.argmax(aligned[:, 0])))
        return np.asfortranarray(scipy.linalg.cholesky(covariance, lower=True))

    def _of_rear_and_askew(self, feet: Footing) -> Floats:
        """Return what a wide edge of the rear and a capsule askew add to the covariance (m, m)."""
        askew, rear = askew_size(self.points, self.noise), self.pose.rear
        if askew == rear == 0.0:
            return np.zeros((len(self.points), len(self.points)))
        odd = odd_directions(self.pilot, feet.place, feet.normal)
        back = rear_direction(self.pilot, feet.place, feet.normal)
        # where in a wide edge the membrane lies is alike all along it by one half, and along arcs by the other
        alike = OutlineNoise(1.0, self.noise.correlation_length).covariance(self.points)
        of_rear = askew**2 + 0.5 * rear**2 * (1.0 + alike)
        even = EVEN**2 * OutlineNoise(1.0, EVEN_LENGTH).covariance(self.points)
        return np.asarray(askew**2 * (odd @ odd.T + even) + of_rear * np.outer(back, back))

    def _bordered(self, covariance: Floats, length: SilhouetteLength, nose: int) -> Floats:
        """Return the covariance (m + 1, m + 1) with that of L_a, which shares the error of the nose."""
        own = OutlineNoise(self.noise.scale, self.noise.correlation_length)
        shared = (1.0 - self.noise.white) * own.covariance(self.points)[nose] + self.pose.offset**2
        shared *= min(1.0, _SHARED * length.error / np.sqrt(shared[nose])) if shared[nose] > 0.0 else 1.0
        variance = length.error**2 + length.own_error**2
        return np.block([[covariance, shared[:, None]], [shared, np.array(variance)]])

    def whitened(self, outlines: Floats, axial_lengths: Floats | None = None, *, posed: bool = False) -> Floats:
        """Return the differences from predictions as independent numbers, standard normal under a right model."""
        distances = normal_distances(self._stand[0], outlines, posed=posed)
        known = np.isfinite(distances[:, 0])
        if self.length is not None:
            assert axial_lengths is not None, "L_a was measured"
            distances = np.column_stack([distances, self.length.value - axial_lengths])
        white = np.full_like(distances, np.nan)
        white[known] = self._independent(distances[known])
        return white

    def _independent(self, numbers: Floats) -> Floats:
        """Return rows (n, m) of numbers with the covariance as independent ones of variance one."""
        found, _ = dtrtrs(self._factor, numbers.T, lower=True)  # without the checks around it, which take longer
        return np.asarray(found.T)

    def whitened_displacement(self, displacement: Floats) -> Floats:
        """Return the change of `whitened` if the measured outline lies farther out."""
        aligned, feet = self._stand
        at_points = _at_places(displacement, feet.place)
        if self.length is not None:
            at_points = np.column_stack([at_points, at_points[:, np.argmax(aligned[:, 0])]])
        return self._independent(at_points)

    def whitened_prediction(self, displacements: Floats) -> Floats:
        """Return what `whitened` loses if the vertices of the pilot are displaced by vectors (k, p, 2) [l]."""
        along = np.einsum("kpi,pi->kp", displacements, vertex_normals(self.pilot))
        at_points = _at_places(along, self._stand[1].place)
        if self.length is not None:
            at_points = np.column_stack([at_points, np.zeros(len(at_points))])
        return self._independent(at_points)

    def whitened_shared(self, outline: MeasuredOutline) -> Floats:
        """Return the changes of `whitened` by the errors that one microscope gives the outlines of all capsules."""
        aligned, feet = self._stand
        each = outline.shared(aligned, feet.normal)
        back = outline.pose.rear * rear_direction(self.pilot, feet.place, feet.normal)
        each = np.concatenate([each, back[None]])
        if self.length is not None:
            each = np.column_stack([each, each[:, np.argmax(aligned[:, 0])]])
        return self._independent(each)

    def whitened_length(self) -> Floats:
        """Return what `whitened` loses if L_a is predicted one half width longer : (m + 1,) array."""
        assert self.length is not None, "L_a was measured"
        return self._independent(np.eye(len(self._factor))[-1:])[0]

    def log_density(self, outlines: Floats, axial_lengths: Floats | None = None) -> Floats:
        """Return the log density given n outlines (n, p, 2), and L_a (n,) : (n,) array, NaN for a row of NaN."""
        square = np.sum(self.whitened(outlines, axial_lengths) ** 2, axis=1)
        constant = np.sum(np.log(np.diag(self._factor))) + 0.5 * len(self._factor) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * square - constant)

    def at(self, model: ForwardModel, theta: Mapping[str, Floats]) -> Floats:
        """Return the log density given the predictions of a model at n points : (n,) array, NaN outside its domain."""
        parts = (np.array_split(values, 1 + len(values) // _PART) for values in theta.values())
        found = []
        for part in zip(*parts, strict=True):  # an outline takes hundreds of times the memory of its density
            predicted = model(dict(zip(theta, part, strict=True)), outline=True)
            assert predicted.outline is not None, "asked for"
            found.append(self.log_density(predicted.outline, predicted.axial_length))
        return np.concatenate(found)


def check_view_of(model: ForwardModel, measured: MeasuredOutline, where: str = "measurement") -> None:
    """Refuse a model that predicts outlines of another view than the measured one."""
    if model.view != measured.view:
        expected = f'"{model.view}", that of the outlines of {model.name}'
        advice = f'open the model with view="{measured.view}"'
        raise InputError(where, "outline.view", expected, f'"{measured.view}"', advice)


def outline_likelihood(
    model: ForwardModel,
    measured: MeasuredOutline,
    theta: Mapping[str, float],
    error_scale: float = 1.0,
    *,
    length: tuple[float, float] | None = None,
    others: Sequence[Mapping[str, float]] = (),
) -> OutlineLikelihood:
    """Return the likelihood of a measured outline with the shape of a model as its pilot."""
    check_view_of(model, measured)
    there = model({name: np.array([value]) for name, value in theta.items()}, outline=True)
    assert there.outline is not None, "asked for"
    pilot, own = there.outline[0], [model.outline_modes(**place) for place in (theta, *others)]
    stated = [each for each in own if each is not None]
    modes = error_scale / np.sqrt(len(own)) * np.concatenate(stated) if stated else None
    with_length = None
    if length is not None:
        with_length = SilhouetteLength(*length, error_scale * float(np.sqrt(there.covariance[0, 1, 1])))
    return OutlineLikelihood(measured.points, measured.noise, pilot, measured.pose, modes, with_length)


def aligned_with(points: Floats, outline: Floats) -> tuple[Floats, Footing]:
    """Shift and turn measured points onto an outline by least squares."""
    return posed_on(points - _middle(points) + _middle(outline), outline)


def _middle(points: Floats) -> Floats:
    return 0.5 * (points.max(axis=0) + points.min(axis=0))


def _at_places(modes: Floats, place: Floats) -> Floats:
    """Interpolate values (k, p) at the vertices to places between them : (k, m) array."""
    count = modes.shape[1]
    before = np.floor(place).astype(int) % count
    share = place - np.floor(place)
    return np.asarray((1.0 - share) * modes[:, before] + share * modes[:, (before + 1) % count])


# Likelihood of an outline interpolated on a grid around its posterior, for the sampling engine

_AROUND = 2  # nodes that must be known on every side of a point


@dataclass(frozen=True, eq=False)
class TabulatedOutline:
    """Log density of a measured outline, bicubic away from the border of the domain, exact elsewhere."""

    exact: OutlineLikelihood
    log_ca: Floats  # (i,), evenly spaced
    size: Floats  # (j,)
    values: Floats  # (i, j): log density there, NaN outside the model's domain

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        known = np.isfinite(self.values)
        filled = np.where(known, self.values, np.min(self.values, where=known, initial=0.0))
        return RectBivariateSpline(self.log_ca, self.size, filled)

    @cached_property
    def _sure(self) -> Booleans:
        around = np.ones((2 * _AROUND + 1, 2 * _AROUND + 1), dtype=bool)
        return np.pad(binary_erosion(np.isfinite(self.values), around), 1)

    def at(self, model: ForwardModel, theta: Mapping[str, Floats]) -> Floats:
        """Return the log density at n points : (n,) array, NaN outside the domain of the model."""
        log_ca, size = np.log(theta["capillary_number"]), np.asarray(theta["size_ratio"])
        within = self._sure[_nearest_nodes(log_ca, self.log_ca), _nearest_nodes(size, self.size)]
        if within.all():
            return np.asarray(self._spline.ev(log_ca, size))
        density = np.empty(len(log_ca))
        density[within] = self._spline.ev(log_ca[within], size[within])
        density[~within] = self.exact.at(model, {name: np.asarray(values)[~within] for name, values in theta.items()})
        return density

    def error(self, model: ForwardModel, theta: Mapping[str, Floats]) -> float:
        """Return the largest difference from the exact log density at n points."""
        return float(np.nanmax(np.abs(self.at(model, theta) - self.exact.at(model, theta))))


def _nearest_nodes(places: Floats, nodes: Floats) -> Integers:
    """Return the number of the nearest of evenly spaced nodes, from 1; 0 or one too many beyond them."""
    steps = np.rint((places - (nodes[0] - (nodes[1] - nodes[0]))) / (nodes[1] - nodes[0]))
    return np.minimum(np.maximum(steps, 0.0), len(nodes) + 1.0).astype(np.int64)


AnyOutline = OutlineLikelihood | TabulatedOutline


# Outlines of a posterior: their band, and whether any fits the measured one within its stated errors

_LARGEST = 4.0  # per degree of freedom: errors twice as large as stated
_TRIED = 50  # draws
_FITTED = 5  # Ca and a/l; place and tilt


def drawn_outlines(
    model: ForwardModel, draws: Mapping[str, Floats], count: int
) -> tuple[dict[str, Floats], Floats | None]:
    """Return the parameters of evenly spaced draws and their outlines (count, p, 2) [l], if the model has them."""
    names = [name for name in ("capillary_number", "size_ratio", *COORDINATES) if name in draws]
    some = np.linspace(0, draws[names[0]].size - 1, count).astype(int)
    theta = {name: np.ravel(draws[name])[some] for name in names}
    return theta, model(theta, outline=True).outline


def outline_misfit(measured: MeasuredOutline, model: ForwardModel, draws: Mapping[str, Floats]) -> Gate:
    """Return the squared misfit of the best of some draws per degree of freedom: one if the errors are as stated."""
    theta, outlines = drawn_outlines(model, draws, _TRIED)
    assert outlines is not None, "asked for"
    off = [np.sum(aligned_with(measured.points, outline)[1].distance ** 2) for outline in outlines]
    best = int(np.nanargmin(off))
    likelihood = outline_likelihood(model, measured, {name: float(values[best]) for name, values in theta.items()})
    square = float(np.sum(likelihood.whitened(outlines[best : best + 1]) ** 2))
    freedom = max(len(measured.points) - _FITTED, 1)
    return Gate("squared misfit of the outline over its freedom", square / freedom, most=_LARGEST)


def lopsided(measured: MeasuredOutline) -> Gate | None:
    """Return the size of the odd part of an outline, which the model does not have; None where noise explains it."""
    size = askew_size(measured.points, measured.noise)
    return Gate("odd part of the outline over l", size, most=MOST_ASKEW) if size > 0.0 else None


def band(outlines: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean outline and the 2.5 % and 97.5 % quantiles of the distance from it along its normal."""
    middle = outlines.mean(axis=0)
    normal = vertex_normals(middle)
    distance = np.einsum("dpk,pk->dp", outlines - middle, normal)
    low, high = np.quantile(distance, [0.025, 0.975], axis=0)
    return middle, middle + low[:, None] * normal, middle + high[:, None] * normal
