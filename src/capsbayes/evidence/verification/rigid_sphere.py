"""Force-free rigid spheres on the axis."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from capsbayes.evidence.verification.references import RIGID_SPHERE
from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.simulation.problem import Problem
from capsbayes.physics.simulation.rigid import rigid_sphere
from capsbayes.physics.stokes.sections import section_named

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section"]

_SIZES = (0.3, 0.5, 0.7, 0.8, 0.85, 0.9)
_WORDS = {"velocity_ratio": "V/U", "extra_pressure_drop": "dP+ [mu U/l]"}


def section(refinement: int = 12) -> Section:
    """Velocity and pressure drop of spheres of every size in both sections."""
    return Section(
        "rigid-sphere",
        "Rigid sphere",
        f"A sphere free to move on the axis, at refinement {refinement}: its velocity, and the pressure drop it adds.",
        {_item(*case): partial(_motion, *case, refinement) for case in _cases()},
        _rows,
        _picture,
    )


def _cases() -> list[tuple[str, float]]:
    return [(name, size) for name in ("square", "circular") for size in _SIZES]


def _item(name: str, size_ratio: float) -> str:
    return f"{name}, a/l = {size_ratio:g}"


def _motion(name: str, size_ratio: float, refinement: int) -> Values:
    return rigid_sphere(Problem(NeoHookean(), section_named(name), refinement, 0.0), size_ratio)._asdict()


def _rows(results: Results) -> Iterator[Row]:
    for case in _cases():
        target = Target("relative", 1e-4 if case[1] < 0.9 else 3e-4)  # the references have a digit less there
        for quantity, words in _WORDS.items():
            ours = results.value(_item(*case), quantity)
            yield Row(f"{_item(*case)}: {words}", ours, RIGID_SPHERE.at(case, quantity), target)


def _picture(results: Results, figure: Figure) -> None:
    for axes, (quantity, words) in zip(figure.subplots(1, 2), _WORDS.items(), strict=True):
        for name in ("square", "circular"):
            (line,) = axes.plot(_SIZES, results.across((_item(name, size) for size in _SIZES), quantity), label=name)
            references = [RIGID_SPHERE.at((name, size), quantity).value for size in _SIZES]
            axes.plot(_SIZES, references, "o", color=line.get_color(), markerfacecolor="none")
        axes.set(xlabel="a/l", ylabel=words)
    axes.set_yscale("log")
    axes.legend(title="lines ours, circles the reference")
