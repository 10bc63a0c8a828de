"""Topics of verification: items that are computed and stored one by one, rows that compare them, and their page."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

import capsbayes
from capsbayes.arrays import Floats
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import make_folder, write_file
from capsbayes.interruption import keeping
from capsbayes.report.style import write_figure
from capsbayes.run import only_run
from evidence.markdown import table
from evidence.records import Records

Values: TypeAlias = Mapping[str, float | list[float]]
"""Result of an item: named numbers, or series of them."""

Verdict = Literal["met", "missed", "not computed", ""]


class Reference(NamedTuple):
    """A number and its source."""

    value: float
    source: str


class Target(NamedTuple):
    """Largest difference of a number from its reference, or a limit of the number itself."""

    kind: Literal["relative", "absolute", "at most", "at least"]
    bound: float

    def __str__(self) -> str:
        if self.kind == "relative":
            return f"within {100 * self.bound:.3g} %"
        return f"within {self.bound:.3g}" if self.kind == "absolute" else f"{self.kind} {self.bound:.4g}"


@dataclass(frozen=True)
class Row:
    """A computed number, compared with another.

    >>> row = Row("centre velocity", 2.001, Reference(2.0, "closed form"), Target("relative", 1e-4))
    >>> f"{row.difference:.1e}", row.verdict
    ('5.0e-04', 'missed')
    """

    quantity: str  # its name, in words or symbols
    ours: float  # NaN where it was not computed
    reference: Reference | None = None
    target: Target | None = None  # without one, the row has no verdict

    @property
    def is_relative(self) -> bool:
        """True if the difference is relative: unless the target is absolute or the reference is zero."""
        absolute = self.target is not None and self.target.kind == "absolute"
        return self.reference is not None and self.reference.value != 0.0 and not absolute

    @property
    def difference(self) -> float:
        """Difference from the reference, NaN without one."""
        if self.reference is None:
            return math.nan
        difference = self.ours - self.reference.value
        return difference / abs(self.reference.value) if self.is_relative else difference

    @property
    def verdict(self) -> Verdict:
        """Verdict on the target; empty without one."""
        if not math.isfinite(self.ours):
            return "not computed"
        if self.target is None:
            return ""
        kind, bound = self.target
        if kind == "at most":
            met = self.ours <= bound
        elif kind == "at least":
            met = self.ours >= bound
        else:
            met = abs(self.difference) <= bound
        return "met" if met else "missed"


@dataclass(frozen=True)
class Outcome:
    """End of an item: its values, or in `failed` why there are none, and its processor time [s]."""

    seconds: float
    values: Values
    failed: str = ""


@dataclass(frozen=True)
class Results:
    """Known outcomes of a topic, by item."""

    outcomes: Mapping[str, Outcome]

    @classmethod
    def read(cls, records: Records, topic: str) -> Results:
        """Read the outcomes of a topic; a file that holds something else is an InputError."""
        outcomes = {}
        with parsing(str(records.path), "results of the verification", "remove it to compute everything anew"):
            for record in records.read():
                name = record.pop("section") if "section" in record else record.pop("topic")  # section: up to 0.1.0
                item = str(record.pop("item"))
                if name == topic:
                    found = Outcome(**record)
                    values = {str(key): np.array(value, dtype=float).tolist() for key, value in found.values.items()}
                    outcomes[item] = Outcome(float(found.seconds), values, str(found.failed))
        return cls(outcomes)

    def value(self, item: str, name: str) -> float:
        """Return one number, NaN where the item has not been computed or failed.

        >>> results = Results({"n = 4": Outcome(0.1, {"error": 1e-3})})
        >>> results.value("n = 4", "error"), results.value("n = 6", "error")
        (0.001, nan)
        """
        return float(self.series(item, name)[-1])

    def series(self, item: str, name: str) -> Floats:
        """Return a series (k,) of numbers, one NaN where the item has not been computed or failed."""
        outcome = self.outcomes.get(item)
        return np.atleast_1d(np.nan if outcome is None or outcome.failed else outcome.values[name])

    def across(self, items: Iterable[str], name: str) -> Floats:
        """Return the number `name` of several items (k,)."""
        return np.array([self.value(item, name) for item in items])


@dataclass(frozen=True)
class Topic:
    """Topic of verification."""

    name: str  # on the command line, and of the picture's file
    title: str
    about: str  # a sentence or two on what is compared
    items: Mapping[str, Callable[[], Values]]  # the computations, by the names under which their outcomes are stored
    rows: Callable[[Results], Iterable[Row]]  # of the table, from results that may be incomplete
    picture: Callable[[Results, Figure], None] | None = None  # drawn once every item has ended; a failed one is NaN

    def missing(self, results: Results) -> list[str]:
        """Return the items that have not been computed."""
        return [item for item in self.items if item not in results.outcomes]

    def failed(self, results: Results) -> dict[str, str]:
        """Return the reasons of items that failed."""
        known = {item: results.outcomes[item] for item in self.items if item in results.outcomes}
        return {item: outcome.failed for item, outcome in known.items() if outcome.failed}


# The page: a summary, then a table and a picture for each topic

_COLUMNS = ("quantity", "reference", "source", "ours", "difference", "target", "")
_VERDICTS: tuple[Verdict, ...] = ("met", "missed", "not computed")


def write_page(topics: Sequence[Topic], records: Records, out: Path) -> None:
    """Write ``verification.md`` and its pictures into the folder `out`."""
    known = [(topic, Results.read(records, topic.name)) for topic in topics]
    drawn = {topic.name for topic, results in known if _draw(topic, results, out)}
    lines = [
        "# Verification",
        "",
        "`python -m evidence.verification` compares the simulator with closed forms, published numbers and other",
        "methods, and writes this page. The references are listed in `evidence/verification/references.py`; our",
        f"numbers were computed by capsbayes {capsbayes.__version__} and are kept in [results.jsonl](results.jsonl).",
        "Differences in per cent are relative. Times are seconds of one processor core.",
        "",
        _summary(known),
    ]
    for topic, results in known:
        lines += ["", f"## {topic.title}", "", topic.about, "", table(_COLUMNS, map(_cells, topic.rows(results)))]
        lines += _gaps(topic, results)
        if topic.name in drawn:
            lines += ["", f"![{topic.title}]({topic.name}.png)"]
    write_file(out / "verification.md", "\n".join(lines) + "\n")


def _summary(known: Iterable[tuple[Topic, Results]]) -> str:
    rows = []
    for topic, results in known:
        verdicts = Counter(row.verdict for row in topic.rows(results))
        seconds = sum(outcome.seconds for item, outcome in results.outcomes.items() if item in topic.items)
        link = f"[{topic.title}](#{_anchor(topic.title)})"
        rows.append((link, *(str(verdicts[verdict]) for verdict in _VERDICTS), f"{seconds:.0f}"))
    return table(("topic", *_VERDICTS, "seconds"), rows)


def _anchor(title: str) -> str:
    return "".join(letter for letter in title.lower().replace(" ", "-") if letter.isalnum() or letter == "-")


def _cells(row: Row) -> tuple[str, ...]:
    reference, source = ("", "") if row.reference is None else (f"{row.reference.value:.7g}", row.reference.source)
    ours = f"{row.ours:.7g}" if math.isfinite(row.ours) else ""
    target = "" if row.target is None else str(row.target)
    verdict = f"**{row.verdict}**" if row.verdict == "missed" else row.verdict
    return row.quantity, reference, source, ours, _difference(row), target, verdict


def _difference(row: Row) -> str:
    if row.reference is None or not math.isfinite(row.ours):
        return ""
    return f"{100 * row.difference:+.2g} %" if row.is_relative else f"{row.difference:+.1e}"


def _gaps(topic: Topic, results: Results) -> Iterator[str]:
    missing = topic.missing(results)
    if missing:
        yield from ("", f"Not computed yet: {', '.join(missing)}.")
    for item, reason in topic.failed(results).items():
        yield from ("", f"Without a result: {item}, because {reason}")


def _draw(topic: Topic, results: Results, out: Path) -> bool:
    """Write the topic's picture if it has one and every item has ended."""
    if topic.picture is None or topic.missing(results):
        return False
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    topic.picture(results, figure)
    write_figure(figure, out / f"{topic.name}.png", dpi=120)
    return True


# The missing items of every topic


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
        raise InputError("verification", "--only", f"one of {', '.join(by_name)}", repr(only))
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
