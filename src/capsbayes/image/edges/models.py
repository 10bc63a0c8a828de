"""Models of an edge, a dark line and a dark band, fitted to profiles of intensity by least squares.

Two parameters of each model are wanted, place and width; the others enter linearly and are eliminated in each step
(variable projection with the Jacobian of Kaufman), which leaves a Gauss-Newton iteration in two unknowns.

References
----------
Kaufman 1975, BIT 15, 49 (doi 10.1007/BF01932995).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edges.small_equations import factorise, substitute

_ITERATIONS = 12
_TOLERANCE = 2e-3  # px
_NARROWEST, _WIDEST = 0.3, 12.0  # px
_LONGEST = 1.0, 0.4  # steps of the place [px] and of the logarithm of the width
_STRAIGHT = 1e-4  # 1/px: a smaller bend is none
_RIDGE = 1e-10  # two functions may become alike as the width grows


class Model(IntEnum):
    """Model of a profile; t is the distance from the place, and the blur is Gaussian with the width."""

    EDGE = 0
    """A jump between two straight lines, blurred: 1, the line outside, the jump, the line inside.

    The background and its halo outside, and the dark band inside, are smooth near the edge.
    """
    LINE = 1
    """A Gaussian between two levels: the Gaussian, 1, the step."""
    BAND = 2
    """A Gaussian on a parabola: the Gaussian, 1, t, t^2."""


_FUNCTIONS = {Model.EDGE: 4, Model.LINE: 3, Model.BAND: 4}


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """Model fitted to each of n profiles.

    Parameters
    ----------
    place, width : (n,) array
        In the unit of the samples' positions.
    place_variance : (n,) array
        Variance of the place where each sample has noise of variance 1.
    coefficients : (n, k) array
        Coefficients of the model's k functions.
    fitted : (n, m) array
        The model at the samples that are used, 0 at the others.
    slope : (n, m) array
        Its derivative with respect to the place.
    converged : (n,) array of bool
    """

    place: Floats
    width: Floats
    place_variance: Floats
    coefficients: Floats
    fitted: Floats
    slope: Floats
    converged: Booleans


def locate(
    profiles: Floats,
    samples: Floats,
    model: Model,
    place: Floats,
    width: Floats,
    used: Floats,
    bend: float = 0.0,
) -> ProfileFit:
    """Fit a model to each profile.

    Parameters
    ----------
    profiles : (n, m) array
        Intensities.
    samples : (m,) array
        Positions of the samples.
    model : Model
    place, width : (n,) array
        Initial guesses.
    used : (n, m) array
        1 for the samples to fit, 0 for the others.
    bend : float
        Of an edge: inverse of the depth at which the darkness inside falls to 1/e; 0 for a straight line, negative
        where it falls more steeply further inside.
    """
    count = len(profiles)
    fit = ProfileFit(
        place.astype(np.float64),
        width.astype(np.float64),
        np.empty(count),
        np.empty((count, _FUNCTIONS[model])),
        np.empty(profiles.shape),
        np.empty(profiles.shape),
        np.empty(count, dtype=np.bool_),
    )
    _locate(
        np.ascontiguousarray(profiles, dtype=np.float64),
        np.ascontiguousarray(samples, dtype=np.float64),
        np.ascontiguousarray(used, dtype=np.float64),
        int(model),
        float(bend),
        fit.place,
        fit.width,
        fit.place_variance,
        fit.coefficients,
        fit.fitted,
        fit.slope,
        fit.converged,
    )
    return fit


@njit(cache=True, nogil=True, error_model="numpy")
def _locate(  # type: ignore[no-untyped-def]
    profiles, samples, used, model, bend, place, width, variance, coefficients, fitted, slope, converged
):
    m, k = len(samples), coefficients.shape[1]
    functions, by_place, by_width = np.empty((m, k)), np.empty((m, k)), np.empty((m, k))
    jacobian, step, normal = np.empty((m, 2)), np.empty(2), np.empty((2, 2))
    for n in range(len(profiles)):
        converged[n] = False
        for iteration in range(_ITERATIONS + 1):
            _evaluated(model, bend, samples, used[n], place[n], width[n], functions, by_place, by_width)
            _projected(
                profiles[n], used[n], functions, by_place, by_width, coefficients[n], fitted[n], slope[n], jacobian
            )
            _step(profiles[n], used[n], fitted[n], jacobian, normal, step)
            if converged[n] or iteration == _ITERATIONS:  # fit, slope and normal matrix belong to the last place
                break
            place[n] += min(max(step[0], -_LONGEST[0]), _LONGEST[0])
            width[n] *= math.exp(min(max(step[1], -_LONGEST[1]), _LONGEST[1]))
            width[n] = min(max(width[n], _NARROWEST), _WIDEST)
            converged[n] = abs(step[0]) <= _TOLERANCE
        variance[n] = normal[1, 1] / (normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluated(  # type: ignore[no-untyped-def]
    model, bend, samples, used, place, width, functions, by_place, by_width
):
    """Fill in the functions (m, k) and their derivatives with respect to the place and the logarithm of the width."""
    for i in range(len(samples)):
        if used[i] == 0.0:
            functions[i], by_place[i], by_width[i] = 0.0, 0.0, 0.0
            continue
        t = samples[i] - place
        u = t / width
        bell = math.exp(-0.5 * u * u)
        f, p, w = functions[i], by_place[i], by_width[i]
        if model == 0:
            density, above = bell / math.sqrt(2.0 * math.pi), 0.5 * math.erfc(-u / math.sqrt(2.0))
            ramp = width * (u * above + density)
            f[0], f[1], f[2], f[3] = 1.0, t - ramp, above, ramp
            p[0], p[1], p[2], p[3] = 0.0, above - 1.0, -density / width, -above
            w[0], w[1], w[2], w[3] = 0.0, -width * density, -u * density, width * density
            if abs(bend) > _STRAIGHT:  # (jump - blurred exponential) / bend, whose limit for no bend is the ramp
                blurred = bend * width
                fall = math.exp(0.5 * blurred * blurred - bend * t) * 0.5 * math.erfc((blurred - u) / math.sqrt(2.0))
                f[3] = (above - fall) / bend
                p[3] = -fall
                w[3] = width * density - blurred * width * fall
        elif model == 1:
            density, above = bell / math.sqrt(2.0 * math.pi), 0.5 * math.erfc(-u / math.sqrt(2.0))
            f[0], f[1], f[2] = bell, 1.0, above
            p[0], p[1], p[2] = u * bell / width, 0.0, -density / width
            w[0], w[1], w[2] = u * u * bell, 0.0, -u * density
        else:
            f[0], f[1], f[2], f[3] = bell, 1.0, t, t * t
            p[0], p[1], p[2], p[3] = u * bell / width, 0.0, -1.0, -2.0 * t
            w[0], w[1], w[2], w[3] = u * u * bell, 0.0, 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _projected(  # type: ignore[no-untyped-def]
    profile, used, functions, by_place, by_width, coefficients, fitted, slope, jacobian
):
    """Fill in the best coefficients, the fit, its slope, and the Jacobian (m, 2) with the coefficients eliminated."""
    m, k = functions.shape
    matrix, sides = np.zeros((k, k)), np.zeros((k, 3))  # of the profile, and of the derivatives by place and width
    for i in range(m):
        if used[i] != 0.0:
            for a in range(k):
                sides[a, 0] += functions[i, a] * profile[i]
                for b in range(a + 1):
                    matrix[a, b] += functions[i, a] * functions[i, b]
    for a in range(k):
        matrix[a, a] = matrix[a, a] * (1.0 + 1e-12) + _RIDGE
        for b in range(a):
            matrix[b, a] = matrix[a, b]
    factorise(matrix)
    substitute(matrix, sides[:, 0])
    for a in range(k):  # numba takes seconds to compile an assignment of arrays
        coefficients[a] = sides[a, 0]
    for i in range(m):
        total, along_place, along_width = 0.0, 0.0, 0.0
        for a in range(k):
            total += coefficients[a] * functions[i, a]
            along_place += coefficients[a] * by_place[i, a]
            along_width += coefficients[a] * by_width[i, a]
        fitted[i], slope[i] = total, along_place
        jacobian[i, 0], jacobian[i, 1] = along_place * used[i], along_width * used[i]
        for a in range(k):
            sides[a, 1] += jacobian[i, 0] * functions[i, a]
            sides[a, 2] += jacobian[i, 1] * functions[i, a]
    substitute(matrix, sides[:, 1])
    substitute(matrix, sides[:, 2])
    for i in range(m):
        if used[i] != 0.0:
            for a in range(k):
                jacobian[i, 0] -= functions[i, a] * sides[a, 1]
                jacobian[i, 1] -= functions[i, a] * sides[a, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _step(profile, used, fitted, jacobian, normal, step):  # type: ignore[no-untyped-def]
    """Fill in the normal matrix (2, 2) and the Gauss-Newton step (2,)."""
    normal[:], step[:] = 0.0, 0.0
    for i in range(len(profile)):
        left = used[i] * (profile[i] - fitted[i])
        for a in range(2):
            step[a] += jacobian[i, a] * left
            for b in range(2):
                normal[a, b] += jacobian[i, a] * jacobian[i, b]
    for a in range(2):
        normal[a, a] = normal[a, a] * (1.0 + 1e-6) + 1e-12
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[1, 0]
    by_place = (normal[1, 1] * step[0] - normal[0, 1] * step[1]) / determinant
    step[1] = (normal[0, 0] * step[1] - normal[1, 0] * step[0]) / determinant
    step[0] = by_place
