"""Report: figures of results, as functions that return matplotlib's figures and axes, and pages that hold them."""

from capsbayes.show.budget_plot import budget_figure
from capsbayes.show.corner_plot import corner_plot
from capsbayes.show.flow_plot import flow_figure
from capsbayes.show.identifiability_plot import identifiability_figure
from capsbayes.show.outline_plot import outline_figure, outline_plot
from capsbayes.show.sobol_plot import sobol_figure
from capsbayes.show.spread import Spread
from capsbayes.show.study_page import study_page
from capsbayes.show.study_words import lengths_alone, verdict_sentence
from capsbayes.show.write_report import opened, write_report

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
