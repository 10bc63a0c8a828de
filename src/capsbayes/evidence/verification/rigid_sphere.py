"""Force-free rigid spheres on the axis."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from capsbayes.evidence.verification.references import RIGID_SPHERE
from capsbayes.evidence.verification.topic import Results, Row, Target, Topic, Values
from capsbayes.physics.channel import cross_section_named
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem
from capsbayes.physics.stokes import SingleLayer, wall_operator

_SIZES = (0.3, 0.5, 0.7, 0.8, 0.85, 0.9)
_WORDS = {"velocity_ratio": "V/U", "extra_pressure_drop": "dP+ [mu U/l]"}


def rigid_spheres(refinement: int = 12) -> Topic:
    """Return the topic of velocity and pressure drop of spheres of every size in both cross-sections."""
    return Topic(
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
    return rigid_sphere(Problem(NeoHookean(), cross_section_named(name), refinement, 0.0), size_ratio)._asdict()


class RigidMotion(NamedTuple):
    """Velocity over U, and pressure drop added to the undisturbed one over mu U / l."""

    velocity_ratio: float
    extra_pressure_drop: float


def rigid_sphere(problem: Problem, size_ratio: float) -> RigidMotion:
    """Compute the motion of a force-free rigid sphere on the axis, in the cross-section of a problem."""
    # The traction f solves v_inf + (single layer) + (walls) = V e_z on the sphere with zero total force; its constant
    # normal part, which causes no motion, is set to zero.
    mesh, basis, channel = problem.mesh, problem.mesh.basis, problem.channel
    nodes = size_ratio * mesh.nodes
    targets = nodes[mesh.wedge]
    layer = SingleLayer(mesh, size_ratio, nodes)
    operator = wall_operator(channel, problem.walls)
    response = operator.response(operator.velocity_matrix(targets))
    influence = layer.matrices(targets, target_nodes=mesh.wedge).velocity
    influence = influence - response @ layer.matrices(operator.points).velocity
    flow = mesh.reduced(channel.undisturbed(targets)[0])
    axial = basis.T @ np.tile([0.0, 0.0, 1.0], len(targets))
    normal = mesh.reduced(mesh.nodes[mesh.wedge])
    mass = problem.membrane(size_ratio).mass
    count = len(axial)
    matrix = np.zeros((count + 2, count + 2))
    matrix[:count, :count] = basis.T @ (basis.T @ influence.T).T
    matrix[:count, count:] = np.column_stack([-axial, normal])
    matrix[count:, :count] = np.stack([mass @ axial, mass @ normal])
    solution = np.linalg.solve(matrix, np.concatenate([-flow, [0.0, 0.0]]))
    drop = -(mass @ flow) @ solution[:count] / channel.area
    return RigidMotion(float(solution[count]), float(drop))


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
