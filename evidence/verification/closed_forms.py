"""Parts of the simulator against theory: undisturbed flow, membrane laws, a single layer, and rigid spheres."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from capsbayes.physics.channel import (
    Channel,
    CircularChannel,
    RectangularChannel,
    RoundedSquareChannel,
    SquareChannel,
    cross_section_named,
)
from capsbayes.physics.membrane import NeoHookean, law_named
from capsbayes.physics.steady import Problem
from capsbayes.physics.stokes import SingleLayer, wall_operator
from capsbayes.physics.surface import octasphere
from capsbayes.testing import check_law
from evidence.verification.quantities import fitted_rate, label_refinements, on_mesh
from evidence.verification.references import FRICTION, MODULI, RIGID_SPHERE, UNDISTURBED
from evidence.verification.topic import Reference, Results, Row, Target, Topic, Values

_CLASSICAL: dict[str, Channel] = {"square": SquareChannel(), "circular": CircularChannel()}
_RADII = (0.01, 0.05, 0.1, 0.2)
_OF_FLOW = {"centre_velocity": "velocity at the centre", "pressure_gradient": "pressure gradient"}
_STRAIN = 1e-4
_OF_LAYER = {
    "translation": "velocity of the sphere drawn by 6 pi mu a U",
    "pressure": "velocity by a constant pressure",
}


def undisturbed_flow() -> Topic:
    """Return the topic of centre velocity and pressure gradient of every cross-section."""
    channels = (
        _CLASSICAL
        | {_rectangle(aspect): RectangularChannel(aspect) for aspect in FRICTION.numbers}
        | {_rounded(radius): RoundedSquareChannel(radius) for radius in _RADII}
    )
    return Topic(
        "undisturbed-flow",
        "Undisturbed flow",
        "Over U, and over mu U/l^2. Rounded corners of radius r_c take only the order (r_c^2 log r_c)^2 from the flux: "
        "for small r_c both fall below those of the square as the area does, by the share (1 - pi/4) r_c^2; the "
        "target is twice that order.",
        {name: partial(_flow, channel) for name, channel in channels.items()},
        _flow_rows,
    )


def _rectangle(aspect: float) -> str:
    return f"rectangle b/l = {aspect:g}"


def _rounded(radius: float) -> str:
    return f"rounded r_c/l = {radius:g}"


def _flow(channel: Channel) -> Values:
    centre = channel.undisturbed(np.zeros((1, 3)))[0][0, 2]
    return {"centre_velocity": float(centre), "pressure_gradient": channel.pressure_gradient}


def _flow_rows(results: Results) -> Iterator[Row]:
    for name in _CLASSICAL:
        for quantity, words in _OF_FLOW.items():
            reference = UNDISTURBED.at(name, quantity)
            yield Row(f"{name}: {words}", results.value(name, quantity), reference, Target("relative", 1e-7))
    for aspect in FRICTION.numbers:
        diameter = 4.0 * aspect / (1.0 + aspect)
        factor = results.value(_rectangle(aspect), "pressure_gradient") * diameter**2 / 2.0
        reference = FRICTION.at(aspect, "friction_factor")
        yield Row(f"{_rectangle(aspect)}: f Re", factor, reference, Target("relative", 1e-4))
    for quantity, words in _OF_FLOW.items():
        yield from _limit_of_the_square(results, quantity, words)


def _limit_of_the_square(results: Results, quantity: str, words: str) -> Iterator[Row]:
    square, share = UNDISTURBED.at("square", quantity).value, 1.0 - np.pi / 4.0
    values = results.across(map(_rounded, _RADII), quantity)
    for radius, value in zip(_RADII, values, strict=True):
        reference = Reference(square * (1.0 - share * radius**2), "square, area law")
        target = Target("relative", 2.0 * (radius**2 * np.log(radius)) ** 2)
        yield Row(f"{_rounded(radius)}: {words}", float(value), reference, target)
    coefficient = float(1.0 - values[0] / square) / _RADII[0] ** 2
    words = f"{_rounded(_RADII[0])}: loss of {words} over r_c^2"
    yield Row(words, coefficient, Reference(share, "area law"), Target("relative", 0.01))


def membrane_laws() -> Topic:
    """Return the topic of the moduli at small strain, for every law at several values of its parameter."""
    return Topic(
        "membrane-laws",
        "Membrane laws",
        "Each law passes `capsbayes.testing.check_law`, or has no row of numbers: true derivatives of its energy, "
        "tensions, isotropy. The moduli over G_s are slopes of its tensions at small strain.",
        {str(law): partial(_moduli, str(law)) for law in MODULI.numbers},
        _law_rows,
    )


def _moduli(name: str) -> Values:
    law = law_named(name)
    check_law(law)
    strains = _STRAIN * np.array([[1.0, 1.0], [1.0, -1.0]])
    tensions = law.principal_tensions(1.0 + strains) - law.principal_tensions(1.0 - strains)
    dilation, shear = (float(slope) for slope in tensions[:, 0] / (4.0 * _STRAIN))
    return {"area_dilation_modulus": dilation, "shear_modulus": shear}


def _law_rows(results: Results) -> Iterator[Row]:
    for law in MODULI.numbers:
        dilation, shear = (results.value(str(law), f"{name}_modulus") for name in ("area_dilation", "shear"))
        yield Row(f"{law}: K_s", dilation, MODULI.at(law, "area_dilation_modulus"), Target("absolute", 1e-6))
        yield Row(f"{law}: G_s", shear, Reference(1.0, "the scale"), Target("absolute", 1e-6))


def single_layer(refinements: Sequence[int] = (4, 6, 8, 12)) -> Topic:
    """Return the topic of Stokes' drag, and of the constant normal density, on several meshes."""
    return Topic(
        "single-layer",
        "Single layer",
        "Largest errors at the nodes of a sphere, over its velocity: a uniform traction of total force 6 pi mu a U "
        "moves every point of it with U, and a constant pressure moves nothing. The elements are of third order.",
        {on_mesh(n): partial(_layer_errors, n) for n in refinements},
        partial(_layer_rows, refinements),
        partial(_layer_picture, refinements),
    )


def _layer_errors(refinement: int) -> Values:
    mesh = octasphere(refinement)
    matrix = SingleLayer(mesh, 1.0, mesh.nodes).matrices(mesh.nodes[mesh.wedge], target_nodes=mesh.wedge).velocity
    drawn = (matrix @ np.tile([0.0, 0.0, 1.5], len(mesh.wedge))).reshape(-1, 3)
    pressed = matrix @ mesh.nodes[mesh.wedge].ravel()
    return {
        "translation": float(np.max(np.abs(drawn - [0.0, 0.0, 1.0]))),
        "pressure": float(np.max(np.abs(pressed))),
    }


def _layer_rows(refinements: Sequence[int], results: Results) -> Iterator[Row]:
    for name, words in _OF_LAYER.items():
        errors = results.across(map(on_mesh, refinements), name)
        for n, error in zip(refinements, errors, strict=True):
            yield Row(f"{words}: error at n = {n}", float(error), target=Target("at most", 1e-4) if n >= 8 else None)
        yield Row(f"{words}: order", fitted_rate(refinements, errors), target=Target("at least", 2.9))


def _layer_picture(refinements: Sequence[int], results: Results, figure: Figure) -> None:
    axes = figure.subplots()
    for name, words in _OF_LAYER.items():
        axes.loglog(refinements, results.across(map(on_mesh, refinements), name), "o-", label=words)
    label_refinements(axes, refinements, "largest error [U]")


# Force-free rigid spheres on the axis

_SIZES = (0.3, 0.5, 0.7, 0.8, 0.85, 0.9)
_OF_SPHERE = {"velocity_ratio": "V/U", "extra_pressure_drop": "dP+ [mu U/l]"}


def rigid_spheres(refinement: int = 12) -> Topic:
    """Return the topic of velocity and pressure drop of spheres of every size in both cross-sections."""
    return Topic(
        "rigid-sphere",
        "Rigid sphere",
        f"A sphere free to move on the axis, at refinement {refinement}: its velocity, and the pressure drop it adds.",
        {_sphere(*case): partial(_sphere_motion, *case, refinement) for case in _spheres()},
        _sphere_rows,
        _sphere_picture,
    )


def _spheres() -> list[tuple[str, float]]:
    return [(name, size) for name in ("square", "circular") for size in _SIZES]


def _sphere(name: str, size_ratio: float) -> str:
    return f"{name}, a/l = {size_ratio:g}"


def _sphere_motion(name: str, size_ratio: float, refinement: int) -> Values:
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


def _sphere_rows(results: Results) -> Iterator[Row]:
    for case in _spheres():
        target = Target("relative", 1e-4 if case[1] < 0.9 else 3e-4)  # the references have a digit less there
        for quantity, words in _OF_SPHERE.items():
            ours = results.value(_sphere(*case), quantity)
            yield Row(f"{_sphere(*case)}: {words}", ours, RIGID_SPHERE.at(case, quantity), target)


def _sphere_picture(results: Results, figure: Figure) -> None:
    for axes, (quantity, words) in zip(figure.subplots(1, 2), _OF_SPHERE.items(), strict=True):
        for name in ("square", "circular"):
            (line,) = axes.plot(_SIZES, results.across((_sphere(name, size) for size in _SIZES), quantity), label=name)
            references = [RIGID_SPHERE.at((name, size), quantity).value for size in _SIZES]
            axes.plot(_SIZES, references, "o", color=line.get_color(), markerfacecolor="none")
        axes.set(xlabel="a/l", ylabel=words)
    axes.set_yscale("log")
    axes.legend(title="lines ours, circles the reference")
