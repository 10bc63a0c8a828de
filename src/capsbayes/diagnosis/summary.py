"""A study as numbers and text, as it is stored."""

from __future__ import annotations

import math
from typing import Any

import capsbayes
from capsbayes.diagnosis.compared import Compared
from capsbayes.diagnosis.diagnosis import Study, Verification
from capsbayes.diagnosis.finding import Finding
from capsbayes.diagnosis.scoring import Scores

__all__ = ["summary"]


def summary(study: Study) -> dict[str, Any]:
    """What `diagnose` found, for a JSON file.

    Parameters
    ----------
    study : Study

    Returns
    -------
    dict
        Lengths in metres, moduli in N/m, flow rates in m^3/s, effects in the unit of their parameter; None where there
        is no number.
    """
    model = study.model if study.discover is None else study.discover.model
    return {
        "verdict": study.verdict.name,
        "sentence": str(study),
        "effects": list(study.names),
        "sizes": dict(study.sizes),
        "finding": _finding(study.finding),
        "not_seen_again": None if study.again is None else _finding(study.again),
        "log_evidence": dict(study.evidence),
        "candidates": [_candidate(study, name, one) for name, one in study.scores.items()],
        "held_out": None if study.verification is None else _verification(study.verification),
        "capsules": len(study.session),
        "with_outline": sum(one.outline is not None for one in study.session.measurements),
        "left_out": list(study.session.left_out),
        "model": {"name": model.name, "sha256": model.sha256},
        "files": {one.source: one.sha256 for one in study.session.measurements if one.sha256},
        "experiment": {"file": study.session.experiment.source, "sha256": study.session.experiment.sha256},
        "seed": study.seed,
        "level": study.level,
        "version": capsbayes.__version__,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    rows = [
        {
            "name": one.name,
            "size": _number(one.size),
            "error": _number(one.error),
            "unit": one.unit,
            "sigma": _number(one.sigma),
            "p_value": one.p_value,
        }
        for one in finding.deviations
    ]
    return {
        "p_value": finding.p_value,
        "noise_over_stated": _number(finding.noise),
        "capsules": finding.capsules,
        "deviations": rows,
    }


def _candidate(study: Study, name: str, scores: Scores) -> dict[str, Any]:
    low, high = scores.interval()
    return {
        "parameter": name,
        "effect": scores.effect.name,
        "log_likelihood_ratio": scores.log_likelihood_ratio,
        "size": scores.size,
        "interval_68": [low, high],
        "median_surface_shear_modulus": _number(scores.modulus[scores.best]),
        "unit": scores.effect.parameter.unit,
        "kind": scores.effect.kind.name,
        "may_explain": name in study.names,
        "changes": scores.effect.changes,
        "separated_by": scores.effect.separated_by,
    }


def _verification(verification: Verification) -> dict[str, Any]:
    findings = verification.before, verification.after
    return {
        "capsules": len(verification.log_likelihood_ratios),
        "log_likelihood_ratio_per_capsule": verification.log_likelihood_ratio,
        "log_likelihood_ratio_error": verification.error,
        **{
            when: _finding(finding) | _moduli(compared)
            for when, finding, compared in zip(("before", "after"), findings, verification.compared, strict=True)
        },
    }


def _moduli(compared: Compared) -> dict[str, Any]:
    return {
        "gap": _number(compared.gap),
        "median_surface_shear_modulus": _number(compared.median_modulus),
        "surface_shear_modulus": [_number(one) for one in compared.modulus],
        "surface_shear_modulus_error": [_number(one) for one in compared.modulus_error],
        "size_ratio": [_number(one) for one in compared.fits.size],
        "by_flow_rate": [
            {"flow_rate": rate, "capsules": count, "median_surface_shear_modulus": _number(median)}
            for rate, (count, median) in compared.modulus_at_flow_rates.items()
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
