"""Sensitivity: which input owns the interval of a capsule, and where in (Ca, a/l) a lab should measure."""

from capsbayes.sensitivity.budget import BudgetRow, ErrorBudget, error_budget
from capsbayes.sensitivity.design import FlowDesign, FlowPoint
from capsbayes.sensitivity.flow import flow_design
from capsbayes.sensitivity.identifiability import identifiability_map
from capsbayes.sensitivity.lab_errors import LabErrors
from capsbayes.sensitivity.simulated import SimulatedWidths, simulated_widths
from capsbayes.sensitivity.sobol import sobol_indices
from capsbayes.sensitivity.sobol_study import SobolIndex, SobolStudy
from capsbayes.sensitivity.spread import Spread

__all__ = [
    "BudgetRow",
    "ErrorBudget",
    "FlowDesign",
    "FlowPoint",
    "LabErrors",
    "SimulatedWidths",
    "SobolIndex",
    "SobolStudy",
    "Spread",
    "error_budget",
    "flow_design",
    "identifiability_map",
    "simulated_widths",
    "sobol_indices",
]
