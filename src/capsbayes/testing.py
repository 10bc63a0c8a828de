"""Promises that a newcomer's part must keep, checked by one function for each kind of part."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import BrokenPromiseError

if TYPE_CHECKING:
    from capsbayes.membrane import MembraneLaw

__all__ = ["check_law"]

Array = NDArray[np.float64]

# Unequal stretches: a law that recovers l1 and l2 from the invariants has a square root that ends at l1 = l2,
# where a difference of invariants taken to one side would leave its domain.
_STRETCHES = np.array([[1.05, 0.9], [0.85, 1.1], [1.3, 1.02], [1.15, 1.5], [0.92, 0.8], [1.6, 0.7]])
_STEP = 1e-5  # of the central differences, whose error is then about 1e-10 of a third derivative
_TOLERANCE = 1e-6  # relative to the larger of 1 and the quantity


def check_law(law: MembraneLaw) -> None:
    """Check that a membrane law keeps every promise of its kind.

    Parameters
    ----------
    law : MembraneLaw
        The law, one's own or the library's.

    Raises
    ------
    BrokenPromiseError
        Naming the first promise that does not hold, and where.

    Examples
    --------
    >>> from capsbayes.membrane import NeoHookean
    >>> check_law(NeoHookean())
    """
    for promise, deviation in _LAW_PROMISES.items():
        try:
            found = deviation(law)
        except BrokenPromiseError:
            raise
        except Exception as error:
            raise BrokenPromiseError(type(law).__name__, promise, f"{type(error).__name__}: {error}") from error
        if found:
            raise BrokenPromiseError(type(law).__name__, promise, found)


def _invariants(stretch: Array) -> tuple[Array, Array]:
    l1, l2 = stretch[..., 0], stretch[..., 1]
    return l1**2 + l2**2 - 2.0, (l1 * l2) ** 2 - 1.0


def _apart(what: str, got: Array, expected: Array, tolerance: float = _TOLERANCE, *, at: Array | None = None) -> str:
    """Sentence about the worst difference, empty when all agree (a NaN never does)."""
    got, expected = np.broadcast_arrays(np.asarray(got, dtype=float), np.asarray(expected, dtype=float))
    error = np.abs(got - expected) / np.maximum(1.0, np.abs(expected))
    if np.all(error <= tolerance):
        return ""
    worst = np.unravel_index(np.argmax(np.nan_to_num(error, nan=np.inf)), error.shape)
    place = "" if at is None else f" at l1, l2 = {at[worst[0]].tolist()}"
    return f"{what} = {got[worst]:.9g} where {expected[worst]:.9g} is due{place}"


def _first(*sentences: str) -> str:
    return next((sentence for sentence in sentences if sentence), "")


def _is_one_law(law: MembraneLaw) -> str:
    if not isinstance(law.name, str) or not law.name.strip():
        return f"name {law.name!r}"
    if not float(law.area_dilation_modulus) > 0.0:
        return f"area_dilation_modulus {law.area_dilation_modulus!r}"
    if pickle.loads(pickle.dumps(law)) != law:
        return "a copy made by pickle that is not equal to it"
    return "" if hash(law) == hash(pickle.loads(pickle.dumps(law))) else "two hashes for two equal laws"


def _is_pure(law: MembraneLaw) -> str:
    i1, i2 = _invariants(_STRETCHES.reshape(3, 2, 2))
    kept = i1.copy(), i2.copy()
    batch = law.derivatives(i1, i2)
    if len(batch) != 6:
        return f"{len(batch)} arrays"
    if not (np.array_equal(i1, kept[0]) and np.array_equal(i2, kept[1])):
        return "that it writes into its arguments"
    for name, values in zip(("w", "w1", "w2", "w11", "w12", "w22"), batch, strict=True):
        if np.shape(values) != i1.shape:
            return f"{name} of shape {np.shape(values)} for invariants of shape {i1.shape}"
        if not np.all(np.isfinite(values)):
            return f"{name} = {np.asarray(values).tolist()}"
    alone = law.derivatives(i1[1, 1:], i2[1, 1:])
    pairs = zip(batch, alone, strict=True)
    return _first(*(_apart("a batch", many[1, 1], one[0], 1e-13) for many, one in pairs))


def _has_true_derivatives(law: MembraneLaw) -> str:
    i1, i2 = _invariants(_STRETCHES)
    _, w1, w2, w11, w12, w22 = law.derivatives(i1, i2)
    by_i1 = _differences(law.derivatives(i1 + _STEP, i2), law.derivatives(i1 - _STEP, i2))
    by_i2 = _differences(law.derivatives(i1, i2 + _STEP), law.derivatives(i1, i2 - _STEP))
    return _first(
        _apart("w1", w1, by_i1[0], at=_STRETCHES),
        _apart("w2", w2, by_i2[0], at=_STRETCHES),
        _apart("w11", w11, by_i1[1], at=_STRETCHES),
        _apart("w12", w12, by_i1[2], at=_STRETCHES),
        _apart("w12", w12, by_i2[1], at=_STRETCHES),
        _apart("w22", w22, by_i2[2], at=_STRETCHES),
    )


def _differences(up: tuple[Array, ...], down: tuple[Array, ...]) -> list[Array]:
    return [(a - b) / (2.0 * _STEP) for a, b in zip(up, down, strict=True)]


def _has_true_tensions(law: MembraneLaw) -> str:
    tensions = law.principal_tensions(_STRETCHES)
    if tensions.shape != _STRETCHES.shape:
        return f"tensions of shape {tensions.shape} for stretches of shape {_STRETCHES.shape}"
    due = []
    for direction, other in ((0, 1), (1, 0)):
        step = np.zeros(2)
        step[direction] = _STEP
        up, down = law.energy(*_invariants(_STRETCHES + step)), law.energy(*_invariants(_STRETCHES - step))
        due.append((up - down) / (2 * _STEP) / _STRETCHES[:, other])
    return _first(
        _apart("tau_1", tensions[:, 0], due[0], at=_STRETCHES),
        _apart("tau_2", tensions[:, 1], due[1], at=_STRETCHES),
    )


def _is_at_rest(law: MembraneLaw) -> str:
    rest = np.zeros(1)
    return _first(
        _apart("the energy at rest", law.energy(rest, rest), rest, 1e-13),
        _apart("the tension at rest", law.principal_tensions(np.ones((1, 2))), np.zeros((1, 2)), 1e-13),
    )


def _is_isotropic(law: MembraneLaw) -> str:
    there, back = law.principal_tensions(_STRETCHES), law.principal_tensions(_STRETCHES[:, ::-1])
    equal = law.principal_tensions(np.array([[1.2, 1.2], [0.9, 0.9]]))
    return _first(
        _apart("a tension with the stretches exchanged", back[:, ::-1], there, 1e-12),
        _apart("tau_2 at l1 = l2", equal[:, 1], equal[:, 0], 1e-12),
    )


def _slope(law: MembraneLaw, strain: tuple[float, float]) -> Array:
    """Derivative of tau_1 at rest along a direction of strain (e1, e2)."""
    step = 1e-4
    along = step * np.asarray(strain)
    up, down = law.principal_tensions(1.0 + along), law.principal_tensions(1.0 - along)
    return np.asarray((up[0] - down[0]) / (2.0 * step))


def _has_unit_shear_modulus(law: MembraneLaw) -> str:
    return _apart("G_s", _slope(law, (1.0, -1.0)) / 2.0, np.ones(()))


def _has_its_area_modulus(law: MembraneLaw) -> str:
    return _apart("K_s/G_s", _slope(law, (1.0, 1.0)) / 2.0, np.asarray(law.area_dilation_modulus))


_LAW_PROMISES: dict[str, Callable[[MembraneLaw], str]] = {
    "it has a name and a positive modulus, and can be pickled, compared and hashed": _is_one_law,
    "its derivatives are six finite arrays of the shape of the invariants, each point for itself": _is_pure,
    "its derivatives are those of its energy": _has_true_derivatives,
    "its tensions are tau_1 = (1/l2) dW/dl1 and tau_2 = (1/l1) dW/dl2": _has_true_tensions,
    "without strain it has neither energy nor tension": _is_at_rest,
    "it does not know one direction from the other": _is_isotropic,
    "its surface shear modulus at small strain is 1": _has_unit_shear_modulus,
    "its area dilation modulus at small strain is the one it states": _has_its_area_modulus,
}
