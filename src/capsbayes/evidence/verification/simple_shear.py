"""A capsule in simple shear without walls: Taylor's deformation."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from capsbayes.evidence.verification.references import SHEAR, SHEAR_SLOPE
from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.simulation.problem import Problem
from capsbayes.physics.simulation.taylor import taylor_deformation
from capsbayes.physics.simulation.transient import transient
from capsbayes.physics.stokes.shear import ShearFlow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section"]

_SMALL, _TIME = 0.01, 8.0
_BENDING, _CODES_DIFFER = 2e-4, 0.08
_CAPILLARY_NUMBERS = tuple(SHEAR[0].numbers)


def section(refinement: int = 6) -> Section:
    """Steady deformations, and the slope at small ones."""
    times = {_SMALL: 0.5} | dict.fromkeys(_CAPILLARY_NUMBERS, _TIME)  # a stiff membrane settles within a few Ca
    return Section(
        "simple-shear",
        "Simple shear",
        f"Taylor's D of a neo-Hookean capsule sheared from rest without walls, Ca = mu (shear rate) a / G_s, at "
        f"refinement {refinement}, with a bending stiffness of {_BENDING:g}, at time {_TIME:g}. Published codes "
        f"differ by as much as {100 * _CODES_DIFFER:g} %.",
        {_item(ca): partial(_deformation, ca, time, refinement) for ca, time in times.items()},
        _rows,
        _picture,
    )


def _item(capillary_number: float) -> str:
    return f"Ca = {capillary_number:g}"


def _deformation(capillary_number: float, time: float, refinement: int) -> Values:
    problem = Problem(NeoHookean(), ShearFlow(), refinement, _BENDING)
    start = problem.at_rest(capillary_number, 1.0)
    (end,) = transient(problem, start, [time], steady=0.0)  # the membrane goes on turning
    return {"deformation": taylor_deformation(problem.mesh, problem.mesh.expanded(end.iterate.free))}


def _rows(results: Results) -> Iterator[Row]:
    slope = results.value(_item(_SMALL), "deformation") / _SMALL
    yield Row(f"D / Ca at Ca = {_SMALL:g}", slope, SHEAR_SLOPE, Target("relative", 0.01))
    for ca in _CAPILLARY_NUMBERS:
        ours = results.value(_item(ca), "deformation")
        for published in SHEAR:
            yield Row(f"D, {_item(ca)}", ours, published.at(ca, "deformation"), Target("relative", _CODES_DIFFER))


def _picture(results: Results, figure: Figure) -> None:
    axes = figure.subplots()
    axes.plot(_CAPILLARY_NUMBERS, results.across(map(_item, _CAPILLARY_NUMBERS), "deformation"), "-", label="ours")
    for published, marker in zip(SHEAR, "os", strict=True):
        numbers = [published.at(ca, "deformation").value for ca in _CAPILLARY_NUMBERS]
        axes.plot(_CAPILLARY_NUMBERS, numbers, marker, markerfacecolor="none", label=published.source)
    axes.plot([0.0, 0.2], [0.0, 0.2 * SHEAR_SLOPE.value], ":", color="0.5", label="small deformations")
    axes.set(xlabel="Ca", ylabel="D", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend()
