"""The cases that databases cover by default, dense at low capillary number."""

from __future__ import annotations

import os
from pathlib import Path

from capsbayes.files.csv_file import read_numbers

Case = tuple[float, float]
Cases = list[Case]
"""Capillary numbers and size ratios."""

# fmt: off
_CAPILLARY_NUMBERS = (
    0.003, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.025, 0.03, 0.035, 0.04,
    0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12, 0.135, 0.15,
)
# fmt: on
_HIGHER = (0.175, 0.2, 0.25, 0.3)  # where laws that stiffen still have steady states
_OF_EFFECTS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.115, 0.13)


def default_grid() -> Cases:
    """Return cases (Ca, a/l) with a/l from 0.70 to 1.15 by 0.025 and Ca from 0.003 to 0.15, sorted by a/l.

    >>> len(default_grid()), default_grid()[0], default_grid()[-1]
    (418, (0.003, 0.7), (0.15, 1.15))
    """
    return _grid(_CAPILLARY_NUMBERS, 0.7, 0.025, 19)


def wide_grid() -> Cases:
    """Return the cases of `default_grid` at every second size ratio."""
    return _grid(_CAPILLARY_NUMBERS, 0.7, 0.05, 10)


def stiffening_grid() -> Cases:
    """Return the cases of `wide_grid`, and Ca up to 0.3."""
    return _grid(_CAPILLARY_NUMBERS + _HIGHER, 0.7, 0.05, 10)


def effect_grid() -> Cases:
    """Return cases (Ca, a/l) with a/l from 0.75 to 1.05 by 0.05 and Ca from 0.02 to 0.13."""
    return _grid(_OF_EFFECTS, 0.75, 0.05, 7)


def parachute_grid() -> Cases:
    """Return the cases of `effect_grid` from Ca = 0.03 on, where the shape reached from rest is not sought in time."""
    return [(capillary_number, size_ratio) for capillary_number, size_ratio in effect_grid() if capillary_number > 0.02]


def _grid(capillary_numbers: tuple[float, ...], first: float, step: float, count: int) -> Cases:
    size_ratios = [round(first + step * place, 3) for place in range(count)]
    return [(capillary_number, size_ratio) for size_ratio in size_ratios for capillary_number in capillary_numbers]


def read_cases(path: str | os.PathLike[str]) -> Cases:
    """Read the cases of a CSV file with columns ``capillary_number`` and ``size_ratio``; refuse a wrong line."""
    numbers = read_numbers(Path(path), ("capillary_number", "size_ratio"), "table of cases")
    return [(capillary_number, size_ratio) for capillary_number, size_ratio in numbers.tolist()]
