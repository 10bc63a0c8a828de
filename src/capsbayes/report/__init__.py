"""Report: figures of results, as functions that return matplotlib's figures and axes, and pages that hold them."""

from capsbayes.report.budget_plot import budget_figure
from capsbayes.report.corner_plot import corner_plot
from capsbayes.report.flow_plot import flow_figure
from capsbayes.report.identifiability_plot import identifiability_figure
from capsbayes.report.outline_plot import outline_figure, outline_plot
from capsbayes.report.sobol_plot import sobol_figure
from capsbayes.report.spread import Spread
from capsbayes.report.study_page import study_page
from capsbayes.report.study_words import lengths_alone, verdict_sentence
from capsbayes.report.write_report import opened, write_report

__all__ = [
    "Spread",
    "budget_figure",
    "corner_plot",
    "flow_figure",
    "identifiability_figure",
    "lengths_alone",
    "opened",
    "outline_figure",
    "outline_plot",
    "sobol_figure",
    "study_page",
    "verdict_sentence",
    "write_report",
]
