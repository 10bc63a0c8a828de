"""The simulator: steady shapes and transients of one capsule in a channel."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.output_file import refusing, write_file
from capsbayes.physics import load as outlines
from capsbayes.physics.channel import Channel, cross_section_named
from capsbayes.physics.continuation import BranchEnd, carried, followed, parachute, reached_from_rest, wrinkling_rate
from capsbayes.physics.load import BendingEnergy
from capsbayes.physics.membrane import MembraneLaw, NeoHookean
from capsbayes.physics.steady import Iterate, NewtonResult, Problem, pressures
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.physics.surface import OctaSphere, octasphere, prolonged
from capsbayes.physics.transient import Scheme, transient
from capsbayes.profile import Profile
from capsbayes.status import Status

# The shape of a simulated capsule: nodes, outlines, and a file for ParaView


@dataclass(frozen=True, eq=False)
class Shape:
    """A capsule in its channel. Lengths over l, velocities over U."""

    capillary_number: float
    size_ratio: float
    settings: Mapping[str, Any]
    nodes: Floats  # (w, 3) of the wedge 0 <= y <= x, or 0 <= x, y; flow along z, centroid at the origin
    velocity_ratio: float  # velocity of the centroid v_o / U

    @property
    def channel(self) -> Channel:
        """The channel that the capsule is in."""
        known = self.settings
        return cross_section_named(known["cross_section"], known["corner_radius"], known["section_aspect"])

    @property
    def mesh(self) -> OctaSphere:
        """Mesh of the unit sphere to whose wedge the nodes belong."""
        return octasphere(self.settings["refinement"], self.channel.symmetry)

    @property
    def surface_nodes(self) -> Floats:
        """All nodes of the membrane (N, 3) [l]."""
        mesh = self.mesh
        return np.einsum("nij,nj->ni", mesh.operation, self.nodes[mesh.wedge_of])

    def free_on(self, mesh: OctaSphere) -> Floats:
        """Return the free coordinates (F,) of the shape on a mesh, its own or another."""
        return prolonged(self.mesh.reduced(self.nodes), self.mesh, mesh)

    @property
    def profile(self) -> Profile:
        """Outline in the plane x = 0 [l]."""
        return outlines.profile(self.mesh, self.surface_nodes)

    @property
    def silhouette(self) -> Profile:
        """Outline of the whole capsule seen along x [l]."""
        return outlines.silhouette(self.mesh, self.surface_nodes)

    @property
    def point_data(self) -> dict[str, Floats]:
        """Values (N,) at the nodes that are saved with the shape, by the names that ParaView shows."""
        return {}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the membrane as a VTK unstructured grid (``.vtu``) of quadratic triangles, for ParaView."""
        import meshio

        path = Path(path)
        if path.suffix != ".vtu":
            raise InputError(str(path), "", "a file name that ends in .vtu", repr(path.suffix))
        mesh = meshio.Mesh(self.surface_nodes, [("triangle6", self.mesh.elements)], point_data=self.point_data)
        with refusing(path, "a file that can be written"), tempfile.TemporaryDirectory() as folder:
            mesh.write(Path(folder) / "mesh.vtu")  # meshio writes no other way
            return write_file(path, (Path(folder) / "mesh.vtu").read_bytes())


# Snapshots of a transient, and their files for ParaView


@dataclass(frozen=True, eq=False)
class Snapshot(Shape):
    """A capsule at one time of a transient. Lengths over l, velocities over U."""

    time: float  # U t / l
    speed: float  # of the fastest node relative to the centroid; it vanishes at steady state
    slack: float  # uniform normal velocity that remains: an indicator of the mesh's error


def snapshots(
    problem: Problem, settings: Mapping[str, Any], start: Iterate, times: Sequence[float], scheme: Scheme, threads: int
) -> Iterator[Snapshot]:
    """Yield a capsule at each of the times U t / l until it is steady, by a scheme of `transient`."""
    instants = transient(problem, start, times, scheme=scheme)
    while True:
        with threadpool_limits(limits=threads):  # not across the yield: the limit would be the caller's as well
            instant = next(instants, None)
        if instant is None:
            return
        shape = instant.iterate
        yield Snapshot(
            capillary_number=shape.capillary_number,
            size_ratio=shape.size_ratio,
            settings=settings,
            nodes=problem.mesh.expanded(shape.free)[problem.mesh.wedge],
            velocity_ratio=shape.velocity,
            time=instant.time,
            speed=instant.speed,
            slack=shape.slack,
        )


def save_series(series: Iterable[Snapshot], path: str | os.PathLike[str]) -> Path:
    """Write snapshots for ParaView: a ``.pvd`` file, and next to it a ``.vtu`` file for each time."""
    path = Path(path)
    if path.suffix != ".pvd":
        raise InputError(str(path), "", "a file name that ends in .pvd", repr(path.suffix))
    entries = []
    for number, snapshot in enumerate(series):
        file = snapshot.save(path.with_name(f"{path.stem}-{number:04d}.vtu"))
        entries.append(f'    <DataSet timestep="{snapshot.time:.9g}" file="{file.name}"/>')
    text = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    return write_file(path, text + "\n".join(entries) + "\n  </Collection>\n</VTKFile>\n")


# The simulator: steady shape and velocity of a capsule in a channel, from Ca and a/l

Start: TypeAlias = "SteadyState | Literal['rest', 'parachute']"


_FINEST = 32  # refinement, whose matrices of 4 n^2 + 2 nodes still fit into the memory of a workstation


@dataclass(frozen=True, eq=False)
class SteadyState(Shape):
    """A capsule that moves without changing its shape. Lengths over l, velocities over U, tensions over G_s.

    Attributes
    ----------
    capillary_number, size_ratio : float
        The case asked for [-].
    settings : mapping
        The simulator's settings.
    nodes : (w, 3) array [l]
        Nodes of the wedge 0 <= y <= x, or 0 <= x, y in a rectangle; the flow is along z, the centroid at the origin.
    velocity_ratio : float
        Velocity of the centroid V = v_o / U [-].
    inner_pressure : float
        Pressure inside, over that of the undisturbed flow at the centroid [mu U / l].
    extra_pressure_drop : float
        Pressure drop that the capsule adds to that of the undisturbed flow [mu U / l].
    principal_tensions : (N, 2) array [G_s]
        At all nodes, the larger first.
    residual : float
        Largest remaining velocity at a node [U] or error of volume or centroid [l^3, l^4].
    slack : float
        Uniform normal velocity that remains [U]: an indicator of the mesh's error.
    iterations : int
        Newton steps of the last solve.
    status : Status
        If it is not ``DONE``, the shape is that of the last steady state towards the case.
    detail : str
        Details of `status`.
    limit : float
        Where a branch of steady states ended in a fold, the Ca there; else NaN.
    wrinkling_rate : float
        In a circular tube the shape is axisymmetric: rate [U/l] at which fourfold wrinkles about its axis grow, if
        positive. NaN in other cross-sections and where the membrane is hardly compressed.
    along_ca : (f + 2,) array
        Derivative of shape, velocity and slack along Ca, for the start of a neighbouring case.
    """

    inner_pressure: float
    extra_pressure_drop: float
    principal_tensions: Floats
    residual: float
    slack: float
    iterations: int
    status: Status
    detail: str
    limit: float
    wrinkling_rate: float
    along_ca: Floats = field(repr=False)

    @property
    def point_data(self) -> dict[str, Floats]:
        """Principal tensions; see `Shape.point_data`."""
        names = ("larger principal tension / G_s", "smaller principal tension / G_s")
        return dict(zip(names, self.principal_tensions.T, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return status, case, settings and, if there is a steady state, its lengths and numbers, ready for JSON."""
        found: dict[str, Any] = {
            "status": self.status.name,
            "message": f"{self.status} {self.detail}".strip(),
            "capillary_number": self.capillary_number,
            "size_ratio": self.size_ratio,
            "settings": dict(self.settings),
            "residual": self.residual,
            "slack": self.slack,
        }
        if not self.status.ok:
            return found
        profile, silhouette = self.profile, self.silhouette
        return found | {
            "axial_extent": profile.axial_extent,
            "axial_length": profile.axial_length,
            "parachute_depth": profile.parachute_depth,
            "stretch_ratio": profile.stretch_ratio(self.size_ratio),
            "silhouette_extent": silhouette.axial_extent,
            "velocity_ratio": self.velocity_ratio,
            "inner_pressure": self.inner_pressure,
            "extra_pressure_drop": self.extra_pressure_drop,
            "minimum_tension": float(self.principal_tensions.min()),
            "maximum_tension": float(self.principal_tensions.max()),
            "wrinkling_rate": None if np.isnan(self.wrinkling_rate) else self.wrinkling_rate,
            "iterations": self.iterations,
        }


@dataclass(frozen=True)
class Simulator:
    """Boundary integrals for the liquids, finite elements for the membrane, Newton's method for the steady state.

    Parameters
    ----------
    law : MembraneLaw
        Law of the membrane.
    cross_section : str
        Cross-section of the channel: ``"square"``, ``"rectangular"`` or ``"circular"``; in the last, shapes are
        axisymmetric.
    refinement : int
        Elements along the edge of an octahedron's face, at least 4; 8 is good to about 0.3 % in L_z, 12 to 0.07 %.
    bending : float
        Bending stiffness over G_s a^2 [-]; regularises wrinkles where the membrane is compressed.
    pre_inflation : float
        Inflation alpha of the sphere at rest from its unstressed radius a / (1 + alpha) [-].
    corner_radius : float
        Radius of the corners of a square cross-section over l [-].
    section_aspect : float
        Depth of the cross-section along the direction of view over the width seen, b / l, of a rectangle or of a square
        that is not quite one, from 0.5 to 2 [-]; the first state is known to be found from 0.8 to 1.5.
    rest_aspect : float
        Axis of the shape at rest along the flow over that across, from 0.5 to 2 [-].
    walls : WallDiscretisation
        How finely the walls are represented.
    bending_energy : str
        ``"curvature"``: Koiter's energy of a shell, from its change of curvature; ``"displacement"``: the square of the
        Laplacian of the displacement from rest, which resists rotations as well.

    Examples
    --------
    >>> simulator = Simulator(refinement=4)
    >>> state = simulator.run(capillary_number=0.05, size_ratio=0.8)
    >>> print(state.status, round(state.velocity_ratio, 2), round(state.profile.axial_extent, 1))
    Done. 1.41 1.5

    References
    ----------
    Pozrikidis 1992, doi:10.1017/CBO9780511624124 (boundary integrals).
    Fairweather & Karageorghis 1998, doi:10.1023/A:1018981221740 (walls).
    """

    law: MembraneLaw = field(default_factory=NeoHookean)
    cross_section: str = "square"
    refinement: int = 8
    bending: float = 2e-4
    pre_inflation: float = 0.0
    corner_radius: float = 0.0
    section_aspect: float = 1.0
    rest_aspect: float = 1.0
    walls: WallDiscretisation = field(default_factory=WallDiscretisation)
    bending_energy: BendingEnergy = "displacement"

    def __post_init__(self) -> None:
        cross_section_named(self.cross_section, self.corner_radius, self.section_aspect)
        if self.refinement < 4:
            raise InputError("Simulator", "refinement", "at least 4", str(self.refinement))
        if self.refinement > _FINEST:
            raise InputError("Simulator", "refinement", f"at most {_FINEST}", str(self.refinement))
        for name in ("bending", "pre_inflation"):
            value = getattr(self, name)
            if not 0 <= value < 1:
                raise InputError("Simulator", name, "a number from 0 to 1", str(value))
        if self.bending_energy not in get_args(BendingEnergy):
            expected = f"one of {', '.join(get_args(BendingEnergy))}"
            raise InputError("Simulator", "bending_energy", expected, repr(self.bending_energy))
        if not 0.5 <= self.rest_aspect <= 2.0:
            raise InputError("Simulator", "rest_aspect", "a number from 0.5 to 2", str(self.rest_aspect))

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides the result, in types that JSON has, by the keys of databases."""
        settings = {
            "law": self.law.name,
            "cross_section": self.cross_section,
            "refinement": self.refinement,
            "bending": self.bending,
            "pre_inflation": self.pre_inflation,
            "corner_radius": self.corner_radius,
            "section_aspect": self.section_aspect,
            "rest_aspect": self.rest_aspect,
            "walls": asdict(self.walls),
        }
        # not stored: the databases that were made before there was another one keep their settings and their hash
        return settings if self.bending_energy == "displacement" else settings | {"bending_energy": self.bending_energy}

    def refined(self, refinement: int) -> Simulator:
        """Return the same simulator on another mesh."""
        return replace(self, refinement=refinement)

    @property
    def problem(self) -> Problem:
        """The discrete equations."""
        channel = cross_section_named(self.cross_section, self.corner_radius, self.section_aspect)
        rest = self.pre_inflation, self.rest_aspect
        return Problem(self.law, channel, self.refinement, self.bending, *rest, self.walls, self.bending_energy)

    def run(
        self, *, capillary_number: float, size_ratio: float, start: Start = "rest", threads: int = 1
    ) -> SteadyState:
        """Compute the steady state of one case.

        Parameters
        ----------
        capillary_number : float
            Ca = mu U / G_s (Eq. 1 of the paper), positive.
        size_ratio : float
            a/l, between 0.2 and 1.3.
        start : SteadyState or str
            ``"rest"``: the state that a capsule started from rest reaches. ``"parachute"``: the parachute, which at
            low Ca may be stable as well. A neighbouring steady state, of any mesh and membrane: the one on its branch,
            if that is stable, which is found some ten seconds faster; it is never sought from rest instead.
        threads : int
            Threads of the linear algebra.

        Returns
        -------
        SteadyState
            Its `status` tells whether there is one: above the limit of existence there is none.

        Raises
        ------
        InputError
            If the case is out of range.
        """
        _check("run", "capillary_number", capillary_number, 0.0, 10.0)
        _check("run", "size_ratio", size_ratio, 0.2, 1.3)
        if isinstance(start, str) and start not in ("rest", "parachute"):
            raise InputError("Simulator.run", "start", "'rest', 'parachute' or a SteadyState", repr(start))
        if not isinstance(start, str) and not start.status.ok:
            raise InputError("Simulator.run", "start", "a state that converged", start.status.name)
        with threadpool_limits(limits=threads):
            problem = self.problem
            if isinstance(start, str):
                find = parachute if start == "parachute" else reached_from_rest
                end = find(problem, capillary_number, size_ratio)
            elif dict(start.settings) == self.settings:
                end = followed(problem, self._as_start(problem, start), capillary_number, size_ratio)
            else:
                end = carried(problem, self._as_start(problem, start).iterate, capillary_number, size_ratio)
            return self.state(problem, end, capillary_number, size_ratio)

    def restored(self, values: Mapping[str, Any]) -> SteadyState:
        """Return the steady state whose fields have these values."""
        return SteadyState(**values)

    def transient(
        self,
        *,
        capillary_number: float,
        size_ratio: float,
        until: float,
        every: float = 0.1,
        start: Shape | None = None,
        scheme: Scheme = "semi-implicit",
        viscosity_ratio: float = 1.0,
        threads: int = 1,
    ) -> Iterator[Snapshot]:
        """Follow one capsule in time.

        Parameters
        ----------
        capillary_number : float
            Ca = mu U / G_s, positive.
        size_ratio : float
            a/l, between 0.2 and 1.3.
        until : float
            Time U t / l at which to end.
        every : float
            Time U dt / l between two snapshots.
        start : Snapshot or SteadyState, optional
            Shape at time 0; by default that at rest, squeezed to 0.95 of the width of the channel if it is wider.
        scheme : str
            ``"semi-implicit"``, or ``"explicit"``, whose steps are some twenty times shorter.
        viscosity_ratio : float
            Viscosity of the liquid inside over that outside [-]: 1.
        threads : int
            Threads of the linear algebra.

        Returns
        -------
        iterator of Snapshot
            The first is the start; the last is at `until`, or the one at which the capsule has become steady.

        Raises
        ------
        InputError
            If the case is out of range.
        CapsbayesError
            On the way, if the mesh becomes so distorted that no time step is short enough.
        """
        _check("transient", "capillary_number", capillary_number, 0.0, 10.0)
        _check("transient", "size_ratio", size_ratio, 0.2, 1.3)
        _check("transient", "until", until, 0.0, 1000.0)
        _check("transient", "every", every, 1e-5 * until, 1000.0)
        if scheme not in get_args(Scheme):
            raise InputError("Simulator.transient", "scheme", f"one of {', '.join(get_args(Scheme))}", repr(scheme))
        if viscosity_ratio != 1.0:
            expected = "1, because the double layer of liquids of unequal viscosities is not computed"
            advice = "the steady shape does not depend on it"
            raise InputError("Simulator.transient", "viscosity_ratio", expected, f"{viscosity_ratio:g}", advice)
        problem, case = self.problem, (capillary_number, size_ratio)
        first = problem.at_rest_in_channel(*case)
        if start is not None:
            first = replace(first, free=start.free_on(problem.mesh) * (size_ratio / start.size_ratio))
        times = [*np.arange(0.0, until - 1e-9, every), until]
        return snapshots(problem, self.settings, first, times, scheme, threads)

    def _as_start(self, problem: Problem, start: SteadyState) -> NewtonResult:
        """Return a steady state of this or another mesh as the start of a branch."""
        free = start.free_on(problem.mesh)
        along_ca = start.along_ca if start.mesh is problem.mesh else np.zeros(len(free) + 2)
        iterate = Iterate(free, start.velocity_ratio, start.slack, start.capillary_number, start.size_ratio)
        return NewtonResult(iterate, start.status.ok, start.residual, 0, along_ca)

    def state(self, problem: Problem, end: BranchEnd, capillary_number: float, size_ratio: float) -> SteadyState:
        """Return the steady state at the end of a branch of this simulator's problem."""
        result, iterate = end.result, end.result.iterate
        detail = ""
        if end.status in (Status.NO_STEADY_STATE, Status.NOT_CONVERGED, Status.UNSTABLE):
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
            status=end.status,
            detail=detail,
            limit=end.limit,
            wrinkling_rate=wrinkling_rate(problem, iterate) if end.status is Status.DONE else float("nan"),
            along_ca=result.tangent,
        )


def _check(method: str, name: str, value: float, above: float, below: float) -> None:
    if not above < value < below:
        raise InputError(f"Simulator.{method}", name, f"a number between {above:g} and {below:g}", f"{value:g}")


# A simulator of capsules that are not yet steady


@dataclass(frozen=True)
class UnsteadySimulator:
    """The shape of a capsule some time after it was put at rest into the flow.

    `unsteadiness` is the inverse of that time, l / (U t) [-], 0 for the steady shape; a negative one is refused.
    """

    simulator: Simulator = field(default_factory=Simulator)
    unsteadiness: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.unsteadiness < np.inf:
            raise InputError("UnsteadySimulator", "unsteadiness", "a number not below 0", str(self.unsteadiness))

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers."""
        return {**self.simulator.settings, "unsteadiness": self.unsteadiness}

    def refined(self, refinement: int) -> UnsteadySimulator:
        """Return the same simulator on another mesh."""
        return replace(self, simulator=self.simulator.refined(refinement))

    def restored(self, values: Mapping[str, Any]) -> SteadyState:
        """Return the steady state whose fields have these values."""
        return self.simulator.restored(values)

    def run(self, *, capillary_number: float, size_ratio: float, start: Start = "rest") -> SteadyState:
        """Compute the shape and velocity of one case; its residual is the speed of the fastest node [U]."""
        # `start` is that of the search for a steady shape; a capsule that is not yet steady comes from rest.
        if self.unsteadiness == 0.0:
            return self.simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=start)
        with threadpool_limits(limits=1):
            problem = self.simulator.problem
            first = problem.at_rest_in_channel(capillary_number, size_ratio)
            *_, end = transient(problem, first, [1.0 / self.unsteadiness])
            reached = NewtonResult(end.iterate, True, end.speed, 0, np.zeros(len(end.iterate.free) + 2))
            return self.simulator.state(problem, BranchEnd(reached, Status.DONE), capillary_number, size_ratio)
