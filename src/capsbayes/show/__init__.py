"""Presentation of results: sentences, tables for terminal and page, figures, and pages. Results know nothing of it."""

from capsbayes.show.figures.corner import corner_plot
from capsbayes.show.figures.identifiability import identifiability_figure
from capsbayes.show.figures.outline import outline_figure, outline_plot
from capsbayes.show.figures.plan import budget_figure, flow_figure, sobol_figure
from capsbayes.show.pages.study import study_page
from capsbayes.show.report import opened, write_report
from capsbayes.show.words.study import verdict_sentence

__all__ = [
    "budget_figure",
    "corner_plot",
    "flow_figure",
    "identifiability_figure",
    "opened",
    "outline_figure",
    "outline_plot",
    "sobol_figure",
    "study_page",
    "verdict_sentence",
    "write_report",
]
