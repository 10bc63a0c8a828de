"""Likelihood of a measured outline: normal distances with errors that are correlated along the arc.

An edge that is found too far out at one place is found too far out next to it
as well: taken as independent, the errors of neighbouring points would make the
posterior far too narrow. Where on the picture the capsule is, how it is tilted
and by how much all edges are found too far out is no property of its shape, nor is
how far it is askew; these nuisances are integrated out, each with a Gaussian prior, as is the
model's own error. All of it is one covariance matrix, computed at a pilot shape
near the posterior and used for all others.

A silhouette hides a concave rear. Where its depth was measured all the same, L_a is
one more number next to the normal distances; it ends at the nose of the same
picture, whose error it shares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dtrtrs

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer.outline.askew import EVEN, EVEN_LENGTH, askew_size, odd_directions, rear_direction
from capsbayes.infer.outline.normal_distance import Footing, normal_distances, posed_on
from capsbayes.measured_outline import MeasuredOutline, OutlineNoise, Pose
from capsbayes.model import ForwardModel
from capsbayes.profile import vertex_normals

_SHARED = 0.9  # largest share of the error of L_a that is the error of the nose: the rest is that of the rear


class SilhouetteLength(NamedTuple):
    """L_a measured together with a silhouette.

    Parameters
    ----------
    value, error : float [l]
        L_a and its standard error.
    own_error : float [l]
        That of the model.
    """

    value: float
    error: float
    own_error: float = 0.0


@dataclass(frozen=True, eq=False)
class OutlineLikelihood:
    """Density of a measured outline given predicted ones.

    Parameters
    ----------
    points : (m, 2) array [l]
        The measured outline, closed, consecutive vertices from anywhere, columns (z, y), counter-clockwise as in a
        `Profile`; any place and tilt.
    noise : OutlineNoise
    pilot : (p, 2) array [l]
        A predicted outline near the posterior.
    pose : Pose
    modes : (k, p) array [l], optional
        Displacements of the pilot's vertices along their normals, each one standard deviation of the model's own error.
    length : SilhouetteLength, optional

    Examples
    --------
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    >>> circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    >>> seen = OutlineLikelihood(0.9 * circle + [0.3, 0.1], OutlineNoise(0.01, 0.2), pilot=0.9 * circle)
    >>> int(np.argmax(seen.log_density(np.linspace(0.85, 0.95, 11)[:, None, None] * circle)))
    5
    """

    points: Floats
    noise: OutlineNoise
    pilot: Floats
    pose: Pose = field(default_factory=Pose)
    modes: Floats | None = None
    length: SilhouetteLength | None = None
    _aligned: Floats = field(init=False, repr=False)
    _feet: Footing = field(init=False, repr=False)
    _factor: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        aligned, feet = aligned_with(self.points, self.pilot)
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
        object.__setattr__(self, "_aligned", aligned)
        object.__setattr__(self, "_feet", feet)
        object.__setattr__(self, "_factor", np.asfortranarray(scipy.linalg.cholesky(covariance, lower=True)))

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
        """Return the differences from predictions as independent numbers, standard normal under a right model.

        Parameters
        ----------
        outlines : (n, p, 2) array [l]
            Predicted; a row of NaN gives NaN.
        axial_lengths : (n,) array, optional [l]
            L_a as predicted, read if L_a was measured too.
        posed : bool
            Shift and turn the measured outline onto each prediction: for those far from the pilot.

        Returns
        -------
        (n, m) array, or (n, m + 1) with L_a
        """
        distances = normal_distances(self._aligned, outlines, posed=posed)
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
        """Return the change of `whitened` if the measured outline lies farther out.

        Parameters
        ----------
        displacement : (k, p) array [l]
            Along the normals of the pilot's vertices.

        Returns
        -------
        (k, m) array, or (k, m + 1) with L_a, which ends at the displaced nose
        """
        at_points = _at_places(displacement, self._feet.place)
        if self.length is not None:
            at_points = np.column_stack([at_points, at_points[:, np.argmax(self._aligned[:, 0])]])
        return self._independent(at_points)

    def whitened_prediction(self, displacements: Floats) -> Floats:
        """Return what `whitened` loses if the vertices of the pilot are displaced by vectors (k, p, 2) [l].

        Returns
        -------
        (k, m) array, or (k, m + 1) with L_a, which is predicted apart
        """
        along = np.einsum("kpi,pi->kp", displacements, vertex_normals(self.pilot))
        at_points = _at_places(along, self._feet.place)
        if self.length is not None:
            at_points = np.column_stack([at_points, np.zeros(len(at_points))])
        return self._independent(at_points)

    def whitened_shared(self, outline: MeasuredOutline) -> Floats:
        """Return the changes of `whitened` by the errors that one microscope gives the outlines of all capsules.

        Parameters
        ----------
        outline : MeasuredOutline
            As it was measured, with the errors of one capsule; see `MeasuredOutline.shared`.

        Returns
        -------
        (k, m) array, or (k, m + 1) with L_a
        """
        feet = self._feet
        each = outline.shared(self._aligned, feet.normal)
        back = outline.pose.rear * rear_direction(self.pilot, feet.place, feet.normal)
        each = np.concatenate([each, back[None]])
        if self.length is not None:
            each = np.column_stack([each, each[:, np.argmax(self._aligned[:, 0])]])
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
        predicted = model(theta, outline=True)
        assert predicted.outline is not None, "asked for"
        return self.log_density(predicted.outline, predicted.axial_length)


def check_view_of(model: ForwardModel, measured: MeasuredOutline, where: str = "measurement") -> None:
    """Refuse a model that predicts outlines of another view than the measured one.

    Raises
    ------
    InputError
    """
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
    """Return the likelihood of a measured outline with the shape of a model as its pilot.

    Parameters
    ----------
    model : ForwardModel
    measured : MeasuredOutline
    theta : mapping of str to float
        Where the pilot is, within the model's domain.
    error_scale : float
        Factor on the model's own error.
    length : tuple of two float, optional [l]
        L_a and its standard error, where they count in addition to the outline.
    others : sequence of mappings
        Further places, over which and the pilot the covariance of the model's own error is averaged.

    Raises
    ------
    InputError
        If the model predicts outlines of another view.
    """
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
    """Shift and turn measured points onto an outline by least squares.

    Parameters
    ----------
    points : (m, 2) array
    outline : (p, 2) array

    Returns
    -------
    (m, 2) array, Footing
        The points moved, and their nearest places on the outline.
    """
    return posed_on(points - _middle(points) + _middle(outline), outline)


def _middle(points: Floats) -> Floats:
    return 0.5 * (points.max(axis=0) + points.min(axis=0))


def _at_places(modes: Floats, place: Floats) -> Floats:
    """Interpolate values (k, p) at the vertices to places between them : (k, m) array."""
    count = modes.shape[1]
    before = np.floor(place).astype(int) % count
    share = place - np.floor(place)
    return np.asarray((1.0 - share) * modes[:, before] + share * modes[:, (before + 1) % count])
