"""What the two bending energies do: beside an independent shell, in a square channel, and in a tube as B falls.

``python evidence/bending.py`` computes what is missing of ``evidence/results/bending.json`` and writes the page
``evidence/results/bending.md``; with ``--page`` it writes the page of the stored results.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit
from threadpoolctl import threadpool_limits

from capsbayes import Simulator
from capsbayes.arrays import Floats
from capsbayes.physics.continuation import parachute
from capsbayes.physics.load import profile
from capsbayes.physics.steady import Iterate, steady_state
from capsbayes.physics.surface import prolonged

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "evidence" / "results"
STORE, PAGE = RESULTS / "bending.json", RESULTS / "bending.md"
ENERGIES = ("displacement", "curvature")
SHELL = [(height, n) for height in (0.8, 0.5) for n in (6, 8, 12)]
CHANNEL = [  # refinement, Ca, a/l, B
    (8, 0.02, 0.75, 2e-4),
    (8, 0.1, 0.7, 2e-4),
    *((8, 0.05, 0.9, bending) for bending in (2e-4, 1e-3)),
    (8, 0.08, 0.95, 1e-3),
    *((n, 0.08, 0.95, 2e-4) for n in (8, 10, 12)),
]
TUBE, UNBENT = (0.02, 0.8), (1.49586, 1.36403)  # Ca, a/R; L_z/R, L_a/R
MESHES, BENDINGS = (6, 8, 12, 16, 20, 24), (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
Row = list[float]


def shell(height: float, refinement: int) -> Row:
    """Return the rms distance from the independent shell for each energy."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from pressed_shell import distances

    return [float(np.sqrt(np.mean(distances(refinement, energy, height) ** 2))) for energy in ENERGIES]


def sharpest(points: Floats) -> float:
    """Return the smallest radius of curvature of an outline (p, 2)."""
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    spline, along = CubicSpline(length, points), np.linspace(0.01, 0.99, 4000) * length[-1]
    first, second = spline(along, 1), spline(along, 2)
    bend = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return float(1.0 / np.max(bend / np.hypot(*first.T) ** 3))


def channel(refinement: int, capillary_number: float, size_ratio: float, bending: float) -> Row:
    """Return L_z, L_a, V and the smallest radius of the mid-plane for each energy, over l and U."""
    row = []
    for energy in ENERGIES:
        simulator = Simulator(refinement=refinement, bending=bending, bending_energy=energy)
        state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start="parachute")
        assert state.status.ok, state.status
        outline = state.profile
        row += [outline.axial_extent, outline.axial_length, state.velocity_ratio, sharpest(outline.points)]
    return row


@cache
def tube_state(refinement: int, bending: float) -> Iterate:
    """Return the parachute in the tube, from that with the next larger B."""
    simulator = Simulator(cross_section="circular", refinement=refinement, bending=bending, bending_energy="curvature")
    problem, place = simulator.problem, BENDINGS.index(bending)
    if place:
        start = tube_state(refinement, BENDINGS[place - 1])
    elif refinement > 8:
        coarse = tube_state(8, bending)
        start = replace(coarse, free=prolonged(coarse.free, replace(problem, refinement=8).mesh, problem.mesh))
    else:
        start = parachute(problem, *TUBE).result.iterate
    result = steady_state(problem, start)
    assert result.converged
    return result.iterate


def tube(refinement: int, bending: float) -> Row:
    """Return L_z, L_a and V in the tube with the energy of curvature."""
    iterate = tube_state(refinement, bending)
    mesh = Simulator(cross_section="circular", refinement=refinement).problem.mesh
    outline = profile(mesh, mesh.expanded(iterate.free))
    return [outline.axial_extent, outline.axial_length, float(iterate.velocity)]


def tasks() -> Iterator[tuple[str, Callable[[], Row]]]:
    """Yield every result by its name."""
    for n in MESHES:
        for bending in BENDINGS:
            yield f"tube {n} {bending:g}", partial(tube, n, bending)
    for case in CHANNEL:
        yield "channel {:d} {:g} {:g} {:g}".format(*case), partial(channel, *case)
    for setting in SHELL:
        yield "shell {:g} {:d}".format(*setting), partial(shell, *setting)


def compute() -> None:
    """Compute what is missing, and keep each result."""
    known = json.loads(STORE.read_text()) if STORE.exists() else {}
    for name, task in tasks():
        if name not in known:
            with threadpool_limits(limits=1):
                known[name] = task()
            STORE.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n")
            print(name, known[name], flush=True)


def rate(refinements: list[int], errors: list[float]) -> float:
    """Return the exponent p of errors that fall as n^-p."""
    return float(-np.polyfit(np.log(refinements), np.log(errors), 1)[0])


def page(known: dict[str, Row]) -> str:
    """Return the page, with every number of its tables from the store."""
    meshes = sorted({n for _, n in SHELL})
    rates = [
        rate(meshes, [known[f"shell {height:g} {n}"][1] for n in meshes]) for height in sorted({h for h, _ in SHELL})
    ]
    return TEXT.format(
        shell="\n".join(
            "| {:g} | {} | {:.2e} | {:.2e} |".format(*setting, *known["shell {:g} {:d}".format(*setting)])
            for setting in SHELL
        ),
        rates=" and ".join(f"{value:.1f}" for value in rates),
        channel="\n".join(
            "| {:d} | {:g} | {:g} | {:g} | {} | {:.4f} | {:.4f} | {:.4f} | {:.4f} |".format(*case, energy, *values)
            for case in CHANNEL
            for energy, values in zip(
                ENERGIES, np.reshape(known["channel {:d} {:g} {:g} {:g}".format(*case)], (2, 4)), strict=True
            )
        ),
        meshes=" | ".join(f"n = {n}" for n in MESHES),
        extent=shown_limit(known, 0),
        length=shown_limit(known, 1),
        rule="---|" * (len(MESHES) + 1),
        tube="\n".join(
            f"| {bending:g} | " + " | ".join(differences(known[f"tube {n} {bending:g}"]) for n in MESHES) + " |"
            for bending in BENDINGS
        ),
    )


def limit(known: dict[str, Row], quantity: int) -> tuple[float, float]:
    """Return L_0 and p of L = L_0 - c B^p, fitted to L_z (0) or L_a (1) on the finest mesh."""
    values = [known[f"tube {MESHES[-1]} {bending:g}"][quantity] for bending in BENDINGS]
    fitted, _ = curve_fit(lambda b, end, c, p: end - c * b**p, BENDINGS, values, p0=(UNBENT[quantity], 0.3, 0.4))
    return float(fitted[0]), float(fitted[2])


def shown_limit(known: dict[str, Row], quantity: int) -> str:
    """Return the limit, its difference from that without bending, and the exponent."""
    end, power = limit(known, quantity)
    return f"{end:.4f} ({100 * (end / UNBENT[quantity] - 1):+.3f} %, p = {power:.2f})"


def differences(row: Row) -> str:
    """Return how far L_z and L_a are from those without bending."""
    return ", ".join(f"{100 * (value / truth - 1):+.2f}" for value, truth in zip(row[:2], UNBENT, strict=True))


TEXT = f"""# Bending

Made by `python evidence/bending.py`. M2 and M2a of the [method](../../docs/method.md) define the two energies: that of
the change of curvature (Koiter's), and that of the displacement, with which the databases were made.

## Compared with an independent shell

Springs press the poles of a neo-Hookean sphere, B = 0.01, in towards 0.8 and 0.5 of their height. The reference is an
axisymmetric shell in polynomials of the latitude (`tests/support/axisymmetric_shell.py`). The table gives the rms
distance of the nodes from it, over a:

| height | refinement | displacement | curvature |
|---|---|---|---|
{{shell}}

The energy of the change of curvature converges to the independent shell, at the rates {{rates}}; that of the
displacement converges to another shape. Under a rigid rotation the first has no energy and no force, to rounding;
the second has both.

## In a square channel

Parachutes at refinement n; lengths over l. The last column is the smallest radius of curvature of the outline in
the mid-plane, on the rear rim.

| n | Ca | a/l | B | energy | L_z | L_a | v_o/U | rim |
|---|---|---|---|---|---|---|---|---|
{{channel}}

L_z and v_o/U are the same within 0.04 % and L_a within 0.17 %, where the mesh resolves the rim. At Ca = 0.08,
a/l = 0.95 and B = 2e-4 the rim is sharper than the elements: L_z still changes with the mesh, and the difference
of the two energies falls from 0.17 to 0.04 %.

## As the stiffness falls

In a circular tube at Ca = {TUBE[0]:g}, a/R = {TUBE[1]:g} an axisymmetric solver without bending gives L_z/R =
{UNBENT[0]} and L_a/R = {UNBENT[1]}. Differences from it in %, of L_z and of L_a, with the energy of the change of
curvature:

| B | {{meshes}} |
|{{rule}}
{{tube}}

At B = 2e-4 the meshes from n = 8 on agree within 0.06 %: the 0.6 % in L_z is bending, not the mesh. The two finest
meshes agree within 0.01 % down to B = 2e-5 and within 0.04 % at 1e-5; at 5e-6 the rim is sharper than the elements
and they differ by 0.08 %. Where coarse meshes seem to reach the limit, they do so because they do not resolve the
rim. Power laws L = L_0 - c B^p fitted to the rows of n = {MESHES[-1]} give the limits
L_z/R = {{extent}} and L_a/R = {{length}}.

The convergence is slow: for 0.04 % in L_z without extrapolation B would have to be some 2e-7. If the thickness of the
membrane is not known, L_z is therefore not known to better than some 0.6 %, whatever the error of a surrogate.

## Which energy to use

`curvature` is the energy of a shell, and the only one in which B is a thickness. `displacement` is the default,
because all databases and surrogates were made with it and a simulation should agree with them. A Jacobian takes
0.03 s longer with `curvature` at refinement 8 and 0.2 s at 12.
"""


if __name__ == "__main__":
    if "--page" not in sys.argv:
        compute()
    PAGE.write_text(page(json.loads(STORE.read_text())))
