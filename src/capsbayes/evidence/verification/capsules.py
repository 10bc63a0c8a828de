"""Capsules in channels against published and independently computed shapes: that of the paper, and a circular tube."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TypeAlias

from matplotlib.figure import Figure

from capsbayes.evidence.verification.quantities import QUANTITIES, SYMBOLS, numbers, on_mesh, steady
from capsbayes.evidence.verification.references import BOUNDARY_INTEGRAL, PAPER, TUBE
from capsbayes.evidence.verification.topic import Results, Row, Target, Topic, Values
from capsbayes.physics.continuation import SLACK_LIMIT
from capsbayes.physics.simulator import Simulator

_PAPER_CASE, _PAPER_MESHES = (0.082, 0.96), (8, 12)
_PAPER_TARGETS = {"axial_extent": 0.005, "axial_length": 0.005, "velocity_ratio": 0.001}

TubeCase: TypeAlias = tuple[float, float, float]
"""Ca, a/R and pre-inflation."""

_USUAL = 2e-4
_BENDINGS = (1e-3, _USUAL, 1e-4, 5e-5)  # where the belly is compressed


def paper_capsule() -> Topic:
    """Return the topic of the capsule that the paper identified in an experiment, on two meshes."""
    return Topic(
        "paper-capsule",
        "The capsule of the paper",
        "Ca = {:g}, a/l = {:g}, neo-Hookean, square channel. The paper's numbers come from a picture.".format(
            *_PAPER_CASE
        ),
        {on_mesh(n): partial(_paper_state, n) for n in _PAPER_MESHES},
        _paper_rows,
    )


def _paper_state(refinement: int) -> Values:
    return numbers(steady(Simulator(refinement=refinement), *_PAPER_CASE))


def _paper_rows(results: Results) -> Iterator[Row]:
    for n in _PAPER_MESHES:
        for quantity in QUANTITIES:
            ours = results.value(on_mesh(n), quantity)
            words = f"{SYMBOLS[quantity]}, n = {n}"
            yield Row(words, ours, PAPER.at(_PAPER_CASE, quantity), Target("relative", 0.01))
            finest, same = BOUNDARY_INTEGRAL.at(16, quantity), BOUNDARY_INTEGRAL.at(8, quantity)
            finest = finest._replace(source=f"{finest.source}, n = 16")
            yield Row(words, ours, finest, Target("relative", _PAPER_TARGETS[quantity]))
            if n == 8:
                yield Row(words, ours, same._replace(source=f"{same.source}, n = 8"))
        yield Row(f"slack, n = {n}", results.value(on_mesh(n), "slack"), target=Target("at most", SLACK_LIMIT))


def circular_tube(refinement: int = 8) -> Topic:
    """Return the topic of the axisymmetric table, with less and less bending where the membrane is compressed."""
    return Topic(
        "circular-tube",
        "Circular tube",
        f"Neo-Hookean capsules at refinement {refinement} compared with axisymmetric ones without bending. The belly "
        "of uninflated capsules is compressed from a/R = 0.9 on: there the axisymmetric shape, to which the simulator "
        "holds a capsule in a tube, is unstable to wrinkles about the axis, and the more so the smaller its bending "
        "stiffness B.",
        {
            _tube_item(case, bending): partial(_tube_state, case, bending, refinement)
            for case in TUBE.numbers
            for bending in _bendings(case)
        },
        _tube_rows,
        _tube_picture,
    )


def _tube_item(case: TubeCase, bending: float) -> str:
    inflated = f", alpha = {case[2]:g}" if case[2] else ""
    return f"Ca = {case[0]:g}, a/R = {case[1]:g}{inflated}, B = {bending:g}"


def _compressed(case: TubeCase) -> bool:
    return case[1] >= 0.9 and case[2] == 0.0


def _bendings(case: TubeCase) -> tuple[float, ...]:
    return _BENDINGS if _compressed(case) else (_USUAL,)


def _tube_state(case: TubeCase, bending: float, refinement: int) -> Values:
    simulator = Simulator(cross_section="circular", refinement=refinement, bending=bending, pre_inflation=case[2])
    return numbers(steady(simulator, case[0], case[1]))


def _tube_bound(case: TubeCase) -> float:
    if _compressed(case):
        return 0.005
    return 0.001 if case[2] else 0.003


def _tube_rows(results: Results) -> Iterator[Row]:
    for case in TUBE.numbers:
        for bending in _bendings(case):
            item, bound = _tube_item(case, bending), _tube_bound(case)
            for quantity in QUANTITIES:
                target = Target("relative", min(bound, 0.002) if quantity == "velocity_ratio" else bound)
                ours = results.value(item, quantity)
                yield Row(f"{item}: {SYMBOLS[quantity]}", ours, TUBE.at(case, quantity), target)


def _tube_picture(results: Results, figure: Figure) -> None:
    cases = [case for case in TUBE.numbers if _compressed(case)]
    for axes, case in zip(figure.subplots(1, len(cases)), cases, strict=True):
        items = [_tube_item(case, bending) for bending in _BENDINGS]
        for quantity in QUANTITIES:
            difference = results.across(items, quantity) / TUBE.at(case, quantity).value - 1.0
            axes.plot(_BENDINGS, 100.0 * difference, "o-", label=f"${SYMBOLS[quantity]}$")
        axes.axhline(0.0, color="0.7", linewidth=0.8)
        axes.set(xlabel="$B / (G_s a^2)$", ylabel="difference [%]", xscale="log")
        axes.set_title("Ca = {:g}, a/R = {:g}".format(*case))
        axes.legend()
