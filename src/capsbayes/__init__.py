"""Shear modulus and radius of microcapsules from a picture, with honest credible intervals.

A capsule is simulated, the simulations are approximated, a picture is
measured, the measurement is identified, and what the model misses is
diagnosed. Public names are loaded when first used, so that importing the
package stays fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from capsbayes.files.numba_folder import provide_numba_folder

provide_numba_folder()

_HOME = {
    "Database": "capsbayes.database",
    "Experiment": "capsbayes.experiment",
    "GeneralisedHooke": "capsbayes.physics.membrane",
    "Hierarchy": "capsbayes.infer.many",
    "LabErrors": "capsbayes.plan",
    "MeasuredOutline": "capsbayes.measured_outline",
    "Measurement": "capsbayes.measurement",
    "Membrane": "capsbayes.infer",
    "MembraneSurrogate": "capsbayes.surrogate",
    "NeoHookean": "capsbayes.physics.membrane",
    "OutlineNoise": "capsbayes.measured_outline",
    "Population": "capsbayes.infer.many",
    "Posterior": "capsbayes.infer",
    "Prior": "capsbayes.infer",
    "Profile": "capsbayes.profile",
    "Quantity": "capsbayes.quantity",
    "Session": "capsbayes.diagnosis",
    "SharedMembrane": "capsbayes.infer.many",
    "Simulator": "capsbayes.physics.simulation",
    "Skalak": "capsbayes.physics.membrane",
    "Status": "capsbayes.status",
    "SteadyState": "capsbayes.physics.simulation",
    "Study": "capsbayes.diagnosis",
    "Surrogate": "capsbayes.surrogate",
    "build_database": "capsbayes.physics.databases",
    "diagnose": "capsbayes.diagnosis",
    "error_budget": "capsbayes.plan",
    "flow_design": "capsbayes.plan",
    "hierarchy": "capsbayes.infer.many",
    "identifiability_map": "capsbayes.plan",
    "identify": "capsbayes.infer",
    "identify_folder": "capsbayes.infer.many",
    "identify_membrane": "capsbayes.infer.many",
    "measure": "capsbayes.image",
    "measure_film": "capsbayes.image.measure_film",
    "membrane_flow_design": "capsbayes.plan",
    "sobol_indices": "capsbayes.plan",
    "write_report": "capsbayes.show",
}
_ROOMS = ("effects", "surrogate", "testing")  # as in cb.effects.catalogue()

__all__ = [*sorted(_HOME), *_ROOMS, "__version__"]
__version__ = "0.1.0"

if TYPE_CHECKING:
    from capsbayes import effects, surrogate, testing
    from capsbayes.database import Database
    from capsbayes.diagnosis import Session, Study, diagnose
    from capsbayes.experiment import Experiment
    from capsbayes.image.measure import measure
    from capsbayes.image.measure_film import measure_film
    from capsbayes.infer import Membrane, Posterior, Prior
    from capsbayes.infer.identify import identify
    from capsbayes.infer.many import Hierarchy, Population, SharedMembrane
    from capsbayes.infer.many.distribution.hierarchy import hierarchy
    from capsbayes.infer.many.identify_folder import identify_folder
    from capsbayes.infer.many.one_membrane.identify_membrane import identify_membrane
    from capsbayes.measured_outline import MeasuredOutline, OutlineNoise
    from capsbayes.measurement import Measurement
    from capsbayes.physics.databases import build_database
    from capsbayes.physics.membrane import GeneralisedHooke, NeoHookean, Skalak
    from capsbayes.physics.simulation import Simulator, SteadyState
    from capsbayes.plan import (
        LabErrors,
        error_budget,
        flow_design,
        identifiability_map,
        membrane_flow_design,
        sobol_indices,
    )
    from capsbayes.profile import Profile
    from capsbayes.quantity import Quantity
    from capsbayes.show.report import write_report
    from capsbayes.status import Status
    from capsbayes.surrogate import MembraneSurrogate, Surrogate


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'capsbayes' has no attribute {name!r}")
    if name in _ROOMS:
        return importlib.import_module(f"capsbayes.{name}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
