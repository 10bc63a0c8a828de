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
    "Hierarchy": "capsbayes.infer.hierarchy",
    "LabErrors": "capsbayes.plan",
    "MeasuredOutline": "capsbayes.measurement",
    "Measurement": "capsbayes.measurement",
    "Membrane": "capsbayes.infer",
    "MembraneSurrogate": "capsbayes.surrogate",
    "NeoHookean": "capsbayes.physics.membrane",
    "OutlineNoise": "capsbayes.measurement",
    "Population": "capsbayes.infer.population",
    "Posterior": "capsbayes.infer",
    "Prior": "capsbayes.infer",
    "Profile": "capsbayes.profile",
    "Quantity": "capsbayes.quantity",
    "Refinement": "capsbayes.refinement",
    "Session": "capsbayes.diagnosis",
    "SharedMembrane": "capsbayes.infer.shared_membrane",
    "Simulator": "capsbayes.physics.simulator",
    "Skalak": "capsbayes.physics.membrane",
    "Status": "capsbayes.status",
    "SteadyState": "capsbayes.physics.simulator",
    "Study": "capsbayes.diagnosis",
    "Surrogate": "capsbayes.surrogate",
    "build_database": "capsbayes.physics.build",
    "diagnose": "capsbayes.diagnosis",
    "error_budget": "capsbayes.plan",
    "flow_design": "capsbayes.plan",
    "hierarchy": "capsbayes.infer.hierarchy",
    "identifiability_map": "capsbayes.plan",
    "identify": "capsbayes.infer",
    "identify_folder": "capsbayes.infer.batch",
    "identify_membrane": "capsbayes.infer.shared_membrane",
    "measure": "capsbayes.image",
    "measure_film": "capsbayes.image.film",
    "membrane_flow_design": "capsbayes.plan",
    "resimulate": "capsbayes.resimulation",
    "refine_model": "capsbayes.refinement",
    "sobol_indices": "capsbayes.plan",
    "write_report": "capsbayes.report",
}
_ROOMS = ("effects", "surrogate", "testing")  # as in cb.effects.catalogue()

__all__ = [*sorted(_HOME), *_ROOMS, "__version__"]
__version__ = "0.1.0"

if TYPE_CHECKING:
    from capsbayes import effects, surrogate, testing
    from capsbayes.database import Database
    from capsbayes.diagnosis import Session, Study, diagnose
    from capsbayes.experiment import Experiment
    from capsbayes.image.film import measure_film
    from capsbayes.image.measure import measure
    from capsbayes.infer import Membrane, Posterior, Prior
    from capsbayes.infer.batch import identify_folder
    from capsbayes.infer.hierarchy import Hierarchy, hierarchy
    from capsbayes.infer.identify import identify
    from capsbayes.infer.population import Population
    from capsbayes.infer.shared_membrane import SharedMembrane, identify_membrane
    from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
    from capsbayes.physics.build import build_database
    from capsbayes.physics.membrane import GeneralisedHooke, NeoHookean, Skalak
    from capsbayes.physics.simulator import Simulator, SteadyState
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
    from capsbayes.refinement import Refinement, refine_model
    from capsbayes.report.write import write_report
    from capsbayes.resimulation import resimulate
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
