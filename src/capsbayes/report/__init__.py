"""Presentation of results: sentences, tables for terminal and page, figures, and pages. Results know nothing of it."""

import importlib
from typing import Any

_NAMES = {
    "plan": ("budget_figure", "flow_figure", "identifiability_figure", "sobol_figure"),
    "posterior_figures": ("corner_plot", "outline_figure", "outline_plot"),
    "study": ("verdict_sentence",),
    "study_figures": ("study_page",),
    "write": ("opened", "write_report"),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}
"""Module of each public name; it is imported when the name is first used, for a table needs no page."""

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
