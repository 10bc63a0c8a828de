"""The simulators of an effect database: one for each value of a parameter of the simulator or of its membrane law."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from typing import Any

from capsbayes.errors import InputError

_FEWEST_VALUES = 3  # if one is held out, two still define a slope


def null_value(simulator: Any, effect: str) -> float:
    """Return the simulator's own value of a parameter, the null value of the effect.

    Raises
    ------
    InputError
        If there is no such parameter.
    """
    known = _parameters(simulator) | _parameters(getattr(simulator, "law", None))
    if effect not in known:
        raise InputError("build", "effect", f"one of {', '.join(known)}", repr(effect))
    return known[effect]


def simulators_at(simulator: Any, effect: str, values: Iterable[float]) -> dict[float, Any]:
    """Return the simulator at each value of a parameter, in rising order.

    Raises
    ------
    InputError
        If there is no such parameter, or the values are too few or lack the null value.
    """
    null, ordered = null_value(simulator, effect), sorted({float(value) for value in values})
    if len(ordered) < _FEWEST_VALUES or null not in ordered:
        expected = f"at least {_FEWEST_VALUES} values of {effect}, the simulator's own {null:g} among them"
        raise InputError("build", "values", expected, ", ".join(f"{value:g}" for value in ordered) or "none")
    if effect in _parameters(simulator):
        return {value: replace(simulator, **{effect: value}) for value in ordered}
    return {value: replace(simulator, law=replace(simulator.law, **{effect: value})) for value in ordered}


def _parameters(owner: Any) -> dict[str, float]:
    """Return the fields of a dataclass that are numbers, but not whole ones."""
    values = {field.name: getattr(owner, field.name) for field in fields(owner)} if is_dataclass(owner) else {}
    return {name: value for name, value in values.items() if isinstance(value, float)}
