"""The simulator: steady shape and velocity of a capsule in a channel, from Ca and a/l."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from capsbayes.errors import InputError
from capsbayes.membrane import MembraneLaw, NeoHookean
from capsbayes.profile import Profile
from capsbayes.simulation import outlines
from capsbayes.simulation.continuation import SLACK_LIMIT, BranchEnd, first_state, followed
from capsbayes.simulation.pressure import pressures
from capsbayes.simulation.steady_state import Iterate, NewtonResult, SteadyProblem
from capsbayes.status import Status
from capsbayes.stokes.channel import section_named
from capsbayes.stokes.walls import Walls
from capsbayes.surface.octasphere import octasphere
from capsbayes.surface.prolongation import prolonged

__all__ = ["Simulator", "SteadyState"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SteadyState:
    """A capsule that moves without changing its shape. Lengths over l, velocities over U, tensions over G_s.

    Attributes
    ----------
    capillary_number, size_ratio : float
        The case asked for [-].
    settings : mapping
        The simulator's settings.
    nodes : (w, 3) array [l]
        Nodes of the wedge 0 <= y <= x; the flow is along z, the centroid at the origin.
    velocity_ratio : float
        V = v_o / U [-].
    inner_pressure : float
        Pressure inside, over that of the undisturbed flow at the centroid [mu U / l].
    extra_pressure_drop : float
        Pressure drop that the capsule adds to that of the undisturbed flow [mu U / l].
    principal_tensions : (N, 2) array [G_s]
        At all nodes, the larger first.
    residual : float
        Largest velocity left at a node [U] or error of volume or centroid [l^3, l^4].
    slack : float
        Uniform normal velocity left over [U]: an indicator of the mesh's error.
    iterations : int
        Newton steps of the last solve.
    status : Status
        Where it is not ``DONE``, the shape is that of the last steady state on the way to the case.
    detail : str
        What else there is to say about `status`.
    along_ca : (f + 2,) array
        Derivative of shape, velocity and slack along Ca: starts the next case.
    """

    capillary_number: float
    size_ratio: float
    settings: Mapping[str, Any]
    nodes: Array
    velocity_ratio: float
    inner_pressure: float
    extra_pressure_drop: float
    principal_tensions: Array
    residual: float
    slack: float
    iterations: int
    status: Status
    detail: str
    along_ca: Array = field(repr=False)

    @property
    def surface_nodes(self) -> Array:
        """All nodes of the membrane (N, 3) [l]."""
        mesh = octasphere(self.settings["refinement"])
        return np.einsum("nij,nj->ni", mesh.operation, self.nodes[mesh.wedge_of])

    @property
    def profile(self) -> Profile:
        """Outline in the plane x = 0 [l]."""
        return outlines.profile(octasphere(self.settings["refinement"]), self.surface_nodes)

    @property
    def silhouette(self) -> Profile:
        """Outline of the whole capsule seen along x [l]."""
        return outlines.silhouette(octasphere(self.settings["refinement"]), self.surface_nodes)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the membrane as a VTK unstructured grid (``.vtu``) of quadratic triangles, for ParaView."""
        import meshio

        path = Path(path)
        if path.suffix != ".vtu":
            raise InputError(str(path), "", "a file name that ends in .vtu", repr(path.suffix))
        names = ("larger principal tension / G_s", "smaller principal tension / G_s")
        tensions = dict(zip(names, self.principal_tensions.T, strict=True))
        cells = [("triangle6", octasphere(self.settings["refinement"]).elements)]
        mesh = meshio.Mesh(self.surface_nodes, cells, point_data=tensions)
        partial = path.with_name(f".{path.name}.{os.getpid()}.vtu")
        mesh.write(partial)
        os.replace(partial, path)
        return path


@dataclass(frozen=True)
class Simulator:
    """Boundary integrals for the liquids, finite elements for the membrane, Newton's method for the steady state.

    Parameters
    ----------
    law : MembraneLaw
        Law of the membrane.
    section : str
        Section of the channel: ``"square"``.
    refinement : int
        Elements along the edge of an octahedron's face, at least 4; 8 is good to about 0.3 % in L_z, 12 to 0.07 %.
    bending : float
        Bending stiffness over G_s a^2 [-]; regularises wrinkles where the membrane is compressed.
    pre_inflation : float
        Inflation alpha of the sphere at rest from its unstressed radius a / (1 + alpha) [-].
    walls : Walls
        How finely the walls are represented.

    Examples
    --------
    >>> simulator = Simulator(refinement=4)
    >>> state = simulator.run(capillary_number=0.05, size_ratio=0.8)
    >>> print(state.status, round(state.velocity_ratio, 2), round(state.profile.axial_extent, 1))
    Done. 1.41 1.5
    """

    law: MembraneLaw = field(default_factory=NeoHookean)
    section: str = "square"
    refinement: int = 8
    bending: float = 2e-4
    pre_inflation: float = 0.0
    walls: Walls = field(default_factory=Walls)

    def __post_init__(self) -> None:
        section_named(self.section)
        if self.refinement < 4:
            raise InputError("Simulator", "refinement", "at least 4", str(self.refinement))
        for name in ("bending", "pre_inflation"):
            value = getattr(self, name)
            if not 0 <= value < 1:
                raise InputError("Simulator", name, "a number from 0 to 1", str(value))

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides the result, in types that JSON knows."""
        return {
            "law": self.law.name,
            "section": self.section,
            "refinement": self.refinement,
            "bending": self.bending,
            "pre_inflation": self.pre_inflation,
            "walls": asdict(self.walls),
        }

    def refined(self, refinement: int) -> Simulator:
        """The same simulator on another mesh."""
        return replace(self, refinement=refinement)

    @property
    def problem(self) -> SteadyProblem:
        """The discrete equations."""
        return SteadyProblem(
            self.law, section_named(self.section), self.refinement, self.bending, self.pre_inflation, self.walls
        )

    def run(
        self, *, capillary_number: float, size_ratio: float, start: SteadyState | None = None, threads: int = 1
    ) -> SteadyState:
        """Steady state of one case.

        Parameters
        ----------
        capillary_number : float
            Ca = mu U / G_s, positive.
        size_ratio : float
            a/l, between 0.2 and 1.3.
        start : SteadyState, optional
            A neighbouring steady state to start from, of any mesh; by default the branch is followed from a first
            state near rest, which takes some ten seconds more.
        threads : int
            Threads of the linear algebra.

        Returns
        -------
        SteadyState
            Look at its `status`: above the limit of existence there is none.

        Raises
        ------
        InputError
            If the case is not a possible one.
        """
        _check("capillary_number", capillary_number, 0.0, 10.0)
        _check("size_ratio", size_ratio, 0.2, 1.3)
        with threadpool_limits(limits=threads):
            problem = self.problem
            first = _first(problem) if start is None else self._taken_up(problem, start)
            if start is not None and not first.converged:
                first = _first(problem)
            if not first.converged:
                return self._state(problem, first, capillary_number, size_ratio, Status.NOT_CONVERGED)
            end, status = _reached(problem, first, capillary_number, size_ratio)
            return self._state(problem, end.result, capillary_number, size_ratio, status)

    def _taken_up(self, problem: SteadyProblem, start: SteadyState) -> NewtonResult:
        """A steady state of this or another mesh as the start of a branch."""
        mesh = octasphere(start.settings["refinement"])
        free, along_ca = mesh.reduced(start.nodes), start.along_ca
        if mesh is not problem.mesh:
            free = prolonged(free, mesh, problem.mesh)
            along_ca = np.zeros(len(free) + 2)
        iterate = Iterate(free, start.velocity_ratio, start.slack, start.capillary_number, start.size_ratio)
        taken = NewtonResult(iterate, start.status.ok, start.residual, 0, along_ca)
        return taken if dict(start.settings) == self.settings else problem.solve(iterate)

    def _state(
        self, problem: SteadyProblem, result: NewtonResult, capillary_number: float, size_ratio: float, status: Status
    ) -> SteadyState:
        iterate = result.iterate
        detail = ""
        if status in (Status.NO_STEADY_STATE, Status.NOT_CONVERGED):
            detail = f"The branch was followed to Ca = {iterate.capillary_number:.4g}, a/l = {iterate.size_ratio:.4g}."
        inside, drop = pressures(problem, iterate)
        return SteadyState(
            capillary_number=capillary_number,
            size_ratio=size_ratio,
            settings=self.settings,
            nodes=problem.mesh.expanded(iterate.free)[problem.mesh.wedge],
            velocity_ratio=float(iterate.velocity),
            inner_pressure=inside,
            extra_pressure_drop=drop,
            principal_tensions=problem.membrane(iterate.size_ratio).principal_tensions(iterate.free),
            residual=result.residual,
            slack=float(iterate.slack),
            iterations=result.iterations,
            status=status,
            detail=detail,
            along_ca=result.tangent,
        )


def _check(name: str, value: float, above: float, below: float) -> None:
    if not above < value < below:
        raise InputError("Simulator.run", name, f"a number between {above:g} and {below:g}", f"{value:g}")


@lru_cache(maxsize=8)
def _first(problem: SteadyProblem) -> NewtonResult:
    return first_state(problem)


def _reached(
    problem: SteadyProblem, first: NewtonResult, capillary_number: float, size_ratio: float
) -> tuple[BranchEnd, Status]:
    """End of the branch on the way to a case: a larger size before a larger Ca, a smaller Ca before any size."""
    here = first.iterate
    if capillary_number < here.capillary_number:
        legs = [(capillary_number, here.size_ratio), (capillary_number, size_ratio)]
    else:
        legs = [(here.capillary_number, size_ratio), (capillary_number, size_ratio)]
    end = BranchEnd(first, 1.0)
    for leg in legs:
        before = end.result.iterate
        if leg == (before.capillary_number, before.size_ratio):
            continue
        end = followed(problem, end.result, *leg)
        if end.reached < 1.0:
            rising = leg[0] > before.capillary_number and leg[1] == before.size_ratio
            return end, Status.NO_STEADY_STATE if rising else Status.NOT_CONVERGED
    resolved = abs(end.result.iterate.slack) < SLACK_LIMIT
    return end, Status.DONE if resolved else Status.UNRESOLVED
