"""The page of verification: a summary, then a table and a picture for each topic."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

import capsbayes
from capsbayes.evidence.markdown import table_lines
from capsbayes.evidence.verification.topic import Results, Row, Topic, Verdict
from capsbayes.files.output_file import write_file
from capsbayes.report.style import write_figure
from capsbayes.run import Records

_COLUMNS = ("quantity", "reference", "source", "ours", "difference", "target", "")
_VERDICTS: tuple[Verdict, ...] = ("met", "missed", "not computed")


def write_page(topics: Sequence[Topic], records: Records, out: Path) -> None:
    """Write ``verification.md`` and its pictures into the folder `out`."""
    known = [(topic, Results.read(records, topic.name)) for topic in topics]
    drawn = {topic.name for topic, results in known if _draw(topic, results, out)}
    lines = [
        "# Verification",
        "",
        "`capsbayes verify` compares the simulator with closed forms, published numbers and other methods, and",
        "writes this page. The references are listed in `capsbayes.evidence.verification.references`; our numbers",
        f"were computed by capsbayes {capsbayes.__version__} and are kept in [results.jsonl](results.jsonl).",
        "Differences in per cent are relative. Times are seconds of one processor core.",
        "",
        *_summary(known),
    ]
    for topic, results in known:
        lines += [
            "",
            f"## {topic.title}",
            "",
            topic.about,
            "",
            *table_lines(_COLUMNS, map(_cells, topic.rows(results))),
        ]
        lines += _gaps(topic, results)
        if topic.name in drawn:
            lines += ["", f"![{topic.title}]({topic.name}.png)"]
    write_file(out / "verification.md", "\n".join(lines) + "\n")


def _summary(known: Iterable[tuple[Topic, Results]]) -> Iterator[str]:
    rows = []
    for topic, results in known:
        verdicts = Counter(row.verdict for row in topic.rows(results))
        seconds = sum(outcome.seconds for item, outcome in results.outcomes.items() if item in topic.items)
        link = f"[{topic.title}](#{_anchor(topic.title)})"
        rows.append((link, *(str(verdicts[verdict]) for verdict in _VERDICTS), f"{seconds:.0f}"))
    return table_lines(("topic", *_VERDICTS, "seconds"), rows)


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
