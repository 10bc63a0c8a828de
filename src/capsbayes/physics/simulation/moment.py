"""A capsule on its way: what a transient yields, and its files for ParaView."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.errors import InputError
from capsbayes.physics.simulation.problem import Iterate, Problem
from capsbayes.physics.simulation.shape import Shape
from capsbayes.physics.simulation.transient import Scheme, transient
from capsbayes.physics.surface.prolongation import prolonged

__all__ = ["Moment", "first_shape", "moments", "save_series"]

_CLEARANCE = 0.95  # of the channel's narrower half width, which a larger sphere is squeezed into


@dataclass(frozen=True, eq=False)
class Moment(Shape):
    """A capsule at one time of its way to the steady state. Lengths over l, velocities over U.

    Attributes
    ----------
    time : float
        U t / l [-].
    speed : float
        Of the fastest node, seen from the centroid [U]; it vanishes at steady state.
    slack : float
        Uniform normal velocity left over [U]: an indicator of the mesh's error.
    """

    time: float
    speed: float
    slack: float


def first_shape(problem: Problem, capillary_number: float, size_ratio: float, start: Shape | None = None) -> Iterate:
    """Where a transient starts: from `start` scaled to the size, or at rest, squeezed if it does not fit.

    A capsule wider than 0.95 of the channel becomes longer and narrower by one factor, at the same volume.
    """
    mesh, at_rest = problem.mesh, problem.at_rest(capillary_number, size_ratio)
    if start is not None:
        free = prolonged(start.mesh.reduced(start.nodes), start.mesh, mesh)
        return replace(at_rest, free=free * (size_ratio / start.size_ratio))
    nodes = mesh.expanded(at_rest.free)[mesh.wedge]
    wall, _ = problem.channel.outline(0.05, 0.0)
    narrowed = min(1.0, _CLEARANCE * float(np.min(np.hypot(*wall.T)) / np.max(np.abs(nodes[:, 0]))))
    return replace(at_rest, free=mesh.reduced(nodes * [narrowed, narrowed, narrowed**-2]))


def moments(
    problem: Problem, settings: Mapping[str, Any], start: Iterate, times: Sequence[float], scheme: Scheme, threads: int
) -> Iterator[Moment]:
    """The capsule at each of the `times` U t / l, until it is steady.

    Parameters
    ----------
    problem : Problem
    settings : mapping
        The simulator's settings.
    start : Iterate
        The capsule at time 0.
    times : sequence of float
    scheme : str
        See `transient`.
    threads : int
        Threads of the linear algebra.

    Yields
    ------
    Moment
    """
    instants = transient(problem, start, times, scheme=scheme)
    while True:
        with threadpool_limits(limits=threads):  # not across the yield: the limit is the caller's as well
            instant = next(instants, None)
        if instant is None:
            return
        shape = instant.iterate
        yield Moment(
            capillary_number=shape.capillary_number,
            size_ratio=shape.size_ratio,
            settings=settings,
            nodes=problem.mesh.expanded(shape.free)[problem.mesh.wedge],
            velocity_ratio=shape.velocity,
            time=instant.time,
            speed=instant.speed,
            slack=shape.slack,
        )


def save_series(moments: Iterable[Moment], path: str | os.PathLike[str]) -> Path:
    """Write moments for ParaView: a ``.pvd`` file, and beside it a ``.vtu`` file for each time."""
    path = Path(path)
    if path.suffix != ".pvd":
        raise InputError(str(path), "", "a file name that ends in .pvd", repr(path.suffix))
    entries = []
    for number, moment in enumerate(moments):
        file = moment.save(path.with_name(f"{path.stem}-{number:04d}.vtu"))
        entries.append(f'    <DataSet timestep="{moment.time:.9g}" file="{file.name}"/>')
    text = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    path.write_text(text + "\n".join(entries) + "\n  </Collection>\n</VTKFile>\n", encoding="utf-8")
    return path
