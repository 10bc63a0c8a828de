"""Sensitivity to the inputs, and design of measurements: error budget, Sobol indices, map of widths, flow rate."""

from capsbayes.plan.budget import BudgetRow, ErrorBudget, SimulatedWidths, error_budget, simulated_widths
from capsbayes.plan.flow import FlowDesign, FlowPoint, flow_design
from capsbayes.plan.lab import LabErrors
from capsbayes.plan.map import identifiability_map
from capsbayes.plan.membrane import FlowRisk, MembraneFlowDesign, PlannedFlows, membrane_flow_design, membrane_map
from capsbayes.plan.sobol import SobolIndex, SobolStudy, sobol_indices, varied_range

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
