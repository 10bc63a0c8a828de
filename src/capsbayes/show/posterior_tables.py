"""Tables of a posterior's page: quantities, error budget, inputs, priors, gates, provenance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from capsbayes.infer import Posterior
from capsbayes.parameters import PARAMETERS
from capsbayes.show.page import table, typeset
from capsbayes.show.posterior_words import input_words
from capsbayes.show.rounding import interval_words, rounded, unit_of

__all__ = ["budget_table", "gate_table", "input_table", "origin_table", "prior_table", "quantity_table"]


def quantity_table(posterior: Posterior) -> Markup:
    """Median and intervals of every quantity, beside the second engine and the deterministic answer."""
    answer = {} if posterior.deterministic is None else posterior.deterministic.as_dict()
    head = ["", "median", "68 % interval", "95 % interval"]
    head += ["by quadrature"] * bool(posterior.reference) + ["deterministic"] * bool(answer)
    rows = []
    for name, one in posterior.marginals.items():
        digits = _two_digits(PARAMETERS[name].shown(one.sd))
        numbers = [one.median, *([posterior.reference[name].median] if posterior.reference else [])]
        numbers += [answer.get(name, math.nan)] if answer else []
        middle, *others = (rounded(PARAMETERS[name].shown(x), digits) if math.isfinite(x) else "" for x in numbers)
        limits = (one.lower_68, one.upper_68), (one.lower_95, one.upper_95)
        ends = [interval_words(name, low, high, digits) for low, high in limits]
        rows.append([_labelled(name), middle, *ends, *others])
    return table(head, rows, numbers=range(1, len(head)))


def budget_table(posterior: Posterior) -> Markup:
    """Share of the variance of log G_s owed to each input, the largest first."""
    ordered = sorted(posterior.shares.items(), key=lambda one: -one[1])
    whole = max(abs(share) for share in posterior.shares.values())
    rows = [(typeset(input_words(name)) + _bar(share / whole), f"{100.0 * share:.1f} %") for name, share in ordered]
    return table(("owed to", typeset("of the variance of ln G_s")), rows, numbers=(1,), lead=True)


def input_table(posterior: Posterior) -> Markup:
    """What was measured and known, each with its error."""
    rows = []
    for name, one in posterior.as_dict()["inputs"].items():
        if isinstance(one, dict) and one.get("value") is not None:
            rows.append((typeset(input_words(name)), *_with_error(name, one)))
    return table(("input", "value ± standard error", "relative error"), rows, numbers=(1, 2), lead=True)


def prior_table(posterior: Posterior) -> Markup:
    """What was believed before."""
    rows = []
    for name, one in posterior.as_dict()["prior"].items():
        shown = PARAMETERS[name]
        ends = [f"{shown.shown(one[end]):g}" for end in ("low", "high")]
        words = f"{one['distribution']} from {ends[0]} to {ends[1]}{unit_of(shown)}"
        if math.isinf(one["low"]) or math.isinf(one["high"]):
            words = f"{one['distribution']}, {shown.shown(one['mean']):g} ± {shown.shown(one['sd']):g}{unit_of(shown)}"
        rows.append((_labelled(name, unit=False), shown.meaning, words))
    return table(("", "", "prior"), rows)


def gate_table(posterior: Posterior) -> Markup:
    """Every check of the computation, whether it passed."""
    rows = [
        ("passed" if gate.passed else Markup("<b>FAILED</b>"), gate.name, _found(gate.value), gate.wanted)
        for gate in posterior.gates
    ]
    return table(("", "check", "found", "wanted"), rows, numbers=(2,))


def origin_table(posterior: Posterior) -> Markup:
    """Where it comes from: files and their hashes, database, engine, seed, version."""
    seen, known = posterior.measurement, posterior.experiment
    rows: list[tuple[str, Any]] = [
        (what, _file(one.source, one.sha256)) for what, one in (("capsule", seen), ("experiment", known)) if one.source
    ]
    rows += [
        ("model", Markup("{}, sha256 <code>{}</code>").format(posterior.model_name, posterior.model_sha256)),
        ("cross-section of the channel", known.cross_section),
        ("engine", posterior.engine),
        ("seed", str(posterior.seed)),
        ("capsbayes", f"version {posterior.version}"),
    ]
    return table((), rows)


def _file(source: str, sha256: str) -> Markup:
    return Markup("{}, sha256 <code>{}</code>").format(Path(source).name, sha256 or "not known")


def _labelled(name: str, *, unit: bool = True) -> Markup:
    one = PARAMETERS[name]
    text = typeset(one.symbol)
    shown = unit_of(one).strip()
    return Markup("{}&nbsp;[{}]").format(text, shown) if unit and shown else text


def _bar(share: float) -> Markup:
    """A bar under the text of its cell, as long as a share of it; hatched below zero."""
    kind = "bar below" if share < 0.0 else "bar"
    return Markup('<span class="{}" style="width: {}%"></span>').format(kind, f"{100.0 * abs(share):.1f}")


def _found(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"


def _two_digits(error: float) -> int:
    return max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3


def _with_error(name: str, one: dict[str, Any]) -> tuple[str, str]:
    """Value with its error in the unit people read, and the relative error."""
    shown = PARAMETERS[name]
    over_l = one["unit"] == "l"
    scale, unit = (1.0, " ℓ") if over_l else (1e6, " µm") if one["unit"] == "m" else (shown.scale, unit_of(shown))
    value, error = scale * one["value"], scale * (one["error"] or 0.0)
    if not error:
        return f"{value:g}{unit}", "taken as known"
    digits = _two_digits(error)
    return f"{value:.{digits}f} ± {error:.{digits}f}{unit}", f"{100.0 * error / value:.2g} %"
