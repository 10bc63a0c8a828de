"""Report: figures of results, as functions that return matplotlib's figures and axes, and pages that hold them."""

from capsbayes.report.corner_plot import corner_plot
from capsbayes.report.outline_plot import outline_figure, outline_plot
from capsbayes.report.spread import Spread
from capsbayes.report.study_page import study_page
from capsbayes.report.study_words import lengths_alone, verdict_sentence
from capsbayes.report.write_report import opened, write_report

__all__ = [
    "Spread",
    "corner_plot",
    "lengths_alone",
    "opened",
    "outline_figure",
    "outline_plot",
    "study_page",
    "verdict_sentence",
    "write_report",
]
