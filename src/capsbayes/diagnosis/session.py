"""Capsules measured in one session: one channel, one liquid, one camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.measurement import CONDITIONS, Measurement
from capsbayes.measurements import check_comparable, read_set, write_set
from capsbayes.quantity import Quantity

if TYPE_CHECKING:
    from capsbayes.infer.many import Population

_BIN = 4  # capsules of like size among which halves are drawn


@dataclass(frozen=True, eq=False)
class Session:
    """Capsules measured under the same conditions, except for the flow rate and the `conditions` of each.

    Parameters
    ----------
    measurements : sequence of Measurement
        Lengths over l; those with an outline are compared by it.
    experiment : Experiment
    left_out : tuple of str
        One line for each capsule that was measured and cannot be used.

    Raises
    ------
    InputError
        If there are no measurements, or one has no result or has lengths in metres.
    """

    measurements: Sequence[Measurement]
    experiment: Experiment
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.measurements:
            raise InputError("session", "measurements", "at least one capsule", "none")
        for number, measurement in enumerate(self.measurements):
            check_comparable(measurement, measurement.source or f"capsule {number}")

    @classmethod
    def read(cls, path: str | Path, experiment: Experiment | str | Path | None = None) -> Session:
        """Read a set of measurements.

        Parameters
        ----------
        path : path
            A folder of measurement files as `Measurement.read` reads them, a table of lengths (.csv), or a file of
            outlines (.nc). Capsules that cannot be used are in `left_out`.
        experiment : Experiment or path, optional
            Replaces the one that the set names.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        found = read_set(path, experiment)
        return cls(found.measurements, found.experiment, found.left_out)

    @classmethod
    def of(cls, given: Session | Population | str | Path) -> Session:
        """Return a session as it is; read the set of that path, or the one that a population was identified from.

        Raises
        ------
        InputError
            As `read`.
        """
        if isinstance(given, Session):
            return given
        if isinstance(given, (str, Path)):
            return cls.read(given)
        if not hasattr(given, "attributes"):
            expected = "a Session, a Population or a path"
            raise InputError("diagnose", "session", expected, f"one of the type {type(given).__name__}")
        stated = given.attributes["experiment"]
        half_width, viscosity = (Quantity(**stated[name]) for name in CONDITIONS)
        cross_section = stated.get("cross_section") or stated["section"]  # its name up to 0.1.0
        return cls.read(given.attributes["source"], Experiment(cross_section, half_width, viscosity))

    def write(self, path: str | Path) -> None:
        """Write a set that `read` reads.

        Parameters
        ----------
        path : path
            A folder, made if it is missing, for one file a capsule and ``experiment.toml``; or the name of a table of
            lengths (.csv) or of a file of outlines (.nc), which do not hold the experiment.

        Raises
        ------
        InputError
            If the folder holds TOML files already, or a file has no place for what the capsules have.
        """
        write_set(path, self.measurements, self.experiment)

    def __len__(self) -> int:
        return len(self.measurements)

    @cached_property
    def circumstances(self) -> dict[str, Floats]:
        """Conditions of each capsule on which effects may depend : dict of (n,) array, SI."""
        velocity = np.array([measurement.known_velocity.value for measurement in self.measurements])
        found = {"capsule_velocity": velocity}
        for name in CONDITIONS:
            usual = getattr(self.experiment, name).mean
            found[name] = np.array([measurement.conditions.get(name, usual) for measurement in self.measurements])
        if np.isfinite(self.flow_rates).any():
            found["flow_rate"] = self.flow_rates
        return found

    @cached_property
    def flow_rates(self) -> Floats:
        """Flow rates set at the pump : (n,) array [m^3/s], NaN where unknown."""
        return np.array(
            [np.nan if measurement.flow_rate is None else measurement.flow_rate for measurement in self.measurements]
        )

    @property
    def flow_rate_errors(self) -> Floats:
        """Relative standard errors of U = Q/A, by the flow rate and the half width, common to all : (n,) array."""
        rates = np.array([measurement.flow_rate_error or 0.0 for measurement in self.measurements]) / self.flow_rates
        width = self.experiment.half_width
        return np.hypot(rates, 2.0 * width.error / width.mean)

    @property
    def velocity_errors(self) -> Floats:
        """Relative standard errors of the capsules' velocities : (n,) array."""
        return np.array(
            [measurement.capsule_velocity_error / measurement.capsule_velocity for measurement in self.measurements]
        )

    def mean(self, name: str) -> float:
        """Return the mean of the half width [m] or of the viscosity [Pa s] over the capsules."""
        return float(self.circumstances[name].mean())

    def taken(self, rows: Any) -> Session:
        """Return a session of some of the capsules, given by an array of row numbers."""
        return Session([self.measurements[int(row)] for row in np.asarray(rows)], self.experiment)

    def halves(self, seed: int) -> tuple[Session, Session]:
        """Divide the capsules at random into halves of like sizes and velocities.

        Parameters
        ----------
        seed : int
            Seed of the random numbers.
        """
        rng = np.random.default_rng(seed)
        extent = np.array([measurement.axial_extent for measurement in self.measurements])
        order = np.lexsort((self.circumstances["capsule_velocity"], np.argsort(np.argsort(extent)) // _BIN))
        first: list[int] = []
        second: list[int] = []
        for start in range(0, len(order), 2):
            pair = rng.permutation(order[start : start + 2])
            first.append(int(pair[0]))
            second.extend(int(row) for row in pair[1:])
        return self.taken(sorted(first)), self.taken(sorted(second))
