"""The discretisation: Newton's Jacobian against differences, other walls, and finer meshes with their cost."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from capsbayes.physics.simulator import Simulator
from capsbayes.physics.stokes import WallDiscretisation
from evidence.verification.quantities import (
    QUANTITIES,
    SYMBOLS,
    fitted_limit,
    fitted_rate,
    iterate_of,
    label_refinements,
    numbers,
    on_mesh,
    steady,
)
from evidence.verification.topic import Reference, Results, Row, Target, Topic, Values

_CASE, _NEIGHBOUR = (0.05, 0.9), (0.04, 0.9)
_COARSE = 6  # refinement of the Jacobian and of the walls

_STEP = 1e-6
_DIRECTIONS = ("stretching the rear", "third powers", "Ca")
_DERIVATIVES = "derivatives"

_WALL_CASE = (0.082, 0.96)
_AS_SHIPPED, _SHIPPED = "as shipped", WallDiscretisation()
_OTHERS = {
    "finer spacing": WallDiscretisation(spacing=0.065, far_spacing=0.13),
    "coarser spacing": WallDiscretisation(spacing=0.1),
    "longer channel": WallDiscretisation(end=4.0),
}

_REFINEMENTS = (6, 8, 10, 12, 16)
_ITEMS = [on_mesh(n) for n in _REFINEMENTS]
_TARGETS = {  # errors at n = 8 and at n = 12
    "axial_extent": (0.005, 0.002),
    "axial_length": (0.005, 0.002),
    "velocity_ratio": (0.001, 0.0005),
}

_TENSION_CASES = ((0.02, 1.0), (0.05, 0.9), (0.1, 0.85), (0.1, 1.0))
_STORED, _FINER = 12, 16  # refinement of the states whose largest tension is stored, and a finer one
_TENSION = "largest_tension"


def newtons_jacobian() -> Topic:
    """Return the topic of derivatives along two smooth changes of shape and along Ca, at a steady state."""
    return Topic(
        "jacobian",
        "Newton's Jacobian",
        "At the steady state of Ca = {:g}, a/l = {:g}, refinement {}: largest difference of the velocity errors' "
        "derivative from central differences, over its largest value. Omitted on both sides: the rotation of the "
        "normals along which the slack acts, which the derivatives neglect.".format(*_CASE, _COARSE),
        {_DERIVATIVES: _differences},
        _jacobian_rows,
    )


def _differences() -> Values:
    simulator = Simulator(refinement=_COARSE)
    problem = simulator.problem
    iterate = replace(iterate_of(problem, steady(simulator, *_CASE)), slack=0.0)
    _, slopes = problem.linearised(iterate)
    mesh = problem.mesh
    x, y, z = mesh.nodes[mesh.wedge].T
    fields = (np.column_stack([x * z, y * z, np.cos(3.0 * z)]), np.column_stack([x**3, y**3, z**2]))
    compared = []
    for direction in map(mesh.reduced, fields):
        ends = [replace(iterate, free=iterate.free + step * direction) for step in (_STEP, -_STEP)]
        compared.append((slopes.along_shape @ direction, ends))
    ends = [replace(iterate, capillary_number=iterate.capillary_number + step) for step in (_STEP, -_STEP)]
    compared.append((slopes.along_ca, ends))
    errors = {}
    for words, (exact, (ahead, behind)) in zip(_DIRECTIONS, compared, strict=True):
        difference = (problem.motion(ahead).error - problem.motion(behind).error) / (2.0 * _STEP)
        errors[words] = float(np.max(np.abs(exact - difference)) / np.max(np.abs(difference)))
    return errors


def _jacobian_rows(results: Results) -> Iterator[Row]:
    for direction in _DIRECTIONS:
        error = results.value(_DERIVATIVES, direction)
        yield Row(f"along {direction}: relative difference", error, target=Target("at most", 1e-6))


def wall_discretisation() -> Topic:
    """Return the topic of one capsule with other spacings of the Stokeslets and another length of the channel."""
    discretisations = {_AS_SHIPPED: _SHIPPED} | _OTHERS
    return Topic(
        "walls",
        "Walls",
        "Ca = {:g}, a/l = {:g} at refinement {}, with other representations of the walls.".format(*_WALL_CASE, _COARSE),
        {name: partial(_with_walls, walls) for name, walls in discretisations.items()},
        _wall_rows,
    )


def _with_walls(walls: WallDiscretisation) -> Values:
    return numbers(steady(Simulator(refinement=_COARSE, walls=walls), *_WALL_CASE))


def _wall_rows(results: Results) -> Iterator[Row]:
    source = f"spacing {_SHIPPED.spacing:g} l, half length {_SHIPPED.end:g} l"
    for name, walls in _OTHERS.items():
        for quantity in QUANTITIES:
            reference = Reference(results.value(_AS_SHIPPED, quantity), source)
            words = f"{name}: {SYMBOLS[quantity]}, spacing {walls.spacing:g} l, half length {walls.end:g} l"
            yield Row(words, results.value(name, quantity), reference, Target("relative", 2e-4))


def mesh_refinement() -> Topic:
    """Return the topic of errors and processor times on five meshes."""
    return Topic(
        "refinement",
        "Refinement",
        "Neo-Hookean capsule at Ca = {:g}, a/l = {:g} in the square channel. Values on all meshes are fitted by "
        "q + c n^-p; q is the reference of the errors. Times are those of Newton's method from the steady state at "
        "Ca = {:g}, the shorter of two.".format(*_CASE, _NEIGHBOUR[0]),
        {on_mesh(n): partial(_timed_state, n) for n in _REFINEMENTS},
        _refinement_rows,
        _refinement_picture,
    )


def _timed_state(refinement: int) -> Values:
    simulator = Simulator(refinement=refinement)
    neighbour = steady(simulator, *_NEIGHBOUR)
    seconds = []
    for _ in range(2):
        begin = time.process_time()
        state = steady(simulator, *_CASE, neighbour)
        seconds.append(time.process_time() - begin)
    return numbers(state) | {"seconds": min(seconds), "iterations": state.iterations}


def _refinement_rows(results: Results) -> Iterator[Row]:
    for quantity in QUANTITIES:
        values, symbol = results.across(_ITEMS, quantity), SYMBOLS[quantity]
        limit = fitted_limit(_REFINEMENTS, values)
        reference = Reference(limit.value, "fitted limit")
        targets = dict(zip((8, 12), _TARGETS[quantity], strict=True))
        for n, value in zip(_REFINEMENTS, values, strict=True):
            target = Target("relative", targets[n]) if n in targets else None
            yield Row(f"{symbol}, n = {n}", float(value), reference, target)
        yield Row(f"{symbol}: fitted rate p", limit.rate, target=Target("at least", 2.0))
    seconds = results.across(_ITEMS, "seconds")
    for n, duration in zip(_REFINEMENTS, seconds, strict=True):
        yield Row(f"seconds of a steady state from its neighbour, n = {n}", float(duration))
    yield Row("fitted exponent of the time in n", -fitted_rate(_REFINEMENTS, seconds))


def _refinement_picture(results: Results, figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    for quantity in QUANTITIES:
        values = results.across(_ITEMS, quantity)
        limit = fitted_limit(_REFINEMENTS, values)
        label = f"${SYMBOLS[quantity]}$, $p = {limit.rate:.1f}$"
        left.loglog(_REFINEMENTS, np.abs(values / limit.value - 1.0), "o-", label=label)
    seconds = results.across(_ITEMS, "seconds")
    right.loglog(_REFINEMENTS, seconds, "o-", label=f"exponent {-fitted_rate(_REFINEMENTS, seconds):.1f}")
    label_refinements(left, _REFINEMENTS, "relative error")
    label_refinements(right, _REFINEMENTS, "seconds")


def largest_tension() -> Topic:
    """Return the topic of the largest principal tension on the mesh of the stored states and on a finer one."""
    return Topic(
        "tension",
        "Largest tension",
        "Largest principal tension over G_s of neo-Hookean capsules in the square channel, at the refinement of the "
        "stored states and at a finer one.",
        {_with_tension(case, n): partial(_tension_of, case, n) for case in _TENSION_CASES for n in (_STORED, _FINER)},
        _tension_rows,
    )


def _with_tension(case: tuple[float, float], refinement: int) -> str:
    capillary_number, size_ratio = case
    return f"Ca = {capillary_number:g}, a/l = {size_ratio:g}, {on_mesh(refinement)}"


def _tension_of(case: tuple[float, float], refinement: int) -> Values:
    return {_TENSION: float(steady(Simulator(refinement=refinement), *case).principal_tensions.max())}


def _tension_rows(results: Results) -> Iterator[Row]:
    for case in _TENSION_CASES:
        ours, finer = (results.value(_with_tension(case, n), _TENSION) for n in (_STORED, _FINER))
        yield Row(_with_tension(case, _STORED), ours, Reference(finer, on_mesh(_FINER)), Target("relative", 0.02))
