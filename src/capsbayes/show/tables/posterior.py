"""Tables of a posterior: quantities, error budget, inputs, priors, checks, provenance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd

from capsbayes.infer import Posterior
from capsbayes.infer.identify import REST, add_up
from capsbayes.parameters import PARAMETERS
from capsbayes.show.tables.table import Code, Strong, Symbols, table
from capsbayes.show.words.posterior import input_words, later_words
from capsbayes.show.words.rounding import interval_words, rounded, stated_in, two_digits, unit_of


def quantity_table(posterior: Posterior) -> pd.DataFrame:
    """Return median and intervals of every quantity, with the second engine and the published procedure."""
    answer = {} if posterior.deterministic is None else posterior.deterministic.as_dict()
    head = ["", "median", "68 % interval", "95 % interval"]
    head += ["quadrature"] * bool(posterior.reference) + ["published"] * bool(answer)
    rows = []
    for name, marginal in posterior.marginals.items():
        parameter = PARAMETERS[name]
        digits = two_digits(parameter.shown(marginal.sd))
        numbers = [marginal.median, *([posterior.reference[name].median] if posterior.reference else [])]
        numbers += [answer.get(name, math.nan)] if answer else []
        middle, *others = (rounded(parameter.shown(x), digits) if math.isfinite(x) else "" for x in numbers)
        limits = (marginal.lower_68, marginal.upper_68), (marginal.lower_95, marginal.upper_95)
        ends = [interval_words(name, low, high, digits) for low, high in limits]
        rows.append([Symbols(parameter.label), middle, *ends, *others])
    title = f"Posterior by {posterior.engine}: median and equal-tailed intervals"
    return table(head, rows, title=title, numbers=range(1, len(head)))


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
    rows = [
        (Symbols(input_words(name)), *_with_error(name, stated))
        for name, stated in posterior.as_dict()["inputs"].items()
        if isinstance(stated, dict) and stated.get("value") is not None
    ]
    return table(("input", "value ± standard error", "relative error"), rows, title="Inputs", numbers=(1, 2))


def prior_table(posterior: Posterior) -> pd.DataFrame:
    """Return the prior of each parameter."""
    rows = []
    for name, prior in posterior.as_dict()["prior"].items():
        shown = PARAMETERS[name]
        ends = [f"{shown.shown(prior[end]):g}" for end in ("low", "high")]
        words = f"{prior['distribution']} from {ends[0]} to {ends[1]}{unit_of(shown)}"
        if math.isinf(prior["low"]) or math.isinf(prior["high"]):
            mean, sd = (f"{shown.shown(prior[key]):g}" for key in ("mean", "sd"))
            words = f"{prior['distribution']}, {mean} ± {sd}{unit_of(shown)}"
        if prior.get("sd") == 0.0:
            words = f"known, {shown.shown(prior['mean']):g}{unit_of(shown)}"
        rows.append((Symbols(shown.symbol), shown.meaning, words))
    return table(("", "", "prior"), rows, title="Priors")


def check_table(posterior: Posterior) -> pd.DataFrame:
    """Return every check of the computation, whether it passed."""
    rows = [
        (
            "passed" if gate.passed else Strong("FAILED"),
            gate.name,
            f"{gate.value:.0f}" if abs(gate.value) >= 1e4 else f"{gate.value:.4g}",
            gate.wanted,
        )
        for gate in posterior.gates
    ]
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


def _with_error(name: str, stated: dict[str, Any]) -> tuple[str, str]:
    """Value with its error in the display unit, and the relative error."""
    scale, unit = stated_in(name, stated["unit"])
    value, error = scale * stated["value"], scale * (stated["error"] or 0.0)
    if not error:
        return Symbols(f"{value:g}{unit}"), "taken as known"
    digits = two_digits(error)
    return Symbols(f"{value:.{digits}f} ± {error:.{digits}f}{unit}"), f"{100.0 * error / value:.2g} %"
