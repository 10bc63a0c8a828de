"""A simulator without physics: shapes in closed form, for tests of how databases are built.

Its steady states depend, in the last digits, on the state they were started
from, as those of an iterative solver do.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass

import numpy as np

from capsbayes.physics.build import build_database
from capsbayes.profile import Profile
from capsbayes.status import Status

CASES = [(ca, size) for size in (0.8, 0.9, 1.0) for ca in (0.01, 0.02, 0.03, 0.05, 0.06, 0.08, 0.1, 0.12)]


@dataclass(frozen=True)
class AnalyticState:
    capillary_number: float
    size_ratio: float
    nodes: np.ndarray
    principal_tensions: np.ndarray
    memory: float
    status: Status
    velocity_ratio: float = 1.3
    inner_pressure: float = 2.0
    extra_pressure_drop: float = 0.1
    wrinkling_rate: float = float("nan")
    residual: float = 1e-9
    slack: float = 1e-5
    iterations: int = 4
    limit: float = np.nan
    parachute: bool = False

    @property
    def profile(self):
        angle = np.linspace(0.0, np.pi, 101)
        depth = 1.5 + 3.0 * self.capillary_number
        z = np.cos(angle) + (depth * (1 - np.cos(angle)) ** 2 / 4 if self.parachute else 0.0) + self.memory
        return Profile.from_half(np.stack([self.size_ratio * z, self.size_ratio * np.sin(angle)], axis=1))

    @property
    def surface_nodes(self):
        return self.nodes

    @property
    def silhouette(self):
        return self.profile.scaled(1.01)


@dataclass(frozen=True)
class AnalyticSimulator:
    """Steady states exist up to Ca = `limit` - 0.1 (a/l), and from `lowest` on.

    Below Ca = `snap` there is another branch, that of a capsule at rest. Where it ends, or from `kicked` on, a capsule
    from rest jumps to the parachutes, or is lost. Each run is noted as a line in the file `journal`; the case `bad`
    raises.
    """

    limit: float = 0.175
    lowest: float = 0.0
    snap: float = 0.0
    kicked: float = 0.0
    jumps: bool = True
    bad: tuple[float, float] | None = None
    journal: str = ""
    seconds: float = 0.0
    refinement: int = 8

    @property
    def settings(self):
        mesh = {"refinement": self.refinement, "bending": 2e-4, "pre_inflation": 0.0}
        return {"law": "none", "cross_section": "square"} | mesh

    def restored(self, values):
        return AnalyticState(**values)

    def run(self, *, capillary_number, size_ratio, start="rest"):
        if self.journal:
            with open(self.journal, "a") as lines:
                lines.write(f"{size_ratio} {capillary_number} {getattr(start, 'capillary_number', start)}\n")
        time.sleep(self.seconds)
        if (capillary_number, size_ratio) == self.bad:
            raise FloatingPointError("no inverse")
        origin = 0.0 if isinstance(start, str) else start.memory + 1e-3 * start.capillary_number
        if start == "rest":
            parachute = self.jumps and capillary_number >= (self.kicked or self.snap)
        else:
            parachute = start == "parachute" or start.parachute
        end = self.limit - 0.1 * size_ratio if parachute else self.snap
        status, limit = Status.DONE, np.nan
        if capillary_number > end:
            status, limit = Status.NO_STEADY_STATE, end
        elif capillary_number < self.lowest:
            status = Status.NOT_CONVERGED
        nodes = np.random.default_rng(int(1e6 * capillary_number)).random((6, 3)) + origin
        place = capillary_number, size_ratio
        return AnalyticState(*place, nodes, nodes[:, :2], origin / np.pi, status, limit=limit, parachute=parachute)


def main():
    """Build with two workers: ``python -c "import analytic_simulator as a; a.main()" OUT JOURNAL``."""
    out, journal = sys.argv[1:]
    build_database(AnalyticSimulator(journal=journal, seconds=0.05), CASES, out=out, workers=2)
    os.replace(journal, f"{journal}.whole")
