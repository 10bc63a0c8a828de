"""Promises that a law, a model or an effect must keep, checked by one function for each kind."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import BrokenPromiseError, InputError
from capsbayes.measurement import VIEWS
from capsbayes.model import CIRCUMSTANCES, Domain, ForwardModel

if TYPE_CHECKING:
    from capsbayes.model import Effect
    from capsbayes.physics.membrane import MembraneLaw
    from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity

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
        One's own, or one of the library.

    Raises
    ------
    BrokenPromiseError
        With the first promise that does not hold, and where.

    Examples
    --------
    >>> from capsbayes.physics.membrane import NeoHookean
    >>> check_law(NeoHookean())
    """
    _keep(_LAW_PROMISES, law)


def check_effect(effect: Effect, model: ForwardModel) -> None:
    """Check that an effect keeps every promise of its kind.

    Parameters
    ----------
    effect : Effect
        One's own, or one of the library.
    model : ForwardModel
        Model to which the effect is added, for example ``Surrogate.open("square-neo-hookean")``.

    Raises
    ------
    BrokenPromiseError
        With the first promise that does not hold, and where.
    """
    _keep(_EFFECT_PROMISES, effect, model)


def check_model(model: ForwardModel) -> None:
    """Check that a forward model keeps every promise of its kind.

    Parameters
    ----------
    model : ForwardModel
        One's own, one of the library, or one made from these with effects and fixed parameters.

    Raises
    ------
    BrokenPromiseError
        With the first promise that does not hold, and where.

    Examples
    --------
    >>> from capsbayes import Surrogate
    >>> check_model(Surrogate.open("square-neo-hookean"))
    """
    _keep(_MODEL_PROMISES, model)


def _keep(promises: Mapping[str, Callable[..., str]], subject: object, *others: object) -> None:
    """Raise the first promise whose check describes a deviation or fails."""
    name = type(subject).__name__
    for promise, check in promises.items():
        try:
            deviation = check(subject, *others)
        except Exception as error:
            raise BrokenPromiseError(name, promise, f"{type(error).__name__}: {error}") from error
        if deviation:
            raise BrokenPromiseError(name, promise, deviation)


def _invariants(stretch: Floats) -> tuple[Floats, Floats]:
    l1, l2 = stretch[..., 0], stretch[..., 1]
    return l1**2 + l2**2 - 2.0, (l1 * l2) ** 2 - 1.0


def _difference(
    quantity: str, got: Floats, expected: Floats, tolerance: float = _TOLERANCE, *, at: Floats | None = None
) -> str:
    """Describe the worst difference, empty when all agree (NaN never does)."""
    got, expected = np.broadcast_arrays(np.asarray(got, dtype=float), np.asarray(expected, dtype=float))
    error = np.abs(got - expected) / np.maximum(1.0, np.abs(expected))
    if np.all(error <= tolerance):
        return ""
    worst = np.unravel_index(np.argmax(np.nan_to_num(error, nan=np.inf)), error.shape)
    place = "" if at is None else f" at l1, l2 = {at[worst[0]].tolist()}"
    return f"{quantity} = {got[worst]:.9g} where {expected[worst]:.9g} is expected{place}"


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
    return _first(*(_difference("a batch", many[1, 1], single[0], 1e-13) for many, single in pairs))


def _has_true_derivatives(law: MembraneLaw) -> str:
    i1, i2 = _invariants(_STRETCHES)
    _, w1, w2, w11, w12, w22 = law.derivatives(i1, i2)
    by_i1 = _differences(law.derivatives(i1 + _STEP, i2), law.derivatives(i1 - _STEP, i2))
    by_i2 = _differences(law.derivatives(i1, i2 + _STEP), law.derivatives(i1, i2 - _STEP))
    return _first(
        _difference("w1", w1, by_i1[0], at=_STRETCHES),
        _difference("w2", w2, by_i2[0], at=_STRETCHES),
        _difference("w11", w11, by_i1[1], at=_STRETCHES),
        _difference("w12", w12, by_i1[2], at=_STRETCHES),
        _difference("w12", w12, by_i2[1], at=_STRETCHES),
        _difference("w22", w22, by_i2[2], at=_STRETCHES),
    )


def _differences(up: tuple[Floats, ...], down: tuple[Floats, ...]) -> list[Floats]:
    return [(a - b) / (2.0 * _STEP) for a, b in zip(up, down, strict=True)]


def _has_true_tensions(law: MembraneLaw) -> str:
    tensions = law.principal_tensions(_STRETCHES)
    if tensions.shape != _STRETCHES.shape:
        return f"tensions of shape {tensions.shape} for stretches of shape {_STRETCHES.shape}"
    expected = []
    for direction, other in ((0, 1), (1, 0)):
        step = np.zeros(2)
        step[direction] = _STEP
        up, down = law.energy(*_invariants(_STRETCHES + step)), law.energy(*_invariants(_STRETCHES - step))
        expected.append((up - down) / (2 * _STEP) / _STRETCHES[:, other])
    return _first(
        _difference("tau_1", tensions[:, 0], expected[0], at=_STRETCHES),
        _difference("tau_2", tensions[:, 1], expected[1], at=_STRETCHES),
    )


def _is_at_rest(law: MembraneLaw) -> str:
    rest = np.zeros(1)
    return _first(
        _difference("the energy at rest", law.energy(rest, rest), rest, 1e-13),
        _difference("the tension at rest", law.principal_tensions(np.ones((1, 2))), np.zeros((1, 2)), 1e-13),
    )


def _is_isotropic(law: MembraneLaw) -> str:
    there, back = law.principal_tensions(_STRETCHES), law.principal_tensions(_STRETCHES[:, ::-1])
    equal = law.principal_tensions(np.array([[1.2, 1.2], [0.9, 0.9]]))
    return _first(
        _difference("a tension with the stretches exchanged", back[:, ::-1], there, 1e-12),
        _difference("tau_2 at l1 = l2", equal[:, 1], equal[:, 0], 1e-12),
    )


def _slope(law: MembraneLaw, strain: tuple[float, float]) -> Floats:
    """Return the derivative of tau_1 at rest along a direction of strain (e1, e2)."""
    step = 1e-4
    along = step * np.asarray(strain)
    up, down = law.principal_tensions(1.0 + along), law.principal_tensions(1.0 - along)
    return np.asarray((up[0] - down[0]) / (2.0 * step))


def _has_unit_shear_modulus(law: MembraneLaw) -> str:
    return _difference("G_s", _slope(law, (1.0, -1.0)) / 2.0, np.ones(()))


def _has_its_area_modulus(law: MembraneLaw) -> str:
    return _difference("K_s/G_s", _slope(law, (1.0, 1.0)) / 2.0, np.asarray(law.area_dilation_modulus))


_LAW_PROMISES: dict[str, Callable[[MembraneLaw], str]] = {
    "it has a name and a positive modulus, and can be pickled, compared and hashed": _is_one_law,
    "its derivatives are six finite arrays of the shape of the invariants, each point by itself": _is_pure,
    "its derivatives are those of its energy": _has_true_derivatives,
    "its tensions are tau_1 = (1/l2) dW/dl1 and tau_2 = (1/l1) dW/dl2": _has_true_tensions,
    "without strain it has neither energy nor tension": _is_at_rest,
    "it is isotropic": _is_isotropic,
    "its surface shear modulus at small strain is 1": _has_unit_shear_modulus,
    "its area dilation modulus at small strain is the one it states": _has_its_area_modulus,
}


_SI = {"half_width": 25e-6, "capsule_velocity": 5e-3, "mean_velocity": 4e-3, "viscosity": 0.8, "flow_rate": 1e-11}
_OUTLINE = 0.01  # l by which the outline may differ from the lengths, in addition to the stated error of the prediction


def _batch(effect: Effect, size: float, model: ForwardModel) -> dict[str, Floats]:
    """Return `_capsules` with one size of the effect."""
    capsules = _capsules(model)
    return capsules | {effect.parameter.name: np.full(len(capsules["size_ratio"]), size)}


def _capsules(model: ForwardModel) -> dict[str, Floats]:
    """Return five capsules of the model's domain and one outside, with every circumstance."""
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    ca, ratio = np.random.default_rng(0).uniform([ca_low, size_low], [ca_high, size_high], (400, 2)).T
    inner = np.flatnonzero(model.domain.contains(ca, ratio))[:5]
    shapes = {
        "capillary_number": np.append(ca[inner], 1e3 * ca_high),
        "size_ratio": np.append(ratio[inner], size_high),
    }
    return shapes | {name: np.full(len(inner) + 1, value) for name, value in _SI.items()}


def _table(prediction: Prediction) -> Floats:
    """Return all numbers of a prediction : (n, k) array."""
    count = len(prediction)
    outline = np.zeros((count, 0)) if prediction.outline is None else prediction.outline.reshape(count, -1)
    lengths = prediction.values, prediction.stretch_ratio[:, None], prediction.covariance.reshape(count, -1)
    return np.concatenate([*lengths, outline], axis=1)


def _with_and_without(
    effect: Effect, model: ForwardModel, size: float
) -> tuple[Prediction, Prediction, Booleans, Floats]:
    """Return the predictions with a size of an effect and without it, where both are inside, and the ratio of flows."""
    theta, extended = _batch(effect, size, model), model + effect
    without = {name: values for name, values in theta.items() if name != effect.parameter.name or name in model.names}
    there, here = extended(theta, outline=True), model(without, outline=True)
    return there, here, there.inside & here.inside, extended.relative_area(theta) / model.relative_area(without)


def _typical(effect: Effect) -> float:
    """Return a size within the prior that is not the null value."""
    sizes = np.asarray(effect.prior.ppf([0.75, 0.6, 0.9]))
    return float(next(size for size in sizes if size != effect.null_value))


def _is_one_effect(effect: Effect, model: ForwardModel) -> str:
    for name in ("name", "changes", "separated_by"):
        if not (isinstance(getattr(effect, name), str) and getattr(effect, name)):
            return f"{name} is {getattr(effect, name)!r}, not a text"
    unknown = [name for name in effect.circumstances if name not in CIRCUMSTANCES]
    if unknown:
        return f"circumstances are among {', '.join(CIRCUMSTANCES)}, got {', '.join(unknown)}"
    if not isinstance(effect.prior, Quantity):
        return f"prior is a {type(effect.prior).__name__}, not a Quantity, as Quantity.of makes from any other form"
    if not np.isfinite(effect.prior.logpdf(_typical(effect))):
        return f"the prior has no density at its own quantile {_typical(effect):g}"
    return "" if pickle.loads(pickle.dumps(effect)) == effect else "a copy made by pickle differs from it"


def _does_nothing_at_null(effect: Effect, model: ForwardModel) -> str:
    there, here, both, flows = _with_and_without(effect, model, effect.null_value)
    if not both.any():
        return "it has no answer for any of five capsules"
    return _difference("the prediction at the null value", _table(there)[both], _table(here)[both], 1e-9) or (
        _difference("the relative flow at the null value", flows, np.ones(()), 1e-9)
    )


def _does_something(effect: Effect, model: ForwardModel) -> str:
    size = f"at {effect.parameter.name} = {_typical(effect):g}"
    there, here, both, flows = _with_and_without(effect, model, _typical(effect))
    if not both.any():
        return f"{size} it has no answer for any of five capsules"
    same = np.allclose(_table(there)[both], _table(here)[both], rtol=0.0, atol=1e-9)
    return f"{size} nothing changes" if same and np.allclose(flows, 1.0, rtol=0.0, atol=1e-9) else ""


def _treats_each_by_itself(effect: Effect, model: ForwardModel) -> str:
    theta = _batch(effect, _typical(effect), model)
    kept = {name: values.copy() for name, values in theta.items()}
    extended = model + effect
    forth = _table(extended(theta, outline=True))
    back = _table(extended({name: values[::-1] for name, values in theta.items()}, outline=True))
    if any(not np.array_equal(kept[name], values) for name, values in theta.items()):
        return "it changes the arrays that it is given"
    return _difference("the batch in reverse order", np.nan_to_num(back[::-1]), np.nan_to_num(forth), 1e-12)


def _stays_outside(effect: Effect, model: ForwardModel) -> str:
    return _leaves_the_domain((model + effect)(_batch(effect, _typical(effect), model), outline=True))


def _leaves_the_domain(prediction: Prediction) -> str:
    """Describe a prediction unless its last point, and no other, is outside the domain."""
    if prediction.inside[-1] or not np.isnan(prediction.values[-1]).all():
        return "a point outside the domain of the model is not NaN with inside False"
    return _difference("a prediction inside", np.isfinite(_table(prediction)[prediction.inside]), np.ones(()))


def _moves_outline_and_lengths(effect: Effect, model: ForwardModel) -> str:
    there, here, both, _ = _with_and_without(effect, model, _typical(effect))
    if there.outline is None or here.outline is None:
        return "it loses the outline"
    longer = np.ptp(there.outline[both, :, 0], axis=1) - np.ptp(here.outline[both, :, 0], axis=1)
    expected = there.axial_extent[both] - here.axial_extent[both]
    unsure = np.sqrt(there.covariance[both, 0, 0])
    within = np.clip(longer, expected - unsure, expected + unsure)
    return _difference("the change of the outline's extent along the flow", longer, within, _OUTLINE)


_EFFECT_PROMISES: dict[str, Callable[[Effect, ForwardModel], str]] = {
    "it has a name, sentences, a prior and known circumstances, and can be pickled and compared": _is_one_effect,
    "at its null value it changes nothing": _does_nothing_at_null,
    "at a typical size it changes something": _does_something,
    "it treats each capsule of a batch by itself, and does not change its arguments": _treats_each_by_itself,
    "outside the domain of the model it has no answer, inside a finite one": _stays_outside,
    "it moves the outline as it moves the lengths": _moves_outline_and_lengths,
}


def _declares_what_it_is(model: ForwardModel) -> str:
    if not isinstance(model, ForwardModel):
        return "a class that does not derive from capsbayes.model.ForwardModel"
    for name in ("name", "sha256"):
        if not (isinstance(getattr(model, name, None), str) and getattr(model, name)):
            return f"{name} is {getattr(model, name, None)!r}, not a text"
    if not isinstance(getattr(model, "domain", None), Domain):
        return "a domain whose class does not derive from capsbayes.model.Domain"
    if model.view not in VIEWS:
        return f"view is {model.view!r}, not one of {', '.join(VIEWS)}"
    wrong = [name for name, ends in model.coordinates.items() if not ends.low <= ends.null_value <= ends.high]
    if wrong:
        return f"the null value of {', '.join(wrong)} is not within its range"
    unknown = [name for name in model.circumstances if name not in CIRCUMSTANCES]
    return f"circumstances are among {', '.join(CIRCUMSTANCES)}, got {', '.join(unknown)}" if unknown else ""


def _knows_its_names(model: ForwardModel) -> str:
    capsules = _capsules(model)
    count = len(capsules["size_ratio"])
    null = {name: np.full(count, ends.null_value) for name, ends in model.coordinates.items()}
    stated, meant = (np.nan_to_num(_table(model(capsules | more))) for more in (null, {}))
    differ = _difference("the prediction at the null values", stated, meant, 1e-12)
    if differ:
        return differ
    try:
        model(capsules | {"no_such_parameter": np.zeros(count)})
    except InputError:
        return ""
    return "that the unknown name no_such_parameter is ignored; call check_names"


def _predicts_a_batch(model: ForwardModel) -> str:
    capsules = _capsules(model)
    forth, back = model(capsules), model({name: values[::-1] for name, values in capsules.items()})
    tables = np.nan_to_num(_table(back)[::-1]), np.nan_to_num(_table(forth))
    return _leaves_the_domain(forth) or _difference("the batch in reverse order", tables[0], tables[1], 1e-12)


def _agrees_with_its_domain(model: ForwardModel) -> str:
    capsules = _capsules(model)
    inside = model.domain.contains(capsules["capillary_number"], capsules["size_ratio"])
    return _difference("inside", model(capsules).inside.astype(float), inside.astype(float))


def _states_errors_and_caveats(model: ForwardModel) -> str:
    capsules = {name: values[:-1] for name, values in _capsules(model).items()}
    prediction = model(capsules)
    if np.linalg.eigvalsh(prediction.covariance).min() < -1e-12:
        return "a covariance with a negative eigenvalue"
    modes = model.outline_modes(**{name: float(values[0]) for name, values in capsules.items()})
    outline = model(capsules, outline=True).outline
    if modes is not None and (outline is None or modes.ndim != 2 or modes.shape[1] != outline.shape[1]):
        return (
            f"outline modes of shape {modes.shape} for outlines of shape {None if outline is None else outline.shape}"
        )
    for kind, concerned in model.caveats(capsules).items():
        if np.shape(concerned) != (len(prediction),):
            return f"the caveat {kind!r} of shape {np.shape(concerned)} for {len(prediction)} points"
    return ""


_MODEL_PROMISES: dict[str, Callable[[ForwardModel], str]] = {
    "it is a ForwardModel that declares its name, fingerprint, domain, view, coordinates and circumstances": (
        _declares_what_it_is
    ),
    "it refuses names that it does not know, and a coordinate that is not given has its null value": _knows_its_names,
    "it treats each capsule by itself, without an answer outside its domain and with a finite one inside": (
        _predicts_a_batch
    ),
    "its domain is where it has an answer": _agrees_with_its_domain,
    "its covariances, outline modes and caveats have the shapes of its predictions": _states_errors_and_caveats,
}
