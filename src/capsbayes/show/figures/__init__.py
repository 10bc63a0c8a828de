"""Figures of results, one file a subject, in one style; functions return figures and axes of matplotlib."""
