"""``capsbayes validate``: how well a database predicts the cases that are held out of it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import AsJson, DatabaseName
from capsbayes.cli.output import conclude
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.surrogate.plane import LeaveOneOut

Studies = dict[str, list["LeaveOneOut"]]


def validate(
    database: DatabaseName = "square-neo-hookean",
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the heat maps and the table."),
        Writes(within=("validation.json", "errors-*.png")),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hold out one case at a time, and identify it from its two lengths."""
    from rich.console import Console

    from capsbayes.database import Database
    from capsbayes.report.database import heat_maps
    from capsbayes.run import resumable
    from capsbayes.surrogate.plane import even_subset, validate_forward_map, validate_inverse

    whole = Database.open(database)
    if whole.effect != "none":
        raise InputError("validate", "database", "one over Ca and a/l alone", f"one that varies {whole.effect} as well")
    sets = {"all": whole, "even": even_subset(whole)}
    with resumable(out):
        studies: Studies = {}
        with Console(stderr=True).status("Holding out one case at a time ..."):
            for name, cases in sets.items():
                studies[name] = [validate_inverse(cases), validate_forward_map(cases)]
        figures = _figures(studies, whole.sha256)
        files: dict[str, Writer] = {"validation.json": json_file(figures)}
        for name, pair in studies.items():
            files[f"errors-{name}.png"] = figure_file(partial(heat_maps, *pair), dpi=150)
        conclude(figures, lambda: [_table(studies)], files, out=out, as_json=as_json)


def _figures(studies: Studies, sha256: str) -> dict[str, Any]:
    from capsbayes.surrogate.plane import CHOICES, PAPER_ERRORS, PARAMETERS, STRETCH_LIMIT

    rows = []
    for name, pair in studies.items():
        for study in pair:
            for which in CHOICES:
                summary = study.summary(which)
                row: dict[str, Any] = {"set": name, "method": study.method, "which": which}
                row |= {"count": summary.cases, "failed": summary.failed}
                for k, parameter in enumerate(PARAMETERS):
                    row[parameter] = {figure: float(getattr(summary, figure)[k]) for figure in ("mean", "sd", "median")}
                rows.append(row)
    paper = {key: dict(zip(PARAMETERS, values, strict=True)) for key, values in PAPER_ERRORS.items()}
    return {"sha256": sha256, "stretch_limit": STRETCH_LIMIT, "relative_errors": rows, "paper": paper}


def _table(studies: Studies) -> pd.DataFrame:
    from capsbayes.report.tables import Symbols, table
    from capsbayes.surrogate.plane import CHOICES, PAPER_ERRORS

    rows = []
    for name, pair in studies.items():
        for study in pair:
            for which, words in CHOICES.items():
                summary = study.summary(which)
                lost = f", {summary.failed} lost" if summary.failed else ""
                cases = f"{summary.cases} {name if which == 'all' else words}{lost}"
                rows.append((cases, study.method, *_percent(summary.mean, summary.sd, digits=2)))
    published = _percent(PAPER_ERRORS["mean"], PAPER_ERRORS["sd"], digits=1)
    rows.append((CHOICES["stretched"], "as published", *published))
    head = ("cases", "method", *map(Symbols, ("Ca", "a/l", "v_o/U")))
    return table(head, rows, title="Leave-one-out: relative error, mean ± sd [%]", numbers=(2, 3, 4))


def _percent(means: Iterable[float], sds: Iterable[float], *, digits: int) -> list[str]:
    return [f"{100 * mean:.{digits}f} ± {100 * sd:.{digits}f}" for mean, sd in zip(means, sds, strict=True)]
