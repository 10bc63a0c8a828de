"""Presentation of results: sentences, tables for terminal and page, figures, and pages. Results know nothing of it."""

import importlib
from typing import Any

_HOMES = {
    "budget_figure": "figures.plan",
    "corner_plot": "figures.corner",
    "flow_figure": "figures.plan",
    "identifiability_figure": "figures.identifiability",
    "opened": "report",
    "outline_figure": "figures.outline",
    "outline_plot": "figures.outline",
    "sobol_figure": "figures.plan",
    "study_page": "pages.study",
    "verdict_sentence": "words.study",
    "write_report": "report",
}
"""Module of each public name; it is imported when the name is first used, for a table needs no page."""

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
