"""Report: figures of results, as functions that return matplotlib's figures and axes."""

from capsbayes.report.corner_plot import corner_plot
from capsbayes.report.outline_plot import outline_figure, outline_plot

__all__ = ["corner_plot", "outline_figure", "outline_plot"]
