"""Report: figures of results, as functions that return matplotlib's figures and axes."""

from capsbayes.report.corner_plot import corner_plot
from capsbayes.report.outline_plot import outline_figure, outline_plot
from capsbayes.report.study_page import study_page
from capsbayes.report.study_words import lengths_alone, verdict_sentence

__all__ = ["corner_plot", "lengths_alone", "outline_figure", "outline_plot", "study_page", "verdict_sentence"]
