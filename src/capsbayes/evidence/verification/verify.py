"""Compute the missing items of every topic, and write the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from threadpoolctl import threadpool_limits

from capsbayes.errors import CapsbayesError, InputError
from capsbayes.evidence.verification.page import write_page
from capsbayes.evidence.verification.topic import Outcome, Results, Row, Topic, Values
from capsbayes.files.output_file import make_folder
from capsbayes.interruption import keeping
from capsbayes.run import Records, only_run


def verify(
    topics: Sequence[Topic],
    out: Path,
    *,
    only: str | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> dict[str, list[Row]]:
    """Compute the missing items of topics, or of one of them, write the page, and return the rows of each topic."""
    # Each outcome is stored at once in ``results.jsonl`` of the folder `out`, which is made if it does not exist; the
    # page of all known outcomes is written anew after each topic that was computed. `tell` is called with a line for
    # each item.
    by_name = {topic.name: topic for topic in topics}
    if only is not None and only not in by_name:
        raise InputError("verify", "only", f"one of {', '.join(by_name)}", repr(only))
    records = Records(out / "results.jsonl")
    make_folder(out)
    with only_run(out), keeping(records.path):
        for topic in topics if only is None else [by_name[only]]:
            _compute(topic, records, tell)
            write_page(topics, records, out)
    return {topic.name: list(topic.rows(Results.read(records, topic.name))) for topic in topics}


def _compute(topic: Topic, records: Records, tell: Callable[[str], None]) -> None:
    for item in topic.missing(Results.read(records, topic.name)):
        tell(f"{topic.title}: {item}")
        begin = time.process_time()
        values: Values = {}
        failed = ""
        try:
            with threadpool_limits(limits=1):  # times are those of one core
                values = topic.items[item]()
        except CapsbayesError as error:
            failed = str(error)
        outcome = Outcome(time.process_time() - begin, values, failed)
        records.add({"topic": topic.name, "item": item, **asdict(outcome)})
