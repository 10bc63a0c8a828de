"""Tables of the plan of measurements whose membrane is unknown: the flow rates of a batch."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import MembraneFlowDesign, PlannedFlows
from capsbayes.plan.membrane import MEASURED
from capsbayes.plan.widths import EACH, LOGARITHMIC
from capsbayes.show.tables.table import Symbols, table

_SPEED = PARAMETERS["mean_velocity"]


def membrane_flow_table(design: MembraneFlowDesign) -> pd.DataFrame:
    """Return the sets of flow rates with the standard deviations that are expected, and those of the priors."""
    names = tuple(design.prior_sds)
    rows = [_row(str(len(one.mean_velocities)), one, names) for one in design.sets]
    if design.for_law is not None and design.for_law is not design.best:
        rows.append(_row(f"{len(design.for_law.mean_velocities)}, for the law", design.for_law, names))
    rows.append(["prior", "", "", "", "", "", *(f"{design.prior_sds[name]:.2g}" for name in names)])
    head = ["flow rates", f"U [{_SPEED.shown_unit}]", "Ca", "mean\nln G_s", "membrane\nknown", "ln G_s\nof each"]
    head += [_label(name) for name in names]
    batch = "one capsule" if design.same_capsule else f"{design.capsules} capsules"
    title = f"Expected standard deviations: {batch}, filmed in equal shares at the best flow rates"
    if design.same_capsule:
        title = "Expected standard deviations: one capsule, filmed at the best flow rates"
    return table([Symbols(text) for text in head], rows, title=title, numbers=range(3, len(head)))


def membrane_map_table(quantiles: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Return quantiles over a map of the standard deviations of ln G_s, by what is measured and known."""
    rows = []
    for name, levels in quantiles.items():
        known, kind = name.split("_")
        rows.append([MEASURED[kind], known, *(f"{level:.2g}" for level in levels.values())])
    head = ["measured", "membrane", "least", "quarter", "median", "three quarters", "most"]
    title = "Standard deviation of ln G_s of one capsule, over Ca and a/l"
    return table(head, rows, title=title, numbers=range(2, len(head)))


def _row(name: str, one: PlannedFlows, parameters: tuple[str, ...]) -> list[str]:
    speeds = " ".join(f"{_SPEED.shown(speed):.2g}" for speed in one.mean_velocities)
    numbers = " ".join(f"{ca:.2g}" for ca in one.capillary_numbers)
    widths = [one.sds["surface_shear_modulus"], one.sd_if_known, one.sds[EACH], *(one.sds[key] for key in parameters)]
    return [name, speeds, numbers, *(f"{width:.2g}" for width in widths)]


def _label(name: str) -> str:
    symbol = PARAMETERS[name].symbol
    return f"ln {symbol}" if name in LOGARITHMIC else symbol
