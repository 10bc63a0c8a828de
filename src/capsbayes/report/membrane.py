"""Sentences, tables and figure of the membrane that a batch shares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.infer.prior import Marginal
from capsbayes.infer.shared_membrane import LawOdds, SharedMembrane
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import counted, marginal_cells, per_cent, rounded
from capsbayes.report.posterior import border_words, refinement_words, told_words
from capsbayes.report.style import ACCENT, INK, PALE, WALL, framed, legend_below, new_figure, plain_numbers, ratio_label
from capsbayes.report.tables import Strong, Symbols, table

_MODULUS, _SPEED = PARAMETERS["surface_shear_modulus"], PARAMETERS["mean_velocity"]
_SURE = 0.95  # probability of a law that is named, under nearly every error of the model
_SOME = 3.0  # odds
_STYLES = ((INK, "o"), (ACCENT, "s"), (PALE, "D"), (WALL, "^"), (INK, "v"))  # of the laws


def law_words(shared: SharedMembrane) -> str:
    """Say which law the membrane obeys, if no error of the model could decide it; empty if laws were not compared."""
    if len(shared.laws) < 2:
        return ""
    first, *others = sorted(shared.laws, key=lambda law: -law.probability)
    second, least = others[0], first.over_errors[0]
    rivals = [law for law in others if law.over_errors[1] > least]
    if least <= _SURE and rivals:
        ranges = [f"{law.name} ({_over_errors(law)})" for law in (first, *rivals)]
        return (
            f"The model's own error could decide between {' and '.join(ranges)}: the probability of a law over the "
            "errors that the model may have is in brackets. No law is named."
        )
    odds = first.probability / max(second.probability, 1e-300)
    shown = "more than 1000" if odds > 1000.0 else f"{odds:.2g}"
    name = "a law between or beyond the known ones" if first is shared.laws[0] else f"the {first.name} law"
    against = "a general law" if second is shared.laws[0] else f"the {second.name} law"
    if least > _SURE:
        return f"The membrane obeys {name}: {shown} to 1 against {against}."
    if odds > _SOME:
        return f"The membrane rather obeys {name}, {shown} to 1 against {against}; more flow rates would tell."
    return f"The capsules do not tell the law: {name} against {against} stands {shown} to 1."


def _over_errors(law: LawOdds) -> str:
    """Return the range of the probability of a law over the errors that the model may have."""
    return " to ".join(rounded(100.0 * share, 1) for share in law.over_errors) + " %"


def caveats(shared: SharedMembrane) -> Iterator[str]:
    """Yield what a reader must keep in mind."""
    if shared.refinement is not None:
        yield from refinement_words(shared.refinement)
    for gate in shared.gates:
        if not gate.passed:
            yield f"Check failed: {gate}."
        if gate.caveat:
            yield gate.caveat
    yield from border_words(shared.leaning)
    unusable = [law.name for law in shared.laws if not law.usable]
    if unusable:
        yield f"Checks of the computation failed under: {', '.join(unusable)}; its row is rough."
    odd = np.flatnonzero(shared.misfit > 2.0)
    if len(odd):
        names = ", ".join(shared.names[number] for number in odd[:5])
        more = "" if len(odd) <= 5 else f" and {len(odd) - 5} more"
        yield f"Shapes that differ by more than twice their errors: {names}{more}."
        if len(odd) > 0.1 * len(shared):
            yield f"That is {per_cent(len(odd) / len(shared))} of the capsules: their errors may be understated."
    if shared.flow.max() == 0:
        yield "All capsules were filmed in one flow; several flow rates tell the membrane much better."


def membrane_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return median and intervals of the membrane and the population, and how much the data tell of each parameter."""
    widths = shared.widths_over_prior()
    rows = []
    for name, marginal in shared.marginals.items():
        width = per_cent(widths[name]) if name in widths else ""
        rows.append([Symbols(PARAMETERS[name].label), *marginal_cells(name, marginal), width])
    head = ("", "median", "68 % interval", "95 % interval", "of the prior's width")
    title = f"Membrane and population of {counted(len(shared), 'capsule')}: median and equal-tailed intervals"
    return table(head, rows, title=title, numbers=range(1, len(head)))


def law_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return the laws, possible ones first, then those ruled out or not to be judged, and G_s under each."""
    rows = []
    for law in sorted(shared.laws, key=lambda law: (not law.usable, -law.probability)):
        middle, _, ends = marginal_cells(_MODULUS.name, Marginal.of_draws(law.draws[_MODULUS.name]))
        words = rounded(100.0 * law.probability, 1) + " %"
        if not law.usable or law.over_errors[1] < 1.0 - _SURE:
            words = "ruled out" if law.usable else "not known"
        rows.append((law.name, words, _over_errors(law), middle, ends))
    head = ("law", "probability", "over model errors", Symbols(_MODULUS.label), "95 % interval")
    return table(head, rows, title="If the membrane obeys a known law", numbers=(1, 2, 3, 4))


def _moduli_by_flow(shared: SharedMembrane) -> dict[str, list[Marginal]]:
    """Mean G_s of the capsules of each flow with the membrane unknown, and under each law that can be used."""
    laws = {law.name: shared.moduli_by_flow(law.draws) for law in shared.laws[1:] if law.usable}
    return {"unknown": shared.moduli_by_flow(), **laws}


def flow_table(shared: SharedMembrane) -> pd.DataFrame:
    """Return the mean G_s of the capsules of each flow, with the membrane unknown and under each law."""
    moduli = _moduli_by_flow(shared)
    rows = []
    for number, flow in enumerate(shared.as_dict()["flows"]):
        marginals = [marginal_cells(_MODULUS.name, of_law[number]) for of_law in moduli.values()]
        cells = [f"{middle} ({ends})" for middle, ends, _ in marginals]
        rows.append([f"{_SPEED.shown(flow['speed']):.3g}", str(flow["capsules"]), *cells])
    title = f"Mean {_MODULUS.label} of the capsules of each flow (68 %): the same at all if the law is right"
    head = [f"speed [{_SPEED.shown_unit}]", "capsules", *moduli]
    return table([Symbols(text) for text in head], rows, title=title, numbers=range(len(head)))


def membrane_parts(shared: SharedMembrane) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of the membrane that a batch shares."""
    yield membrane_table(shared)
    yield told_words(shared.widths_over_prior(), "kept its prior", "kept their priors")
    if len(shared.laws) > 1:
        yield law_table(shared)
        yield Strong(law_words(shared))
    if shared.flow.max() > 0:
        yield flow_table(shared)
    yield from caveats(shared)


def membrane_figure(shared: SharedMembrane) -> Figure:
    """Draw the mean G_s of the capsules of each flow under each law, and predicted against measured lengths."""
    figure = new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2)
    _draw_flows(left, shared)
    _draw_lengths(right, shared)
    legend_below(figure, framed(left), 4, fontsize=9)
    return figure


def _draw_flows(ax: Axes, shared: SharedMembrane) -> None:
    flows = range(int(shared.flow.max()) + 1)
    speeds = np.array([_SPEED.shown(float(np.median(shared.speed[shared.flow == k]))) for k in flows])
    moduli = _moduli_by_flow(shared)
    for number, (name, marginals) in enumerate(moduli.items()):
        aside = 1.0 + 0.03 * (number - 0.5 * (len(moduli) - 1))  # so that bars do not hide each other
        colour, marker = _STYLES[number % len(_STYLES)]
        middles = np.array([_MODULUS.shown(marginal.median) for marginal in marginals])
        ends = _MODULUS.scale * np.array([marginal.ends(68) for marginal in marginals]).T
        style: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "none", "markersize": 5}
        label = name if number else "membrane unknown"
        ax.errorbar(speeds * aside, middles, np.abs(ends - middles), label=label, **style)
    ax.set(xscale="log", yscale="log", xlabel="speed of the flow [mm/s]", ylabel=_MODULUS.axis_label)
    plain_numbers(ax.yaxis)
    ax.set_xticks(speeds, [f"{speed:.3g}" for speed in speeds])
    ax.xaxis.minorticks_off()
    ax.set_title("mean of the capsules of each flow, 68 %", fontsize=10)


def _draw_lengths(ax: Axes, shared: SharedMembrane) -> None:
    for column, (name, colour, marker) in enumerate((("axial_extent", INK, "o"), ("axial_length", ACCENT, "s"))):
        measured, predicted = shared.lengths[:, column], np.median(shared.draws[f"{name}_each"], axis=0)
        label = f"${PARAMETERS[name].latex}$"
        ax.plot(predicted, measured, marker, color=colour, markersize=4, alpha=0.8, label=label)
    ends = ax.get_xlim()
    ax.plot(ends, ends, color=WALL, linewidth=1.0, zorder=0)
    ax.set(xlim=ends, xlabel="predicted", ylabel="measured")
    ax.set_title(f"{ratio_label('axial_extent')} and {ratio_label('axial_length')}", fontsize=10)
    framed(ax).legend(frameon=False)
