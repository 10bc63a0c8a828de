"""The membrane of a batch: its posterior, the capsules, and the odds of known laws."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes import __version__
from capsbayes.arrays import Floats, Integers
from capsbayes.experiment import Experiment
from capsbayes.files.output_file import write_dataset
from capsbayes.infer.checks import Gate
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.posterior import width_over_prior
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

if TYPE_CHECKING:
    import xarray as xr

EACH = ("surface_shear_modulus", "capsule_radius", "capillary_number", "pre_inflation")
PREDICTED = ("axial_extent", "axial_length", "velocity_ratio")
"""Quantities of each capsule, and what is predicted of it: their draws are named with ``_each``."""

_POPULATION = ("surface_shear_modulus", "modulus_spread", "capsule_radius", "radius_spread", "inflation_spread")


@dataclass(frozen=True, eq=False)
class LawOdds:
    """What speaks for a law.

    Parameters
    ----------
    name : str
    probability : float
        Among the laws that were tried, if all are as likely before.
    log_error : float
        Standard error of the logarithm of its evidence.
    usable : bool
        Whether its gates passed.
    draws : mapping of arrays
        As of `SharedMembrane`, if the membrane obeys it.
    """

    name: str
    probability: float
    log_error: float
    usable: bool
    draws: Mapping[str, Floats]


@dataclass(frozen=True, eq=False, repr=False)
class SharedMembrane(Readable):
    """Posterior of the membrane that the capsules of a batch share.

    Parameters
    ----------
    draws : mapping of arrays
        The parameters of the membrane by name, ``surface_shear_modulus`` and ``capsule_radius``, means of the
        population (of ln G_s and of a) in SI, ``modulus_spread`` and ``radius_spread``, relative : (d,) arrays; and
        for n capsules each of `EACH` and `PREDICTED` with ``_each`` : (d, n) arrays. If the pre-inflation varies,
        that of the membrane is its median, and ``inflation_spread`` and ``pre_inflation_each`` are there too.
    names : tuple of str
        Of the capsules.
    flow : (n,) array
        Number of the flow of each capsule, slow to fast.
    speed : (n,) array [m/s]
        Mean velocity by the flow rate, or velocity of the capsule where none was given.
    lengths : (n, 2) array [l]
        L_z and L_a as measured, NaN where L_a was not.
    misfit : (n,) array
        Root mean square difference of each shape in standard errors.
    laws : tuple of LawOdds
        The general law first; empty if not asked for.
    prior : mapping of str to Quantity
        Of the parameters of the membrane that are not known.
    experiment : Experiment
    model_name, model_sha256 : str
    seed : int
    gates : tuple of Gate
    status : Status
    """

    draws: Mapping[str, Floats]
    names: tuple[str, ...]
    flow: Integers
    speed: Floats
    lengths: Floats
    misfit: Floats
    laws: tuple[LawOdds, ...]
    prior: Mapping[str, Quantity]
    experiment: Experiment
    model_name: str
    model_sha256: str
    seed: int
    gates: tuple[Gate, ...]
    status: Status

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def marginals(self) -> dict[str, Marginal]:
        """Summaries of the population and of the parameters of the membrane, by name."""
        return {name: Marginal.of_draws(self.draws[name]) for name in (*_POPULATION, *self.prior) if name in self.draws}

    def of_each(self, name: str) -> list[Marginal]:
        """Return the summaries of one of `EACH` for the capsules."""
        return [Marginal.of_draws(values) for values in self.draws[f"{name}_each"].T]

    def widths_over_prior(self) -> dict[str, float]:
        """Return the width of the 68 % interval of each parameter of the membrane over that of its prior.

        As `Posterior.widths_over_prior`.
        """
        return {name: width_over_prior(self.marginals[name], prior) for name, prior in self.prior.items()}

    def moduli_by_flow(self, draws: Mapping[str, Floats] | None = None) -> list[Marginal]:
        """Return the mean G_s [N/m] of the capsules of each flow, slow to fast.

        Under the right law it is the same for all flows.

        Parameters
        ----------
        draws : mapping, optional
            Draws under one of the `laws`; by default `draws`.
        """
        logs = np.log((draws or self.draws)["surface_shear_modulus_each"])
        return [Marginal.of_draws(np.exp(logs[:, self.flow == k].mean(axis=1))) for k in range(self.flow.max() + 1)]

    def described(self) -> dict[str, str]:
        """Return medians and 95 % intervals in display units, and the status."""
        found = {"capsules": str(len(self))}
        for name, marginal in self.marginals.items():
            known = PARAMETERS[name]
            low, middle, high = map(known.shown, (marginal.lower_95, marginal.median, marginal.upper_95))
            found[name] = f"{middle:.4g} [{low:.4g}, {high:.4g}] {known.shown_unit}".removesuffix(" -")
        return found | {"status": self.status.name}

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the draws, ready for JSON."""
        each = {name: self.of_each(name) for name in EACH if f"{name}_each" in self.draws}
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "quantities": {name: marginal.as_dict() for name, marginal in self.marginals.items()},
            "widths_over_prior": self.widths_over_prior(),
            "laws": [self._of_law(law) for law in self.laws],
            "flows": self._of_flows(),
            "capsules": [
                {
                    "name": name,
                    "flow": int(self.flow[number]) + 1,
                    "misfit": float(self.misfit[number]),
                    **{quantity: summaries[number].as_dict() for quantity, summaries in each.items()},
                }
                for number, name in enumerate(self.names)
            ],
            "gates": [gate.as_dict() for gate in self.gates],
            "prior": {name: str(quantity) for name, quantity in self.prior.items()},
            "experiment": {name: str(text) for name, text in self.experiment.described().items()},
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            "seed": self.seed,
            "version": __version__,
        }

    def _of_law(self, law: LawOdds) -> dict[str, Any]:
        return {
            "name": law.name,
            "probability": law.probability,
            "log_error": law.log_error,
            "usable": law.usable,
            "surface_shear_modulus": Marginal.of_draws(law.draws["surface_shear_modulus"]).as_dict(),
            "by_flow": [marginal.as_dict() for marginal in self.moduli_by_flow(law.draws)],
        }

    def _of_flows(self) -> list[dict[str, Any]]:
        moduli = self.moduli_by_flow()
        return [
            {
                "speed": float(np.median(self.speed[self.flow == number])),
                "capsules": int(np.sum(self.flow == number)),
                "misfit": float(np.sqrt(np.mean(self.misfit[self.flow == number] ** 2))),
                "surface_shear_modulus": marginal.as_dict(),
            }
            for number, marginal in enumerate(moduli)
        ]

    def dataset(self) -> xr.Dataset:
        """Return draws and summary as a dataset."""
        import xarray as xr

        dims: dict[int, tuple[str, ...]] = {1: ("draw",), 2: ("draw", "capsule")}
        variables = {name: (dims[values.ndim], values) for name, values in self.draws.items()}
        capsules = {"name": list(self.names), "flow": self.flow, "speed": self.speed, "rms_misfit": self.misfit}
        along = {name: (("capsule",), values) for name, values in capsules.items()}
        return xr.Dataset({**variables, **along}, attrs={"summary": json.dumps(self.as_dict())})

    def write(self, path: str | Path) -> Path:
        """Write one NetCDF file: whole or not at all."""
        return write_dataset(Path(path), self.dataset())
