"""Tables of the plan of an experiment: error budget, Sobol indices, flow rates."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import BudgetRow, ErrorBudget, FlowDesign, SobolStudy
from capsbayes.show.tables.table import Symbols, table
from capsbayes.show.words.rounding import stated_in, unit_of, with_unit

_ANSWERS = tuple(PARAMETERS[name] for name in ("surface_shear_modulus", "capsule_radius"))
_FLOW = ("mean_velocity", "flow_rate", "capsule_velocity", "capillary_number")


def budget_table(budget: ErrorBudget) -> pd.DataFrame:
    """Return share, slope and change of G_s and of a for each input."""
    known = ((answer, with_unit(answer.name, budget.value[answer.name], ".4g")) for answer in _ANSWERS)
    values = ", ".join(f"{answer.symbol} = {value} ± {100.0 * budget.sd[answer.name]:.2g} %" for answer, value in known)
    head = [
        "input",
        *(Symbols(f"{answer.symbol}\n{what}") for answer in _ANSWERS for what in ("share", "slope", "change")),
    ]
    shares = {answer.name: budget.shares_of(answer.name) for answer in _ANSWERS}
    rows = [
        [Symbols(_input(row)), *(cell for answer in _ANSWERS for cell in _cells(row, answer.name, shares[answer.name]))]
        for row in budget.rows
    ]
    units = " and ".join(answer.shown_unit for answer in _ANSWERS)
    note = (
        "share: of the variance of the logarithm; slope: d ln / d ln of the input; change: with one standard error of "
        f"the input, in {units}"
    )
    note += "".join(
        f"; the shares of {answer.symbol} do not add up, and are omitted"
        for answer in _ANSWERS
        if not shares[answer.name]
    )
    return table(head, rows, title=f"Error budget: {values}", note=note, numbers=range(1, 7))


def sobol_table(study: SobolStudy) -> pd.DataFrame:
    """Return first-order and total index of each answer by each input."""
    rows = [
        [
            Symbols(f"{PARAMETERS[name].symbol} = {stated.shown(name)}"),
            *(f"{of[name].first:.2f}, {of[name].total:.2f}" for of in study.indices.values()),
        ]
        for name, stated in study.ranges.items()
    ]
    errors = (max(max(index.first_error, index.total_error) for index in of.values()) for of in study.indices.values())
    rows.append(["95 %, at most", *(f"± {error:.2f}" for error in errors)])
    head = ["input", *(Symbols(PARAMETERS[answer].symbol) for answer in study.indices)]
    return table(head, rows, title="Sobol indices: alone, and with others", numbers=range(1, len(head)))


def flow_table(design: FlowDesign) -> pd.DataFrame:
    """Return some of the velocities, and the best."""
    rows = []
    for k, point in enumerate(design.points):
        if point is design.best or k % 12 == 11:
            numbers = [f"{PARAMETERS[name].shown(getattr(point, name)):.3g}" for name in _FLOW]
            widths = f"{point.relative:.1%}", f"{point.relative_radius:.1%}"
            risks = f"{point.leaning:.0%}", f"{point.beyond_limit:.1%}"
            rows.append([*numbers, *widths, *risks, "best" if point is design.best else "" if point.allowed else "no"])
    head = ["\n".join((PARAMETERS[name].symbol, unit_of(PARAMETERS[name]).strip())) for name in _FLOW]
    head += ["G_s\n±", "a\n±", "next to\nborder", "beyond\nlimit", ""]
    note = "no: not to be chosen, for the posterior leans on the border of the database, or it is too near the limit"
    return table(list(map(Symbols, head)), rows, title="Expected width of G_s", note=note, numbers=range(8))


def _input(row: BudgetRow) -> str:
    """An input with its value and error in the display unit."""
    if row.setting is None:
        return row.words
    scale, unit = stated_in(row.name, row.setting.unit)
    error = f" ± {scale * row.setting.error:.2g}" if row.setting.error else ""
    return f"{PARAMETERS[row.name].symbol} = {scale * row.setting.value:.4g}{error}{unit}"


def _cells(row: BudgetRow, quantity: str, shares: Mapping[str, float]) -> list[str]:
    slope, change = row.log_slope.get(quantity), row.change.get(quantity)
    return [
        f"{100.0 * shares[row.name]:.1f} %" if shares else "",
        "" if slope is None else f"{slope:+.3f}",
        "" if change is None else f"{PARAMETERS[quantity].shown(change):+.3g}",
    ]
