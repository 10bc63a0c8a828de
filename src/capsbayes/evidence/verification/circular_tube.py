"""Capsules in a circular tube, and how little bending stiffness changes them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from capsbayes.evidence.verification.references import TUBE
from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.evidence.verification.states import QUANTITIES, SYMBOLS, numbers, steady
from capsbayes.physics.simulation.simulator import Simulator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section"]

Case: TypeAlias = tuple[float, float, float]

_USUAL = 2e-4
_BENDINGS = (1e-3, _USUAL, 1e-4, 5e-5)  # where the belly is compressed


def section(refinement: int = 8) -> Section:
    """Every case of the axisymmetric table; less and less bending where the membrane is compressed."""
    return Section(
        "circular-tube",
        "Circular tube",
        f"Neo-Hookean capsules at refinement {refinement} beside axisymmetric ones without bending. The belly of "
        "uninflated capsules is compressed from a/R = 0.9 on: there the axisymmetric shape, to which the simulator "
        "holds a capsule in a tube, is unstable to wrinkles about the axis, and the more so the smaller its bending "
        "stiffness B.",
        {
            _item(case, bending): partial(_state, case, bending, refinement)
            for case in TUBE.numbers
            for bending in _bendings(case)
        },
        _rows,
        _picture,
    )


def _item(case: Case, bending: float) -> str:
    inflated = f", alpha = {case[2]:g}" if case[2] else ""
    return f"Ca = {case[0]:g}, a/R = {case[1]:g}{inflated}, B = {bending:g}"


def _compressed(case: Case) -> bool:
    return case[1] >= 0.9 and case[2] == 0.0


def _bendings(case: Case) -> tuple[float, ...]:
    return _BENDINGS if _compressed(case) else (_USUAL,)


def _state(case: Case, bending: float, refinement: int) -> Values:
    simulator = Simulator(cross_section="circular", refinement=refinement, bending=bending, pre_inflation=case[2])
    return numbers(steady(simulator, case[0], case[1]))


def _bound(case: Case) -> float:
    if _compressed(case):
        return 0.005
    return 0.001 if case[2] else 0.003


def _rows(results: Results) -> Iterator[Row]:
    for case in TUBE.numbers:
        for bending in _bendings(case):
            item, bound = _item(case, bending), _bound(case)
            for quantity in QUANTITIES:
                target = Target("relative", min(bound, 0.002) if quantity == "velocity_ratio" else bound)
                ours = results.value(item, quantity)
                yield Row(f"{item}: {SYMBOLS[quantity]}", ours, TUBE.at(case, quantity), target)


def _picture(results: Results, figure: Figure) -> None:
    cases = [case for case in TUBE.numbers if _compressed(case)]
    for axes, case in zip(figure.subplots(1, len(cases)), cases, strict=True):
        items = [_item(case, bending) for bending in _BENDINGS]
        for quantity in QUANTITIES:
            difference = results.across(items, quantity) / TUBE.at(case, quantity).value - 1.0
            axes.plot(_BENDINGS, 100.0 * difference, "o-", label=f"${SYMBOLS[quantity]}$")
        axes.axhline(0.0, color="0.7", linewidth=0.8)
        axes.set(xlabel="$B / (G_s a^2)$", ylabel="difference [%]", xscale="log")
        axes.set_title("Ca = {:g}, a/R = {:g}".format(*case))
        axes.legend()
