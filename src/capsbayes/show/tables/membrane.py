"""Tables of the membrane that a batch shares: its parameters, the laws, the flows, the capsules."""

from __future__ import annotations

import pandas as pd

from capsbayes.infer.prior import Marginal
from capsbayes.infer.shared_membrane import SharedMembrane
from capsbayes.parameters import PARAMETERS
from capsbayes.show.tables.table import Symbols, table
from capsbayes.show.words.rounding import interval_words, per_cent, rounded, two_digits

_MODULUS = PARAMETERS["surface_shear_modulus"]


def membrane_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return median and intervals of the membrane and the population, and how much the data tell of each parameter."""
    widths = shared.widths_over_prior()
    rows = []
    for name, marginal in shared.marginals.items():
        parameter = PARAMETERS[name]
        digits = two_digits(parameter.shown(marginal.sd))
        limits = (marginal.lower_68, marginal.upper_68), (marginal.lower_95, marginal.upper_95)
        ends = [interval_words(name, low, high, digits) for low, high in limits]
        told = per_cent(widths[name]) if name in widths else ""
        rows.append([Symbols(parameter.label), rounded(parameter.shown(marginal.median), digits), *ends, told])
    head = ("", "median", "68 % interval", "95 % interval", "of the prior's width")
    title = f"Membrane and population of {len(shared)} capsules: median and equal-tailed intervals"
    return table(head, rows, title=title, numbers=range(1, len(head)))


def law_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return the probability of each law, and G_s if the membrane obeys it."""
    rows = []
    for law in sorted(shared.laws, key=lambda law: -law.probability):
        middle, ends = _median_and_ends(Marginal.of_draws(law.draws["surface_shear_modulus"]))
        rows.append((law.name, rounded(100.0 * law.probability, 1) + " %", middle, ends))
    head = ("law", "probability", Symbols(_MODULUS.label), "95 % interval")
    return table(head, rows, title="If the membrane obeys a known law", numbers=(1, 2, 3))


def flow_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return the mean G_s of the capsules of each flow, with the membrane unknown and under each law."""
    speed = PARAMETERS["mean_velocity"]
    laws = [law for law in shared.laws[1:] if law.usable]
    columns = [shared.moduli_by_flow(), *(shared.moduli_by_flow(law.draws) for law in laws)]
    rows = []
    for number, flow in enumerate(shared.as_dict()["flows"]):
        cells = [f"{middle} ({ends})" for middle, ends in (_median_and_ends(column[number], 68) for column in columns)]
        rows.append([f"{speed.shown(flow['speed']):.3g}", str(flow["capsules"]), *cells])
    title = f"Mean {_MODULUS.label} of the capsules of each flow (68 %): the same at all if the law is right"
    head = [f"speed [{speed.shown_unit}]", "capsules", "unknown", *(law.name for law in laws)]
    return table([Symbols(text) for text in head], rows, title=title, numbers=range(len(head)))


def _median_and_ends(marginal: Marginal, level: int = 95) -> tuple[str, str]:
    digits = two_digits(_MODULUS.shown(marginal.sd))
    low, high = marginal.ends(level)
    return rounded(_MODULUS.shown(marginal.median), digits), interval_words(_MODULUS.name, low, high, digits)
