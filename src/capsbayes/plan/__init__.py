"""Sensitivity to the inputs, and design of measurements: error budget, Sobol indices, map of widths, flow rate."""

from capsbayes.plan.budget import BudgetRow, ErrorBudget, error_budget
from capsbayes.plan.design import FlowDesign, FlowPoint
from capsbayes.plan.flow import flow_design
from capsbayes.plan.identifiability import identifiability_map
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.membrane_design import FlowRisk, MembraneFlowDesign, PlannedFlows
from capsbayes.plan.membrane_flow import membrane_flow_design
from capsbayes.plan.membrane_map import membrane_map
from capsbayes.plan.simulated import SimulatedWidths, simulated_widths
from capsbayes.plan.sobol import sobol_indices, varied_range
from capsbayes.plan.sobol_study import SobolIndex, SobolStudy

__all__ = [
    "BudgetRow",
    "ErrorBudget",
    "FlowDesign",
    "FlowPoint",
    "FlowRisk",
    "LabErrors",
    "MembraneFlowDesign",
    "PlannedFlows",
    "SimulatedWidths",
    "SobolIndex",
    "SobolStudy",
    "error_budget",
    "flow_design",
    "identifiability_map",
    "membrane_flow_design",
    "membrane_map",
    "simulated_widths",
    "sobol_indices",
    "varied_range",
]
