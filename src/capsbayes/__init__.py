"""Shear modulus and radius of microcapsules from a picture, with honest credible intervals.

A capsule is simulated, the simulations are approximated, a picture is
measured, the measurement is identified, and what the model misses is
diagnosed. Public names are loaded when first used, so that importing the
package stays fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOME = {
    "Database": "capsbayes.database",
    "GeneralisedHooke": "capsbayes.membrane",
    "NeoHookean": "capsbayes.membrane",
    "Profile": "capsbayes.profile",
    "Simulator": "capsbayes.simulation",
    "Skalak": "capsbayes.membrane",
    "Status": "capsbayes.status",
    "SteadyState": "capsbayes.simulation",
    "Surrogate": "capsbayes.surrogate",
    "build_database": "capsbayes.simulation",
    "Experiment": "capsbayes.experiment",
    "MeasuredOutline": "capsbayes.measured_outline",
    "Hierarchy": "capsbayes.population",
    "Measurement": "capsbayes.measurement",
    "OutlineNoise": "capsbayes.measured_outline",
    "Population": "capsbayes.population",
    "Posterior": "capsbayes.inference",
    "Session": "capsbayes.discrepancy",
    "diagnose": "capsbayes.discrepancy",
    "hierarchy": "capsbayes.population",
    "identify": "capsbayes.inference",
    "identify_folder": "capsbayes.population",
    "measure": "capsbayes.image",
    "write_report": "capsbayes.report",
    "LabErrors": "capsbayes.sensitivity",
    "error_budget": "capsbayes.sensitivity",
    "flow_design": "capsbayes.sensitivity",
    "identifiability_map": "capsbayes.sensitivity",
    "sobol_indices": "capsbayes.sensitivity",
}

__all__ = [*sorted(_HOME), "__version__"]
__version__ = "0.1.0"

if TYPE_CHECKING:
    from capsbayes.database import Database
    from capsbayes.discrepancy import Session, diagnose
    from capsbayes.experiment import Experiment
    from capsbayes.image.measure import measure
    from capsbayes.inference import Posterior
    from capsbayes.inference.identify import identify
    from capsbayes.measured_outline import MeasuredOutline, OutlineNoise
    from capsbayes.measurement import Measurement
    from capsbayes.membrane import GeneralisedHooke, NeoHookean, Skalak
    from capsbayes.population import Hierarchy, Population
    from capsbayes.population.hierarchy import hierarchy
    from capsbayes.population.identify_folder import identify_folder
    from capsbayes.profile import Profile
    from capsbayes.report.write_report import write_report
    from capsbayes.sensitivity import LabErrors, error_budget, flow_design, identifiability_map, sobol_indices
    from capsbayes.simulation import Simulator, SteadyState, build_database
    from capsbayes.status import Status
    from capsbayes.surrogate import Surrogate


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'capsbayes' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
