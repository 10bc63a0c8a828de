"""Tables of the plan of measurements whose membrane is unknown: the flow rates of a batch."""

from __future__ import annotations

import pandas as pd

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import MembraneFlowDesign, PlannedFlows
from capsbayes.plan.expected_membrane import LOGARITHMIC
from capsbayes.show.tables.table import Symbols, table

_SPEED = PARAMETERS["mean_velocity"]


def membrane_flow_table(design: MembraneFlowDesign) -> pd.DataFrame:
    """Return the sets of flow rates with the standard deviations that are expected, and those of the priors."""
    names = tuple(design.prior_sds)
    rows = [_row(str(len(one.mean_velocities)), one, names) for one in design.sets]
    if design.for_law is not None and design.for_law is not design.best:
        rows.append(_row(f"{len(design.for_law.mean_velocities)}, for the law", design.for_law, names))
    rows.append(["prior", "", "", "", "", *(f"{design.prior_sds[name]:.2g}" for name in names)])
    head = ["flow rates", f"U [{_SPEED.shown_unit}]", "Ca", "ln G_s", "ln G_s,\nmembrane known"]
    head += [_label(name) for name in names]
    batch = "one capsule" if design.same_capsule else f"{design.capsules} capsules"
    title = f"Expected standard deviations: {batch}, filmed in equal shares at the best flow rates"
    if design.same_capsule:
        title = "Expected standard deviations: one capsule, filmed at the best flow rates"
    return table([Symbols(text) for text in head], rows, title=title, numbers=range(3, len(head)))


def _row(name: str, one: PlannedFlows, parameters: tuple[str, ...]) -> list[str]:
    speeds = " ".join(f"{_SPEED.shown(speed):.2g}" for speed in one.mean_velocities)
    numbers = " ".join(f"{ca:.2g}" for ca in one.capillary_numbers)
    widths = [one.sds["surface_shear_modulus"], one.sd_if_known, *(one.sds[key] for key in parameters)]
    return [name, speeds, numbers, *(f"{width:.2g}" for width in widths)]


def _label(name: str) -> str:
    symbol = PARAMETERS[name].symbol
    return f"ln {symbol}" if name in LOGARITHMIC else symbol
