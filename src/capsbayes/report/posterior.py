"""Sentences and tables of a posterior, on the terminal as on its page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from capsbayes.infer import Posterior
from capsbayes.infer.checks import FAR
from capsbayes.infer.identify import FLOWS, OUTLINE_NOISE, REST, THICKNESS_ERROR, add_up
from capsbayes.infer.prior import LAWS, THICKNESS, UNKNOWN, Marginal
from capsbayes.infer.tension import MembraneTension
from capsbayes.infer.verdict import LEANING_SHARE, ONE_END, RANGE
from capsbayes.model import TWO_SHAPES, UNSURE_SHAPES, WRINKLES, name_parts
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import (
    counted,
    interval_words,
    marginal_cells,
    per_cent,
    rounded,
    stated_in,
    two_digits,
    unit_of,
    value_words,
    with_unit,
)
from capsbayes.report.tables import Code, Strong, Symbols, table

KEPT = 0.9
"""Width over that of the prior, above which a parameter kept its prior."""
_TOLD = 0.5  # the same, below which the data tell it
_PUBLISHED = "published: what the procedure of Quesada et al. (2021) answers, without errors"
_LEAST_STRETCH = 1.04  # below it the paper does not identify a capsule
_LOOSE = 2.0  # ratio of the ends of the 95 % interval of G_s
BEYOND_LAWS = 0.3
"""Share by which G_s from an outline is too large if the membrane obeys generalised Hooke's law, read as unknown."""
_SENSITIVE = 0.05  # `Posterior.prior_sensitivity`, above which the choice of the prior matters
_SHARES = (np.arange(1000) + 0.5) / 1000  # of the probability of a prior
_INPUTS = {
    "outline": "measured outline",
    "surrogate": "error of the model",
    REST: "remainder (inputs interact; can be negative)",
}
_OBEYS = {
    "neo-hookean": "is neo-Hookean",
    "skalak-c-1": "obeys Skalak's law with C = 1",
    "generalised-hooke-nu-s-0-5": "obeys generalised Hooke's law with a Poisson ratio of 0.5",
    "skalak": "obeys Skalak's law",
    "blatz-ko": "obeys the Blatz-Ko law",
    UNKNOWN: "obeys one of the model's laws",
}
_COMPARED = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio")
_DIFFER = "Medians with 95 % intervals. ≠ marks what was stated differently, and intervals that do not overlap."
_PRIOR = ("mean", "sd", "low", "high")
_OF_LAW = ("area_dilation_modulus", "strain_hardening", "hardening", "hooke_share")
_PLACES = {
    "model": "the border of the database",
    TWO_SHAPES: "capillary numbers at which two steady shapes are stable",
    WRINKLES: "capsules whose membrane wrinkles",
    UNSURE_SHAPES: "shapes whose lengths the model knows to no better than 5 %",
}


def status_words(posterior: Posterior) -> str:
    """Say how the identification ended, and for which membranes its intervals are valid."""
    passed = sum(gate.passed for gate in posterior.gates)
    gates = f"{passed} of {len(posterior.gates)} checks"
    if posterior.status.ok:
        membrane = membrane_words(posterior.model_name)
        return f"The computation succeeded ({gates}). The interval is valid if the membrane {membrane}."
    return f"{posterior.status} ({gates} of the computation passed.)"


def membrane_words(model: str) -> str:
    """Return what a model of some name assumes of the membrane."""
    plain, further, held = name_parts(model)
    law, changed = plain.partition("-")[2], {part for part in (further, *held) if part.startswith(_OF_LAW)}
    if law == "membrane":
        stated = {law: {f"{name} = {value:g}" for name, value in of.items()} for law, of in LAWS.items()}
        law, changed = next((law.lower() for law, parts in stated.items() if parts == changed), ""), set()
    return _OBEYS[law] if law in _OBEYS and not changed else f"is one of those of the model {model}"


def caveats(posterior: Posterior) -> list[str]:
    """Return what a reader must keep in mind, one sentence each; empty if nothing."""
    own = *_computation(posterior), *border_words(posterior.leaning), *_capsule(posterior), *_coordinates(posterior)
    return [*other_laws(posterior), *own, *_of_prior(posterior)]


def update_words(posterior: Posterior) -> str:
    """Say what was stated of G_s before the capsule, and what it is with it; empty of a prior that is a range."""
    name, prior = "surface_shear_modulus", posterior.prior.surface_shear_modulus
    if prior.is_range:
        return ""
    before = Marginal.of_draws(prior.ppf(_SHARES))
    return f"Stated before: {value_words(name, before)}. With this capsule: {value_words(name, posterior[name])}."


def sensitivity_words(posterior: Posterior) -> str:
    """Say whether the prior of G_s decides a part of it; empty if not. For pages, which import ArviZ anyway."""
    sensitivity = posterior.prior_sensitivity["surface_shear_modulus"]
    if sensitivity <= _SENSITIVE:
        return ""
    return f"The prior of G_s decides a part of it: its sensitivity is {sensitivity:.2g}, above {_SENSITIVE:g}."


def _of_prior(posterior: Posterior) -> Iterator[str]:
    """Say where the capsule contradicts a prior that is no range."""
    modulus, name = posterior.prior.surface_shear_modulus, "surface_shear_modulus"
    if modulus.is_range:
        return
    # a prior and data of Gaussian errors differ by (posterior - prior) / sqrt(var(prior) - var(posterior))
    gained = float(np.var(np.log(modulus.ppf(_SHARES)))) - posterior.log_modulus_sd**2
    away = abs(math.log(posterior[name].median / float(modulus.ppf(0.5))))
    far = away / math.sqrt(gained) if gained > 0.0 else 0.0
    if far > FAR:
        yield (
            f"This capsule by itself and the prior of G_s are {far:.1f} standard deviations apart: "
            "one of the two is probably wrong, and the interval mixes both."
        )


def resimulation_words(posterior: Posterior) -> str:
    """Say whether the simulator checked the posterior, and what that changed."""
    seen, name = posterior.resimulation, "surface_shear_modulus"
    if seen is None:
        return "Not checked by the simulator (on the command line: --resimulate 20)."
    lost = f" ({seen.lost} more were not found)" * bool(seen.lost)
    moved = 100.0 * seen.moved(posterior.marginals[name])
    return (
        f"Checked by the simulator: {len(seen)} shapes at refinement {seen.refinement}{lost}; the model's error moved "
        f"G_s by {moved:+.2g} %. All numbers here are corrected; by the model alone, "
        f"{value_words(name, seen.before)}."
    )


def resimulation_table(posterior: Posterior) -> pd.DataFrame | None:
    """Return what the simulated shapes differ by from the predicted ones; None where none were simulated."""
    if posterior.resimulation is None:
        return None
    rows = []
    for name, off in posterior.resimulation.as_dict()["simulated_minus_predicted"].items():
        known = "outline, along its normal" if name == "outline" else PARAMETERS[name].symbol
        sizes = (f"{1e3 * off[key]:.2f}" for key in ("mean", "rms", "largest"))
        rows.append((Symbols(known), *sizes, f"{off['rms_in_standard_errors']:.2g}"))
    head = ("", "mean", "rms", "largest", "rms / stated")
    title = "Simulated minus predicted, in thousandths, and over the error that is stated"
    return table(head, rows, title=title, numbers=range(1, len(head)))


def agreement_words(posterior: Posterior) -> str:
    """Say how far the two engines agree; empty if only one was used."""
    if posterior.agreement is None:
        return ""
    agreement = str(posterior.agreement).capitalize()
    return f"By quadrature: the same posterior computed on a grid instead of sampled. {agreement}."


def input_words(name: str) -> str:
    """Return an input of the error budget by its symbol and meaning."""
    parameter = PARAMETERS.get(name)
    return f"{parameter.symbol}, {parameter.meaning}" if parameter else _INPUTS.get(name, name)


def later_words(name: str) -> str:
    """Return what may be measured later, as in `capsbayes.infer.identify`."""
    if name == THICKNESS:
        return f"the thickness of the membrane to {per_cent(THICKNESS_ERROR)}"
    if name == "outline":
        return f"the outline to {OUTLINE_NOISE.scale:g} l"
    if name in FLOWS:
        return f"the same capsule at {FLOWS[name]:g} times the flow rate"
    return f"{PARAMETERS[name].symbol} known ({PARAMETERS[name].meaning})"


def budget_sentence(posterior: Posterior) -> str:
    """Say which input to measure better first."""
    if not posterior.shares:
        return "What each input contributes to the uncertainty of G_s was not computed."
    name = max(posterior.shares.keys() - {REST}, key=lambda name: posterior.shares[name])
    share = f" ({per_cent(posterior.shares[name])} of the variance of ln G_s)" if add_up(posterior.shares) else ""
    words = f"the {_INPUTS[name]}" if name in _INPUTS else input_words(name)
    return f"The largest contribution to the uncertainty of G_s is {words}{share}."


def other_laws(posterior: Posterior) -> Iterator[str]:
    """Say what G_s may be if the membrane obeys another law, where that was computed."""
    if posterior.modulus_over_laws is not None:
        name, known = "surface_shear_modulus", PARAMETERS["surface_shear_modulus"]
        digits = two_digits(known.shown(posterior.modulus_over_laws[0]))
        ends = interval_words(name, *posterior.modulus_over_laws, digits)
        yield (
            f"Another membrane law could give the same lengths with any G_s from {ends} {known.shown_unit}. Choose "
            "'unknown' as the law (on the command line: --membrane unknown) to include this in the interval."
        )


def _computation(posterior: Posterior) -> Iterator[str]:
    for gate in posterior.gates:
        if not gate.passed:
            yield f"A check failed: {gate.name} is {gate.value:.4g}, wanted {gate.wanted}."
        if gate.caveat:
            yield gate.caveat
    if posterior.agreement is not None and not posterior.agreement.passed:
        yield f"Checked a second way, {posterior.agreement}."


def border_words(leaning: Mapping[str, float]) -> Iterator[str]:
    """Say next to which borders a posterior lies, by the names and shares of `capsbayes.infer.verdict`."""
    for border, share in leaning.items():
        if share > LEANING_SHARE:
            of_model = "range of the model in" if border.startswith((RANGE, ONE_END)) else "prior range of"
            name = border.removeprefix("prior of ").removeprefix(ONE_END).removeprefix(RANGE)
            known = f"the end of the {of_model} {PARAMETERS[name].symbol}" if name in PARAMETERS else border
            yield f"{per_cent(share)} of the posterior lies next to {_PLACES.get(border, known)}."


def _capsule(posterior: Posterior) -> Iterator[str]:
    if posterior.measurement.axial_length is None:
        yield "The length on the axis L_a was not seen; its information is missing from the intervals."
    if posterior.measurement.walls:
        yield f"The half width in px is that of {posterior.measurement.walls}."
    if posterior.measurement.doubt:
        yield posterior.measurement.doubt
    stretch = posterior.marginals["stretch_ratio"]
    if stretch.median < _LEAST_STRETCH:
        yield (
            f"The membrane is stretched by {per_cent(stretch.median - 1.0)} only: small errors of the lengths are "
            "large ones of G_s. A faster flow would determine G_s better."
        )
    modulus = posterior.marginals["surface_shear_modulus"]
    factor = modulus.upper_95 / modulus.lower_95
    if factor > _LOOSE:
        yield f"The 95 % interval of G_s is wide: its ends differ by a factor of {factor:.2g}."


def _coordinates(posterior: Posterior) -> Iterator[str]:
    """Say of several further coordinates what the data tell, what it costs not to know them, and what would help."""
    if posterior.refinement is not None:
        yield from refinement_words(posterior.refinement)
    if posterior.log_modulus_sd_if_known is None:
        return
    for name, width in posterior.widths_over_prior().items():
        told = "kept its prior" if width > KEPT else f"is told {'' if width < _TOLD else 'in part '}by the data"
        yield f"{input_words(name)}, {told}: its 68 % interval is {per_cent(width)} as wide as that of its prior."
    yield (
        f"ln G_s has a standard deviation of {posterior.log_modulus_sd:.2g}; were the membrane known, "
        f"{posterior.log_modulus_sd_if_known:.2g}."
    )
    if posterior.measurement.outline is not None and "strain_hardening" in posterior.widths_over_prior():
        yield (
            "The intervals are those of the model's laws. A membrane of another law may have the same outline: if it "
            f"obeys generalised Hooke's, this G_s is some {per_cent(BEYOND_LAWS)} too large."
        )
    expected = posterior.expected_log_modulus_sds
    if expected:
        best = min(expected, key=lambda name: expected[name])
        yield f"Of one more measurement, {later_words(best)} would narrow ln G_s most: to {expected[best]:.2g}."


def refinement_words(refinement: Mapping[str, Any]) -> Iterator[str]:
    """Say which states were added to the model where the posterior lies, and what they changed."""
    before, after = (per_cent(refinement[f"share_{when}"]) for when in ("before", "after"))
    rounds = sum(each["simulated"] > 0 for each in refinement["rounds"])
    new = refinement["states"] - refinement["reused"]
    yield (
        f"States of refinement {refinement['refinement']} were added to the model where the posterior lies: "
        f"{refinement['reused']} of earlier runs, {new} new in {counted(rounds, 'round')}. "
        f"The error of the model makes up {after} of the variance of ln G_s, without them {before}."
    )
    if refinement["agrees"] is not None:
        tests = refinement["rounds"][-1]
        verdict = "that is as stated" if refinement["agrees"] else "it is understated, and the intervals are too narrow"
        yield (
            f"At states that the model had not seen ({tests['tested']}), its error was {tests['score']:.2g} times the "
            f"stated one: {verdict}."
        )
    if not refinement["small"]:
        yield "With more states (--refine and a larger number) the interval of G_s would be narrower."


def told_words(widths: Mapping[str, float], keeps: str, keep: str) -> str:
    """Say which parameters of the membrane a batch tells, by their widths over those of the priors, and which not."""
    told = [PARAMETERS[name].symbol for name, width in widths.items() if width <= KEPT]
    kept = [PARAMETERS[name].symbol for name, width in widths.items() if width > KEPT]
    words = f"The capsules tell {', '.join(told) or 'nothing of the membrane'}."
    return f"{words} {', '.join(kept)} {keeps if len(kept) == 1 else keep}." if kept else words


def quantity_table(posterior: Posterior) -> pd.DataFrame:
    """Return median and intervals of every quantity, with the second engine and the published procedure."""
    answer = {} if posterior.deterministic is None else posterior.deterministic.as_dict()
    head = ["", "median", "68 % interval", "95 % interval"]
    head += ["quadrature"] * bool(posterior.reference) + ["published"] * bool(answer)
    rows = []
    for name, marginal in posterior.marginals.items():
        parameter = PARAMETERS[name]
        digits = two_digits(parameter.shown(marginal.sd))
        others = [posterior.reference[name].median] if posterior.reference else []
        others += [answer.get(name, math.nan)] if answer else []
        cells = [rounded(parameter.shown(value), digits) if math.isfinite(value) else "" for value in others]
        rows.append([Symbols(parameter.label), *marginal_cells(name, marginal), *cells])
    title = f"Posterior by {posterior.engine}: median and equal-tailed intervals"
    return table(head, rows, title=title, note=_PUBLISHED * bool(answer), numbers=range(1, len(head)))


def budget_table(posterior: Posterior) -> pd.DataFrame | None:
    """Return the share of each input in the variance of ln G_s, the largest first; None if they do not add up."""
    if not add_up(posterior.shares):
        return None
    ordered = sorted(posterior.shares.items(), key=lambda item: (item[0] == REST, -item[1]))
    rows = [(Symbols(input_words(name)), f"{100.0 * share:.1f} %") for name, share in ordered]
    head = ("source", Symbols("share of the variance of ln G_s"))
    return table(head, rows, title="Error budget", numbers=(1,), bars=[share for _, share in ordered])


def narrowing_table(posterior: Posterior) -> pd.DataFrame:
    """Return the expected standard deviation of ln G_s after one more measurement, the narrowest first."""
    expected = posterior.expected_log_modulus_sds
    ordered = sorted(expected.items(), key=lambda item: item[1])
    rows = [(Symbols("nothing"), f"{posterior.log_modulus_sd:.2g}")]
    rows += [(Symbols(later_words(name)), f"{sd:.2g}") for name, sd in ordered]
    head = ("measured in addition", Symbols("expected sd of ln G_s"))
    return table(head, rows, title="What would narrow it", numbers=(1,))


def input_table(posterior: Posterior) -> pd.DataFrame:
    """Return what was measured and known, each with its error."""
    rows = []
    for name, stated in posterior.as_dict()["inputs"].items():
        if isinstance(stated, dict) and stated.get("value") is not None:
            scale, unit = stated_in(name, stated["unit"])
            value, error = scale * stated["value"], scale * (stated["error"] or 0.0)
            digits = two_digits(error)
            words = f"{value:.{digits}f} ± {error:.{digits}f}{unit}" if error else f"{value:g}{unit}"
            relative = f"{100.0 * error / value:.2g} %" if error else "taken as known"
            rows.append((Symbols(input_words(name)), Symbols(words), relative))
    return table(("input", "value ± standard error", "relative error"), rows, title="Inputs", numbers=(1, 2))


def prior_table(posterior: Posterior) -> pd.DataFrame:
    """Return the prior of each parameter."""
    rows = []
    for name, prior in posterior.as_dict()["prior"].items():
        parameter = PARAMETERS[name]
        unit, shown = unit_of(parameter), {key: f"{parameter.shown(prior[key]):.5g}" for key in _PRIOR if key in prior}
        if prior.get("sd") == 0.0:
            words = f"known, {shown['mean']}{unit}"
        elif math.isinf(prior["low"]) or math.isinf(prior["high"]):
            words = f"{prior['distribution']}, {shown['mean']} ± {shown['sd']}{unit}"
        else:
            words = f"{prior['distribution']} from {shown['low']} to {shown['high']}{unit}"
        rows.append((Symbols(parameter.symbol), parameter.meaning, words))
    return table(("", "", "prior"), rows, title="Priors")


def comparison_table(posteriors: Mapping[str, Posterior]) -> pd.DataFrame:
    """Return what was found and stated of capsules by their names, one column each, with ≠ in rows that differ."""
    rows = []
    for name in _COMPARED:
        found = [posterior.marginals[name] for posterior in posteriors.values()]
        cells = [f"{median} ({ends})" for median, _, ends in (marginal_cells(name, marginal) for marginal in found)]
        apart = max(marginal.lower_95 for marginal in found) > min(marginal.upper_95 for marginal in found)
        rows.append(_compared(PARAMETERS[name].label, cells, differ=apart))
    stated = [dict(_stated(posterior)) for posterior in posteriors.values()]
    for label in dict.fromkeys(label for column in stated for label in column):
        cells = [column.get(label, "") for column in stated]
        rows.append(_compared(label, cells, differ=len(set(cells)) > 1))
    return table(("", *posteriors), rows, title="Capsules side by side", note=_DIFFER)


def _compared(label: str, cells: Sequence[str], *, differ: bool) -> tuple[str, ...]:
    return (Symbols(f"≠ {label}"), *map(Strong, cells)) if differ else (Symbols(label), *cells)


def _stated(posterior: Posterior) -> Iterator[tuple[str, str]]:
    """Yield whether a posterior can be used, and what it was computed from but the measured lengths."""
    yield "can be used", "yes" if posterior.status.ok else f"no: {posterior.status}"
    yield "membrane", membrane_words(posterior.model_name)
    yield "cross-section of the channel", posterior.experiment.cross_section
    of_both = prior_table(posterior)[:2]  # G_s and a; the others are a model's
    for symbol, _, words in of_both.itertuples(index=False):
        yield f"prior of {symbol}", words
    for label, words, _ in input_table(posterior).itertuples(index=False):
        if label not in map(input_words, ("axial_extent", "axial_length")):
            yield label, words


def tension_table(tension: MembraneTension) -> pd.DataFrame:
    """Return what the membrane bears."""
    found = {name: marginal for name, marginal in vars(tension).items() if isinstance(marginal, Marginal)}
    known = {name: PARAMETERS[name] for name in found}
    rows = [(Symbols(it.label), Symbols(it.meaning), *marginal_cells(name, found[name])) for name, it in known.items()]
    return table(("", "", "median", "68 % interval", "95 % interval"), rows, title="Membrane", numbers=(2, 3, 4))


def tension_words(tension: MembraneTension) -> str:
    """Say where the tension is largest, or why it is not known."""
    if tension.largest_tension is None:
        return "Here it is not known: the posterior reaches beyond the simulated membranes."
    x, y, z = tension.place
    radius = with_unit("capsule_radius", math.hypot(x, y), ".0f")
    half = "front" if z > 0.0 else "rear"
    return f"Here that is in the {half} half, about {radius} from the axis, to a quarter of the channel's half width."


def check_table(posterior: Posterior) -> pd.DataFrame:
    """Return every check of the computation, whether it passed."""
    rows = []
    for gate in posterior.gates:
        value = f"{gate.value:.0f}" if abs(gate.value) >= 1e4 else f"{gate.value:.4g}"
        rows.append(("passed" if gate.passed else Strong("FAILED"), gate.name, value, gate.wanted))
    return table(("", "check", "found", "wanted"), rows, title="Checks of the computation", numbers=(2,))


def origin_table(posterior: Posterior) -> pd.DataFrame:
    """Return where it comes from: files and their hashes, database, engine, seed, version."""
    files = (("capsule", posterior.measurement), ("experiment", posterior.experiment))
    rows: list[tuple[str, ...]] = []
    rows += [(what, Path(file.source).name, Code(file.sha256 or "not known")) for what, file in files if file.source]
    rows += [
        ("model", posterior.model_name, Code(posterior.model_sha256)),
        ("cross-section of the channel", posterior.experiment.cross_section, ""),
        ("engine", posterior.engine, ""),
        ("seed", str(posterior.seed), ""),
        ("capsbayes", f"version {posterior.version}", ""),
    ]
    return table(("", "", "sha256"), rows, title="Origin")


def posterior_parts(posterior: Posterior) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of a posterior."""
    yield quantity_table(posterior)
    yield agreement_words(posterior)
    if (budget := budget_table(posterior)) is not None:
        yield budget
    yield budget_sentence(posterior)
    if posterior.expected_log_modulus_sds:
        yield narrowing_table(posterior)
    yield input_table(posterior)
    yield prior_table(posterior)
    yield update_words(posterior)
    if (differences := resimulation_table(posterior)) is not None:
        yield differences
    yield resimulation_words(posterior)
    yield from caveats(posterior)
