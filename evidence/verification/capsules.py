"""Capsules against published and independently computed shapes, and time steps against Newton's method."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, TypeAlias

import numpy as np
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.physics.channel import Flow, unidirectional
from capsbayes.physics.continuation import SLACK_LIMIT
from capsbayes.physics.load import profile
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.steady import Problem
from capsbayes.physics.surface import C2H, OctaSphere, Symmetry, dunavant, p2, p2_gradient
from capsbayes.physics.transient import STEADY, Scheme, transient
from evidence.verification.quantities import QUANTITIES, SYMBOLS, numbers, on_mesh, steady
from evidence.verification.references import BOUNDARY_INTEGRAL, PAPER, SHEAR, SHEAR_SLOPE, TUBE
from evidence.verification.topic import Reference, Results, Row, Target, Topic, Values

_PAPER_CASE, _PAPER_MESHES = (0.082, 0.96), (8, 12)
_PAPER_TARGETS = {"axial_extent": 0.005, "axial_length": 0.005, "velocity_ratio": 0.001}

TubeCase: TypeAlias = tuple[float, float, float]
"""Ca, a/R and pre-inflation."""

_TUBE_MESH, _COARSE = 8, 6  # refinement in the tube; of transients and in shear
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


def circular_tube() -> Topic:
    """Return the topic of the axisymmetric table, with less and less bending where the membrane is compressed."""
    return Topic(
        "circular-tube",
        "Circular tube",
        f"Neo-Hookean capsules at refinement {_TUBE_MESH} compared with axisymmetric ones without bending. The belly "
        "of uninflated capsules is compressed from a/R = 0.9 on: there the axisymmetric shape, to which the simulator "
        "holds a capsule in a tube, is unstable to wrinkles about the axis, and the more so the smaller its bending "
        "stiffness B.",
        {
            _tube_item(case, bending): partial(_tube_state, case, bending)
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


def _tube_state(case: TubeCase, bending: float) -> Values:
    simulator = Simulator(cross_section="circular", refinement=_TUBE_MESH, bending=bending, pre_inflation=case[2])
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


# A capsule from rest to its steady state by time steps, compared with Newton's method

_TRANSIENT, _NEXT_TO_IT = (0.12, 0.9), (0.11, 0.9)
_SETTLED = 2.4  # U t/l by which the paper finds the capsule steady
_TIMES = (*np.linspace(0.2, _SETTLED, 12).round(1).tolist(), 50.0)
_NEWTON, _IMPLICIT, _EXPLICIT = "Newton's method", "semi-implicit steps", "explicit steps"


def transients() -> Topic:
    """Return the topic of Newton's method and both schemes on one mesh."""
    return Topic(
        "transients",
        "Transients",
        "Neo-Hookean capsule at Ca = {:g}, a/l = {:g} in the square channel, from rest, at refinement {}. The "
        "semi-implicit steps end when no node moves faster than {:g} U relative to the centroid, the explicit ones "
        "at ten times that; Newton's method starts from the steady state at Ca = {:g}.".format(
            *_TRANSIENT, _COARSE, STEADY, _NEXT_TO_IT[0]
        ),
        {
            _NEWTON: _newton,
            _IMPLICIT: partial(_followed, "semi-implicit", STEADY),
            _EXPLICIT: partial(_followed, "explicit", 10.0 * STEADY),
        },
        _transient_rows,
        _transient_picture,
    )


def _newton() -> Values:
    simulator = Simulator(refinement=_COARSE)
    neighbour = steady(simulator, *_NEXT_TO_IT)
    begin = time.process_time()
    state = steady(simulator, *_TRANSIENT, neighbour)
    return numbers(state) | {"seconds": time.process_time() - begin}


def _followed(scheme: Scheme, speed: float) -> Values:
    """Return series over the times."""
    problem = Simulator(refinement=_COARSE).problem
    begin = time.process_time()
    times, found = [], []
    for instant in transient(problem, problem.at_rest(*_TRANSIENT), _TIMES, scheme=scheme, steady=speed):
        outline = profile(problem.mesh, problem.mesh.expanded(instant.iterate.free))
        times.append(instant.time)
        found.append([outline.axial_extent, outline.axial_length, instant.iterate.velocity])
    seconds = time.process_time() - begin
    series: dict[str, float | list[float]] = dict(zip(QUANTITIES, np.array(found).T.tolist(), strict=True))
    return series | {"seconds": seconds, "times": times}


def _transient_rows(results: Results) -> Iterator[Row]:
    for scheme, bound in ((_IMPLICIT, 5e-4), (_EXPLICIT, 2e-3)):
        for quantity in QUANTITIES:
            end = Reference(results.value(_NEWTON, quantity), _NEWTON)
            words = f"{scheme}: {SYMBOLS[quantity]} at the end"
            yield Row(words, results.value(scheme, quantity), end, Target("relative", bound))
    for when in (0.2, 0.6, _SETTLED):
        for quantity in QUANTITIES:
            reference = Reference(_at(results, _EXPLICIT, quantity, when), _EXPLICIT)
            words = f"{_IMPLICIT}: {SYMBOLS[quantity]} at U t/l = {when:g}"
            yield Row(words, _at(results, _IMPLICIT, quantity, when), reference, Target("relative", 2e-3))
    for quantity, when, bound in (("velocity_ratio", 1.6, 1e-3), ("axial_extent", _SETTLED, 1e-2)):
        after = results.series(_IMPLICIT, "times") >= when - 1e-9
        difference = np.abs(results.series(_IMPLICIT, quantity) / results.value(_NEWTON, quantity) - 1.0)
        largest = float(np.max(difference[after])) if np.any(after) else np.nan
        words = f"{SYMBOLS[quantity]}: largest relative difference from {_NEWTON} after U t/l = {when:g}"
        yield Row(words, largest, target=Target("at most", bound))
    seconds = {item: results.value(item, "seconds") for item in (_NEWTON, _IMPLICIT, _EXPLICIT)}
    for item, duration in seconds.items():
        yield Row(f"{item}: seconds", duration)
    for item in (_IMPLICIT, _EXPLICIT):
        yield Row(f"{item}: times as long as {_NEWTON}", seconds[item] / seconds[_NEWTON])


def _at(results: Results, item: str, quantity: str, when: float) -> float:
    """Return a quantity at one of the times, NaN where it was not reached."""
    at = np.isclose(results.series(item, "times"), when)
    return float(results.series(item, quantity)[at][0]) if np.any(at) else float("nan")


def _transient_picture(results: Results, figure: Figure) -> None:
    for axes, quantity in zip(figure.subplots(1, len(QUANTITIES)), QUANTITIES, strict=True):
        for item, style in ((_IMPLICIT, "-"), (_EXPLICIT, "o")):
            axes.plot(results.series(item, "times"), results.series(item, quantity), style, label=item)
        axes.axhline(results.value(_NEWTON, quantity), color="0.6", linewidth=0.8, label=_NEWTON)
        axes.set(xlabel=r"$Ut/\ell$", ylabel=f"${SYMBOLS[quantity]}$")
    axes.legend()


# A capsule in simple shear without walls: Taylor's deformation

_SMALL, _SHEARED_FOR = 0.01, 8.0
_BENDING, _CODES_DIFFER = 2e-4, 0.08
_CAPILLARY_NUMBERS = tuple(SHEAR[0].numbers)


def simple_shear() -> Topic:
    """Return the topic of steady deformations, and of the slope at small ones."""
    times = {_SMALL: 0.5} | dict.fromkeys(_CAPILLARY_NUMBERS, _SHEARED_FOR)  # a stiff membrane settles within a few Ca
    return Topic(
        "simple-shear",
        "Simple shear",
        f"Taylor's D of a neo-Hookean capsule sheared from rest without walls, Ca = mu (shear rate) a / G_s, at "
        f"refinement {_COARSE}, with a bending stiffness of {_BENDING:g}, at time {_SHEARED_FOR:g}. Published codes "
        f"differ by as much as {100 * _CODES_DIFFER:g} %.",
        {_sheared(ca): partial(_deformation, ca, time) for ca, time in times.items()},
        _shear_rows,
        _shear_picture,
    )


# Simple shear without walls, u_z = y.
#
# Lengths are over the radius a of the capsule, velocities over the shear rate
# times a, so the capillary number of a problem in this flow is
# Ca = mu (shear rate) a / G_s and its size ratio is 1.
#
# The membrane rotates like the tread of a tank. The bending energy is that of
# the displacement from rest, so it resists this rotation with a stress of order
# B, which should stay far below Ca


@dataclass(frozen=True)
class ShearFlow(Flow):
    """Simple shear along z in the plane x = 0."""

    symmetry: ClassVar[Symmetry] = C2H
    pressure_gradient: ClassVar[float] = 0.0

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Return velocity and gradient at points, see `Flow`."""
        y = points[:, 1]
        return unidirectional(y, np.zeros_like(y), np.ones_like(y))


def _sheared(capillary_number: float) -> str:
    return f"Ca = {capillary_number:g}"


def _deformation(capillary_number: float, time: float) -> Values:
    problem = Problem(NeoHookean(), ShearFlow(), _COARSE, _BENDING)
    start = problem.at_rest(capillary_number, 1.0)
    (end,) = transient(problem, start, [time], steady=0.0)  # the membrane goes on turning
    return {"deformation": taylor_deformation(problem.mesh, problem.mesh.expanded(end.iterate.free))}


def taylor_deformation(mesh: OctaSphere, nodes: Floats) -> float:
    """Compute D = (L - B) / (L + B) of the ellipsoid that has the capsule's inertia, with its axes in the plane x = 0.

    >>> from capsbayes.physics.surface import octasphere
    >>> sphere = octasphere(8)
    >>> round(taylor_deformation(sphere, sphere.nodes * [1.0, 0.9, 1.1]), 4)
    0.1
    """
    # The nodes (N, 3) of the deformed mesh are in any unit, the centroid at the origin.
    rule = dunavant(6)
    points = p2(rule.points) @ nodes[mesh.elements]
    tangents = np.einsum("qka,eki->eqai", p2_gradient(rule.points), nodes[mesh.elements])
    flux = rule.weights * np.einsum("eqi,eqi->eq", points, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    inertia = np.einsum("eq,eqi,eqj->ij", flux, points[..., 1:], points[..., 1:])
    shortest, longest = np.sqrt(np.linalg.eigvalsh(inertia))
    return float((longest - shortest) / (longest + shortest))


def _shear_rows(results: Results) -> Iterator[Row]:
    slope = results.value(_sheared(_SMALL), "deformation") / _SMALL
    yield Row(f"D / Ca at Ca = {_SMALL:g}", slope, SHEAR_SLOPE, Target("relative", 0.01))
    for ca in _CAPILLARY_NUMBERS:
        ours = results.value(_sheared(ca), "deformation")
        for published in SHEAR:
            yield Row(f"D, {_sheared(ca)}", ours, published.at(ca, "deformation"), Target("relative", _CODES_DIFFER))


def _shear_picture(results: Results, figure: Figure) -> None:
    axes = figure.subplots()
    axes.plot(_CAPILLARY_NUMBERS, results.across(map(_sheared, _CAPILLARY_NUMBERS), "deformation"), "-", label="ours")
    for published, marker in zip(SHEAR, "os", strict=True):
        numbers = [published.at(ca, "deformation").value for ca in _CAPILLARY_NUMBERS]
        axes.plot(_CAPILLARY_NUMBERS, numbers, marker, markerfacecolor="none", label=published.source)
    axes.plot([0.0, 0.2], [0.0, 0.2 * SHEAR_SLOPE.value], ":", color="0.5", label="small deformations")
    axes.set(xlabel="Ca", ylabel="D", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend()
