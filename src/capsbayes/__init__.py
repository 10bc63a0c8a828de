"""Shear modulus and radius of microcapsules from a picture, with honest credible intervals.

A capsule is simulated, the simulations are approximated, a picture is measured, the measurement is identified, and what
the model misses is diagnosed. Public names are loaded when first used, so that importing the package stays fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from capsbayes.files.numba_folder import provide_numba_folder

provide_numba_folder()

_NAMES = {
    "database": ("Database",),
    "diagnosis": ("Session", "Study", "diagnose"),
    "experiment": ("Experiment",),
    "image": ("measure",),
    "image.film": ("measure_film",),
    "infer": ("Membrane", "Posterior", "Prior", "identify"),
    "infer.batch": ("identify_folder",),
    "infer.hierarchy": ("Hierarchy", "hierarchy"),
    "infer.population": ("Population",),
    "infer.shared_membrane": ("SharedMembrane", "identify_membrane"),
    "measurement": ("MeasuredOutline", "Measurement", "OutlineNoise"),
    "physics.build": ("build_database",),
    "physics.membrane": ("GeneralisedHooke", "NeoHookean", "Skalak"),
    "physics.simulator": ("Simulator", "SteadyState"),
    "plan": (
        "LabErrors",
        "error_budget",
        "flow_design",
        "identifiability_map",
        "membrane_flow_design",
        "sobol_indices",
    ),
    "profile": ("Profile",),
    "quantity": ("Quantity",),
    "refinement": ("Refinement", "refine_model"),
    "report": ("write_report",),
    "resimulation": ("resimulate",),
    "status": ("Status",),
    "surrogate": ("MembraneSurrogate", "Surrogate"),
}
_HOME = {name: f"capsbayes.{home}" for home, names in _NAMES.items() for name in names}
_ROOMS = ("effects", "surrogate", "testing")  # as in cb.effects.catalogue()

__all__ = [*sorted(_HOME), *_ROOMS, "__version__"]
__version__ = "0.2.0"

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
