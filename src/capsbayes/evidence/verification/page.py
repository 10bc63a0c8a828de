"""The page of verification: a summary, then a table and a picture for each section."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import capsbayes
from capsbayes.evidence.verification.row import Row, Verdict
from capsbayes.evidence.verification.section import Results, Section
from capsbayes.output_file import replaced
from capsbayes.work import Records

__all__ = ["write_page"]

_COLUMNS = ("quantity", "reference", "source", "ours", "difference", "target", "")
_VERDICTS: tuple[Verdict, ...] = ("met", "missed", "not computed")


def write_page(sections: Sequence[Section], records: Records, out: Path) -> None:
    """Write ``verification.md`` and its pictures into the folder `out`."""
    known = [(section, Results.read(records, section.name)) for section in sections]
    drawn = {section.name for section, results in known if _draw(section, results, out)}
    lines = [
        "# Verification",
        "",
        "Written by `capsbayes verify`; nothing on this page was typed. References are those of",
        "`capsbayes.evidence.verification.references`; our numbers were computed by capsbayes",
        f"{capsbayes.__version__} and are kept in [results.jsonl](results.jsonl). Differences in per cent",
        "are relative. Seconds are those of one processor core.",
        "",
        *_summary(known),
    ]
    for section, results in known:
        lines += [
            "",
            f"## {section.title}",
            "",
            section.about,
            "",
            *_table(_COLUMNS, map(_cells, section.rows(results))),
        ]
        lines += _gaps(section, results)
        if section.name in drawn:
            lines += ["", f"![{section.title}]({section.name}.png)"]
    replaced(out / "verification.md", "\n".join(lines) + "\n")


def _summary(known: Iterable[tuple[Section, Results]]) -> Iterator[str]:
    rows = []
    for section, results in known:
        verdicts = Counter(row.verdict for row in section.rows(results))
        seconds = sum(outcome.seconds for item, outcome in results.outcomes.items() if item in section.items)
        link = f"[{section.title}](#{_anchor(section.title)})"
        rows.append((link, *(str(verdicts[verdict]) for verdict in _VERDICTS), f"{seconds:.0f}"))
    return _table(("section", *_VERDICTS, "seconds"), rows)


def _anchor(title: str) -> str:
    return "".join(letter for letter in title.lower().replace(" ", "-") if letter.isalnum() or letter == "-")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def _cells(row: Row) -> tuple[str, ...]:
    reference, source = ("", "") if row.reference is None else (f"{row.reference.value:.7g}", row.reference.source)
    ours = f"{row.ours:.7g}" if math.isfinite(row.ours) else ""
    target = "" if row.target is None else str(row.target)
    verdict = f"**{row.verdict}**" if row.verdict == "missed" else row.verdict
    return row.quantity, reference, source, ours, _difference(row), target, verdict


def _difference(row: Row) -> str:
    if row.reference is None or not math.isfinite(row.ours):
        return ""
    absolute = row.reference.value == 0.0 or (row.target is not None and row.target.kind == "absolute")
    return f"{row.difference:+.1e}" if absolute else f"{100 * row.difference:+.2g} %"


def _gaps(section: Section, results: Results) -> Iterator[str]:
    missing = section.missing(results)
    if missing:
        yield from ("", f"Not computed yet: {', '.join(missing)}.")
    for item, reason in section.failed(results).items():
        yield from ("", f"Without a result: {item}, because {reason}")


def _draw(section: Section, results: Results, out: Path) -> bool:
    """Write the section's picture, if it has one and every item has ended."""
    if section.picture is None or section.missing(results):
        return False
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    section.picture(results, figure)
    partial = out / f".{section.name}.png"
    figure.savefig(partial, dpi=120)
    partial.replace(out / f"{section.name}.png")
    return True
