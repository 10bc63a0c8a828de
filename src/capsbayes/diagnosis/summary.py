"""Numbers and text of a study, as they are stored."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

import capsbayes
from capsbayes.diagnosis.comparison import Comparison
from capsbayes.diagnosis.diagnosis import Study, Verification
from capsbayes.diagnosis.finding import Finding


def summary(study: Study) -> dict[str, Any]:
    """Return the results of a diagnosis, ready for JSON: in SI, effects in their unit, None for no number."""
    model = study.tested_model
    return {
        "verdict": study.verdict.name,
        "sentence": str(study),
        "effects": list(study.names),
        "something_else": study.something_else,
        "not_testable": list(study.not_testable),
        "sizes": dict(study.sizes),
        "finding": _finding(study.finding),
        "not_seen_again": None if study.second_finding is None else _finding(study.second_finding),
        "log_evidence": dict(study.evidence),
        "probabilities": dict(study.all_probabilities),
        "surface_shear_modulus": _session(study),
        "limits_95": _records(study.limits, "parameter"),
        "candidates": _candidates(study),
        "held_out": None if study.verification is None else _verification(study.verification),
        "capsules": len(study.session),
        "with_outline": sum(measurement.outline is not None for measurement in study.session.measurements),
        "left_out": list(study.session.left_out),
        "model": {"name": model.name, "sha256": model.sha256},
        "files": {
            measurement.source: measurement.sha256 for measurement in study.session.measurements if measurement.sha256
        },
        "experiment": {"file": study.session.experiment.source, "sha256": study.session.experiment.sha256},
        "seed": study.seed,
        "level": study.level,
        "version": capsbayes.__version__,
    }


def _session(study: Study) -> dict[str, Any]:
    found = study.surface_shear_modulus
    return {"median": _number(found.median), "interval_95": [_number(found.low), _number(found.high)]}


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "p_value": finding.p_value,
        "noise_over_assumed": _number(finding.noise),
        "further_noise_over_l": finding.further_noise,
        "capsules": finding.capsules,
        "deviations": _records(finding.table(), "name"),
    }


def _candidates(study: Study) -> list[dict[str, Any]]:
    rows = _records(study.table(), "parameter")
    for row in rows:
        row["interval_68"] = [row.pop("low"), row.pop("high")]
        row["median_surface_shear_modulus"] = row.pop("surface_shear_modulus")
    return rows


def _records(table: pd.DataFrame, index: str) -> list[dict[str, Any]]:
    """Return the rows of a table with the name of its index; None where there is no number."""
    named = table.rename_axis(index).reset_index().astype(object)
    return [dict(zip(named.columns, row, strict=True)) for row in named.where(named.notna(), None).to_numpy()]


def _verification(verification: Verification) -> dict[str, Any]:
    findings = verification.before, verification.after
    return {
        "capsules": len(verification.log_likelihood_ratios),
        "log_likelihood_ratio_per_capsule": verification.log_likelihood_ratio,
        "log_likelihood_ratio_error": verification.error,
        "log_score_of_something_else": verification.of_something_else,
        **{
            when: _finding(finding) | _moduli(compared, gap)
            for when, finding, compared, gap in zip(
                ("before", "after"), findings, verification.comparisons, verification.gaps, strict=True
            )
        },
    }


def _moduli(compared: Comparison, gap: float) -> dict[str, Any]:
    return {
        "gap": _number(gap),
        "without_a_shape": list(compared.outliers),
        "median_surface_shear_modulus": _number(compared.median_modulus),
        "surface_shear_modulus": [_number(value) for value in compared.modulus],
        "surface_shear_modulus_error": [_number(value) for value in compared.modulus_error],
        "size_ratio": [_number(value) for value in compared.fits.size],
        "by_flow_rate": [
            {"flow_rate": rate, "capsules": count, "median_surface_shear_modulus": _number(median)}
            for rate, (count, median) in compared.modulus_at_flow_rates.items()
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
