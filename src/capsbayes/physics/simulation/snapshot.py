"""Snapshots of a transient, and their files for ParaView."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from capsbayes.errors import InputError
from capsbayes.files.output_file import write_file
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.transient import Scheme, transient
from capsbayes.physics.simulation.shape import Shape
from capsbayes.physics.surface.octasphere import prolonged


@dataclass(frozen=True, eq=False)
class Snapshot(Shape):
    """A capsule at one time of a transient. Lengths over l, velocities over U."""

    time: float  # U t / l
    speed: float  # of the fastest node relative to the centroid; it vanishes at steady state
    slack: float  # uniform normal velocity that remains: an indicator of the mesh's error


def taken_from(start: Shape, problem: Problem, capillary_number: float, size_ratio: float) -> Iterate:
    """Return a shape of any mesh, scaled to a size, as the start of a transient."""
    at_rest = problem.at_rest(capillary_number, size_ratio)
    free = prolonged(start.mesh.reduced(start.nodes), start.mesh, problem.mesh)
    return replace(at_rest, free=free * (size_ratio / start.size_ratio))


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
