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
    "GeneralisedHooke": "capsbayes.physics.membrane",
    "NeoHookean": "capsbayes.physics.membrane",
    "Profile": "capsbayes.profile",
    "Simulator": "capsbayes.physics.simulation",
    "Skalak": "capsbayes.physics.membrane",
    "Status": "capsbayes.status",
    "SteadyState": "capsbayes.physics.simulation",
    "Surrogate": "capsbayes.surrogate",
    "build_database": "capsbayes.physics.databases",
    "Experiment": "capsbayes.experiment",
    "MeasuredOutline": "capsbayes.measured_outline",
    "Hierarchy": "capsbayes.infer.many",
    "Measurement": "capsbayes.measurement",
    "OutlineNoise": "capsbayes.measured_outline",
    "Population": "capsbayes.infer.many",
    "Posterior": "capsbayes.infer",
    "Session": "capsbayes.diagnosis",
    "diagnose": "capsbayes.diagnosis",
    "hierarchy": "capsbayes.infer.many",
    "identify": "capsbayes.infer",
    "identify_folder": "capsbayes.infer.many",
    "measure": "capsbayes.image",
    "write_report": "capsbayes.show",
    "LabErrors": "capsbayes.plan",
    "error_budget": "capsbayes.plan",
    "flow_design": "capsbayes.plan",
    "identifiability_map": "capsbayes.plan",
    "sobol_indices": "capsbayes.plan",
}

__all__ = [*sorted(_HOME), "__version__"]
__version__ = "0.1.0"

if TYPE_CHECKING:
    from capsbayes.database import Database
    from capsbayes.diagnosis import Session, diagnose
    from capsbayes.experiment import Experiment
    from capsbayes.image.measure import measure
    from capsbayes.infer import Posterior
    from capsbayes.infer.identify import identify
    from capsbayes.infer.many import Hierarchy, Population
    from capsbayes.infer.many.hierarchy import hierarchy
    from capsbayes.infer.many.identify_folder import identify_folder
    from capsbayes.measured_outline import MeasuredOutline, OutlineNoise
    from capsbayes.measurement import Measurement
    from capsbayes.physics.databases import build_database
    from capsbayes.physics.membrane import GeneralisedHooke, NeoHookean, Skalak
    from capsbayes.physics.simulation import Simulator, SteadyState
    from capsbayes.plan import LabErrors, error_budget, flow_design, identifiability_map, sobol_indices
    from capsbayes.profile import Profile
    from capsbayes.show.write_report import write_report
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
