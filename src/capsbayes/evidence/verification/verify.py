"""Compute what is missing of every section, and write the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from threadpoolctl import threadpool_limits

from capsbayes.errors import CapsbayesError, InputError
from capsbayes.evidence.verification.page import write_page
from capsbayes.evidence.verification.row import Row
from capsbayes.evidence.verification.section import Outcome, Results, Section, Values
from capsbayes.work import Records

__all__ = ["verify"]


def verify(
    sections: Sequence[Section],
    out: Path,
    *,
    only: str | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> dict[str, list[Row]]:
    """Compute what is missing of the sections, and write the page of all that is known.

    Each finished item is kept in ``results.jsonl`` at once. The page is written
    anew after each section that was computed.

    Parameters
    ----------
    sections : sequence of Section
    out : Path
        Folder of the results, the page and its pictures; it is made if need be.
    only : str, optional
        Name of the one section to compute.
    tell : callable
        Is told each item that begins.

    Returns
    -------
    dict of str to list of Row
        The rows of each section.

    Raises
    ------
    InputError
        If there is no such section, the folder cannot be written, or ``results.jsonl`` holds something else.
    """
    chosen = _chosen(sections, only)
    records = Records(out / "results.jsonl")
    try:
        out.mkdir(parents=True, exist_ok=True)
        for section in chosen:
            _compute(section, records, tell)
            write_page(sections, records, out)
    except OSError as error:
        raise InputError("verify", "out", "a folder that can be written", str(error)) from error
    return {section.name: list(section.rows(Results.read(records, section.name))) for section in sections}


def _chosen(sections: Iterable[Section], only: str | None) -> list[Section]:
    by_name = {section.name: section for section in sections}
    if only is None:
        return list(by_name.values())
    if only not in by_name:
        raise InputError("verify", "only", f"one of {', '.join(by_name)}", repr(only))
    return [by_name[only]]


def _compute(section: Section, records: Records, tell: Callable[[str], None]) -> None:
    for item in section.missing(Results.read(records, section.name)):
        tell(f"{section.title}: {item}")
        begin = time.process_time()
        values: Values = {}
        failed = ""
        try:
            with threadpool_limits(limits=1):  # times are those of one core
                values = section.items[item]()
        except CapsbayesError as error:
            failed = str(error)
        outcome = Outcome(time.process_time() - begin, values, failed)
        records.add({"section": section.name, "item": item, **asdict(outcome)})
