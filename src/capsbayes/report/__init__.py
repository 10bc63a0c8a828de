"""Presentation of results: sentences, tables for terminal and page, figures, and pages. Results know nothing of it."""

import importlib
from typing import Any

_HOMES = {
    "budget_figure": "plan",
    "corner_plot": "posterior_figures",
    "flow_figure": "plan",
    "identifiability_figure": "plan",
    "opened": "write",
    "outline_figure": "posterior_figures",
    "outline_plot": "posterior_figures",
    "sobol_figure": "plan",
    "study_page": "study_figures",
    "verdict_sentence": "study",
    "write_report": "write",
}
"""Module of each public name; it is imported when the name is first used, for a table needs no page."""

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
