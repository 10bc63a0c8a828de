"""A capsule in simple shear without walls: Taylor's deformation."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.evidence.verification.references import SHEAR, SHEAR_SLOPE
from capsbayes.evidence.verification.topic import Results, Row, Target, Topic, Values
from capsbayes.physics.channel import ShearFlow
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem
from capsbayes.physics.surface import OctaSphere, dunavant, p2, p2_gradient
from capsbayes.physics.transient import transient

_SMALL, _TIME = 0.01, 8.0
_BENDING, _CODES_DIFFER = 2e-4, 0.08
_CAPILLARY_NUMBERS = tuple(SHEAR[0].numbers)


def simple_shear(refinement: int = 6) -> Topic:
    """Return the topic of steady deformations, and of the slope at small ones."""
    times = {_SMALL: 0.5} | dict.fromkeys(_CAPILLARY_NUMBERS, _TIME)  # a stiff membrane settles within a few Ca
    return Topic(
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
