"""The page of the exam: its requirements, and the answers of every cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

import capsbayes
from capsbayes.evidence.exam.cells import Cell
from capsbayes.evidence.exam.examine import Answers
from capsbayes.evidence.markdown import table_lines

__all__ = ["exam_page"]

_OUTCOMES = ("none", "right", "ambiguous", "unknown", "wrong")
_CLEAR_BIAS = 0.1
_BEFORE_AFTER = {"bias": "{:+.1%}", "misfit": "{:.2f}", "gap": "{:.2f}"}  # gap in um
_KEPT = 0.95  # of the gap, at least, where the only candidate is a random pattern

Given = list[tuple[Cell, pd.DataFrame]]
"""Cells with their answers, a row each."""


@dataclass(frozen=True)
class _Count:
    """Number of sessions with a property, of how many."""

    counted: int
    of: int

    def __str__(self) -> str:
        if not self.of:
            return "-"
        from scipy.stats import binomtest

        ends = binomtest(self.counted, self.of).proportion_ci()
        share = self.counted / self.of
        return f"{self.counted} of {self.of}, {share:.1%} [{ends.low:.1%}, {ends.high:.1%}]"

    @classmethod
    def of_true(cls, values: Sequence[bool] | pd.Series) -> _Count:
        return cls(int(np.sum(values)), len(values))

    def at_most(self, share: float) -> str:
        return _met(self.of > 0 and self.counted <= share * self.of)

    def at_least(self, share: float) -> str:
        return _met(self.of > 0 and self.counted >= share * self.of)


def exam_page(cells: Sequence[Cell], answers: Answers) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    cells : sequence of Cell
    answers : mapping of str to mapping of int to Answer
        By name of the cell and seed.
    """
    given = [(cell, pd.DataFrame(list(found.values()))) for cell in cells if (found := answers.get(cell.name))]
    lines = [
        "# The exam of the diagnosis",
        "",
        f"Written by `capsbayes exam`, version {capsbayes.__version__}; nothing on this page was typed. Each session",
        "has 40 capsules at four flow rates, of moduli that scatter by 10 %, measured with errors of 0.01 l that are",
        "correlated along the outline. Their shapes come from the simulator, at parameters between those of the",
        "databases and at refinement 12; what a microscope adds is drawn on them as plane geometry. Brackets are 95 %",
        "intervals.",
        *_incomplete(cells, given),
        "",
        "## Requirements",
        "",
        *table_lines(("requirement", "result", ""), _requirements(given)),
        "",
        "## Every cell",
        "",
        "Right: named. Ambiguous: among several effects that the session does not distinguish (for an effect that is",
        "not in the catalogue: any several). Distinguished: of the ambiguous sessions, those that are right once",
        "effects in question were measured apart from the capsules, the likeliest first, each to a tenth of the width",
        "of its prior, and the mean number of these measurements. Bias is that of the median of ln G_s; misfit, over",
        "its freedom, and gap, the root mean square distance of the edges, are those of the held-out capsules; all are",
        "medians over the sessions. Covered counts 95 % intervals of the size.",
        "",
        *table_lines(
            (
                "effect",
                "sessions",
                *_OUTCOMES,
                "distinguished",
                *(f"{name}, then" for name in _BEFORE_AFTER),
                "covered",
            ),
            (_row(cell, table) for cell, table in given),
        ),
    ]
    return "\n".join(lines) + "\n"


def _incomplete(cells: Sequence[Cell], given: Given) -> Iterator[str]:
    """Yield a note if sessions are missing."""
    done, whole = sum(len(table) for _, table in given), sum(cell.sessions for cell in cells)
    if done < whole:
        yield ""
        yield f"**Not complete: {done} of {whole} sessions, of {len(given)} of {len(cells)} cells, so far.**"


def _requirements(given: Given) -> Iterator[tuple[str, str, str]]:
    for cell, table in given:
        if cell.null:
            claims = _Count.of_true(table["outcome"] != "none")
            yield f"claims where there is {cell.name}: at most 5 %", str(claims), claims.at_most(0.05)
    with_effect = [(cell, table) for cell, table in given if not cell.null]
    wrong = {cell.name: _Count.of_true(table["outcome"] == "wrong") for cell, table in with_effect}
    if wrong:
        worst = max(wrong, key=lambda name: wrong[name].counted / wrong[name].of)
        yield "wrong names in every cell: at most 2 %", f"{wrong[worst]} ({worst})", wrong[worst].at_most(0.02)
    for cell, table in with_effect:
        if cell.known and (cell.clear or abs(table["bias_before"].median()) >= _CLEAR_BIAS):
            right = _Count.of_true((table["outcome"] == "right") | (table["distinguished"] == "right"))
            yield f"{cell.name}: right, if need be after measurements, at least 90 %", str(right), right.at_least(0.9)
    for cell, table in with_effect:
        if not cell.known:
            open_ = _Count.of_true(table["outcome"].isin(["ambiguous", "unknown"]))
            yield f"{cell.name}: unknown or ambiguous, at least 90 %", str(open_), open_.at_least(0.9)
        if cell.decoy:
            before, after = 1e6 * table["gap_before"].median(), 1e6 * table["gap_after"].median()
            words = f"{cell.name}: gap held out shrinks by at most 5 %"
            yield words, f"{before:.3f} to {after:.3f} um", _met(after >= _KEPT * before)
    yield from _of_named_effects(
        [(cell, table[table["outcome"].isin(["right", "ambiguous"])]) for cell, table in with_effect if cell.known]
    )


def _of_named_effects(named: Given) -> Iterator[tuple[str, str, str]]:
    for cell, table in named:
        before, after = table["bias_before"].median(), table["bias_after"].median()
        if abs(before) >= _CLEAR_BIAS:
            words = f"{cell.name}: bias of G_s at least 5 times smaller with the effect"
            yield words, f"{before:+.1%} to {after:+.1%}", _met(abs(before) >= 5.0 * abs(after))
    misfits = np.concatenate([np.empty(0), *(table["misfit_after"].dropna() for _, table in named)])
    if len(misfits):
        mean, scatter = misfits.mean(), misfits.std()
        found = f"{mean:.3f} +/- {scatter / np.sqrt(len(misfits)):.3f}, sessions scatter by {scatter:.3f}"
        yield "misfit held out with the effect: 1 within its scatter", found, _met(abs(mean - 1) < scatter)
    covered = [_covered(cell, table) for cell, table in named]
    sizes = _Count(sum(count.counted for count in covered), sum(count.of for count in covered))
    right = 0.9 * sizes.of <= sizes.counted <= 0.98 * sizes.of
    yield "95 % intervals of the size cover 90 to 98 %", str(sizes), _met(right)


def _row(cell: Cell, table: pd.DataFrame) -> tuple[str, ...]:
    covered = _covered(cell, table)
    return (
        cell.name,
        str(len(table)),
        *(str(np.sum(table["outcome"] == outcome)) for outcome in _OUTCOMES),
        _distinguished(table),
        *(_before_after(table, name, form) for name, form in _BEFORE_AFTER.items()),
        f"{covered.counted} of {covered.of}" if covered.of else "",
    )


def _distinguished(table: pd.DataFrame) -> str:
    asked = table[table["distinguished"] != ""]
    if asked.empty:
        return ""
    right = np.sum(asked["distinguished"] == "right")
    return f"{right} of {len(asked)} by {asked['measurements'].mean():.1f}"


def _before_after(table: pd.DataFrame, name: str, form: str) -> str:
    scale = 1e6 if name == "gap" else 1.0
    values = [scale * table[f"{name}_{when}"].median() for when in ("before", "after")]
    return ", ".join(form.format(value) for value in values if np.isfinite(value))


def _covered(cell: Cell, table: pd.DataFrame) -> _Count:
    known = table[table["size"].notna()]
    return _Count.of_true((known["low"] <= cell.size) & (cell.size <= known["high"]))


def _met(holds: bool) -> str:
    return "met" if holds else "**missed**"
