"""The page of the exam: what was required, and how every cell was answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import capsbayes
from capsbayes.evidence.exam.answer import Answer
from capsbayes.evidence.exam.cells import Cell
from capsbayes.evidence.exam.exam import Answers

__all__ = ["exam_page"]

Floats = NDArray[np.float64]

_OUTCOMES = ("none", "right", "ambiguous", "unknown", "wrong")
_CLEAR_BIAS = 0.1
_BEFORE_AFTER = {"bias": "{:+.1%}", "misfit": "{:.2f}", "gap": "{:.2f}"}  # gap in um
_KEPT = 0.95  # of the gap, at least, where a pattern that is not there is tried


@dataclass(frozen=True)
class _Count:
    """How many of how many sessions."""

    counted: int
    of: int

    def __str__(self) -> str:
        if not self.of:
            return "-"
        from scipy.stats import binomtest

        ends = binomtest(self.counted, self.of).proportion_ci()
        share = self.counted / self.of
        return f"{self.counted} of {self.of}, {share:.1%} [{ends.low:.1%}, {ends.high:.1%}]"

    def at_most(self, share: float) -> str:
        return _met(self.of > 0 and self.counted <= share * self.of)

    def at_least(self, share: float) -> str:
        return _met(self.of > 0 and self.counted >= share * self.of)


def exam_page(cells: Sequence[Cell], answers: Answers) -> str:
    """The page as Markdown.

    Parameters
    ----------
    cells : sequence of Cell
    answers : mapping of str to mapping of int to Answer
        By name of the cell and seed.
    """
    known = [(cell, list(answers.get(cell.name, {}).values())) for cell in cells]
    known = [(cell, given) for cell, given in known if given]
    lines = [
        "# The exam of the diagnosis",
        "",
        f"Written by `capsbayes exam`, version {capsbayes.__version__}; nothing on this page was typed. Each session",
        "has 40 capsules at four flow rates, of moduli that scatter by 10 %, measured with errors of 0.01 l that are",
        "correlated along the outline. Their shapes come from the simulator, at parameters between those of the",
        "databases and at refinement 12; what a microscope adds is drawn on them as plane geometry. Brackets are 95 %",
        "intervals.",
        *_so_far(cells, known),
        "",
        "## What was required",
        "",
        *_table(("requirement", "found", ""), _requirements(known)),
        "",
        "## Every cell",
        "",
        "Right: named. Ambiguous: among several that are not told apart (for what is not in the catalogue: any",
        "several). Told apart: of the ambiguous ones, how many are right once effects in question were measured apart",
        "from the capsules, the likeliest first, each to a tenth of the width of its prior, and how many measurements",
        "that took on average. Bias is that of the median of ln G_s; misfit, over its freedom, and gap, the root mean",
        "square distance of the edges, are those of the held-out capsules; all are medians over the sessions.",
        "Covered counts 95 % intervals of the size.",
        "",
        *_table(
            ("hidden", "sessions", *_OUTCOMES, "told apart", *(f"{name}, then" for name in _BEFORE_AFTER), "covered"),
            (_row(cell, given) for cell, given in known),
        ),
    ]
    return "\n".join(lines) + "\n"


def _so_far(cells: Sequence[Cell], known: list[tuple[Cell, list[Answer]]]) -> Iterator[str]:
    """What is still to do, if anything is."""
    done, whole = sum(len(given) for _, given in known), sum(cell.sessions for cell in cells)
    if done < whole:
        yield ""
        yield f"**Not complete: {done} of {whole} sessions, of {len(known)} of {len(cells)} cells, so far.**"


def _requirements(known: list[tuple[Cell, list[Answer]]]) -> Iterator[tuple[str, str, str]]:
    for cell, given in known:
        if cell.null:
            claims = _Count(sum(one.outcome != "none" for one in given), len(given))
            yield f"claims where there is {cell.name}: at most 5 %", str(claims), claims.at_most(0.05)
    hidden = [(cell, given) for cell, given in known if not cell.null]
    wrong = {cell.name: _Count(sum(one.outcome == "wrong" for one in given), len(given)) for cell, given in hidden}
    if wrong:
        worst = max(wrong, key=lambda name: wrong[name].counted / wrong[name].of)
        yield "wrong names in every cell: at most 2 %", f"{wrong[worst]} ({worst})", wrong[worst].at_most(0.02)
    for cell, given in hidden:
        if cell.known and (cell.clear or abs(_median(given, "bias_before")) >= _CLEAR_BIAS):
            found = _Count(sum("right" in (one.outcome, one.distinguished) for one in given), len(given))
            yield f"{cell.name}: right, if need be after measurements, at least 90 %", str(found), found.at_least(0.9)
    for cell, given in hidden:
        if not cell.known:
            found = _Count(sum(one.outcome in ("ambiguous", "unknown") for one in given), len(given))
            yield f"{cell.name}: unknown or ambiguous, at least 90 %", str(found), found.at_least(0.9)
        if cell.decoy:
            before, after = 1e6 * _median(given, "gap_before"), 1e6 * _median(given, "gap_after")
            words = f"{cell.name}: gap held out shrinks by at most 5 %"
            yield words, f"{before:.3f} to {after:.3f} um", _met(after >= _KEPT * before)
    yield from _of_what_was_added(hidden)


def _of_what_was_added(hidden: list[tuple[Cell, list[Answer]]]) -> Iterator[tuple[str, str, str]]:
    named = [
        (cell, [one for one in given if one.outcome in ("right", "ambiguous")]) for cell, given in hidden if cell.known
    ]
    for cell, given in named:
        before, after = _median(given, "bias_before"), _median(given, "bias_after")
        if given and abs(before) >= _CLEAR_BIAS:
            words = f"{cell.name}: bias of G_s at least 5 times smaller with the effect"
            yield words, f"{before:+.1%} to {after:+.1%}", _met(abs(before) >= 5.0 * abs(after))
    misfits = np.array([one.misfit_after for _, given in named for one in given if np.isfinite(one.misfit_after)])
    if len(misfits):
        error = misfits.std() / np.sqrt(len(misfits))
        found = f"{misfits.mean():.3f} +/- {error:.3f}, sessions scatter by {misfits.std():.3f}"
        yield (
            "misfit held out with the effect: 1 within its scatter",
            found,
            _met(abs(misfits.mean() - 1) < misfits.std()),
        )
    sizes = _Count(
        sum(_covered(cell, given).counted for cell, given in named),
        sum(_covered(cell, given).of for cell, given in named),
    )
    yield (
        "95 % intervals of the size cover 90 to 98 %",
        str(sizes),
        _met(0.9 * sizes.of <= sizes.counted <= 0.98 * sizes.of),
    )


def _row(cell: Cell, given: list[Answer]) -> tuple[str, ...]:
    outcomes = Counter(one.outcome for one in given)
    covered = _covered(cell, given)
    return (
        cell.name,
        str(len(given)),
        *(str(outcomes[one]) for one in _OUTCOMES),
        _distinguished(given),
        *(_before_after(given, name, form) for name, form in _BEFORE_AFTER.items()),
        f"{covered.counted} of {covered.of}" if covered.of else "",
    )


def _distinguished(given: list[Answer]) -> str:
    asked = [one for one in given if one.distinguished]
    if not asked:
        return ""
    right = sum(one.distinguished == "right" for one in asked)
    return f"{right} of {len(asked)} by {np.mean([one.measurements for one in asked]):.1f}"


def _before_after(given: list[Answer], name: str, form: str) -> str:
    scale = 1e6 if name == "gap" else 1.0
    values = [scale * _median(given, f"{name}_{when}") for when in ("before", "after")]
    return ", ".join(form.format(value) for value in values if np.isfinite(value))


def _covered(cell: Cell, given: list[Answer]) -> _Count:
    told = [one for one in given if np.isfinite(one.size)]
    return _Count(sum(one.low <= cell.size <= one.high for one in told), len(told))


def _median(given: list[Answer], name: str) -> float:
    values = np.array([getattr(one, name) for one in given], dtype=float)
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def _met(holds: bool) -> str:
    return "met" if holds else "**missed**"


def _table(head: Sequence[str], rows: Iterator[tuple[str, ...]]) -> Iterator[str]:
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"
