"""The file of a posterior: one NetCDF file of groups that ArviZ reads, and a record by which it is read back whole."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from capsbayes.errors import InputError
from capsbayes.experiment import WATER, Experiment
from capsbayes.files.input_file import check_file, parsing
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.deterministic import DeterministicAnswer
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.prior import THICKNESS, Prior
from capsbayes.measured_outline import MeasuredOutline, OutlineNoise, Pose
from capsbayes.measurement import Measurement
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity, json_number
from capsbayes.status import Status

RECORD = "record"
"""Attribute of the file that holds `record_of`."""
WORK = "work"
"""Attribute of the file that holds the hash of what the posterior is computed from, empty if it was not stated."""

LOG_MODULUS_SD = "sd_of_log_surface_shear_modulus"
"""Attribute of the file of a posterior over several further coordinates: found, were they known, and expected."""

OVER_LAWS = "surface_shear_modulus_over_laws"
"""Attribute of the file of a posterior with one law: the least and the largest G_s of others."""

_MEASURED = (
    "axial_extent",
    "axial_extent_error",
    "capsule_velocity",
    "capsule_velocity_error",
    "axial_length",
    "axial_length_error",
    "length_correlation",
    "over_half_width",
    "source",
    "sha256",
    "axial_length_bound",
    "flow_rate",
    "flow_rate_error",
    "walls",
    "doubt",
)
_FLUID = ("viscosity", "viscous_tension")
_MARGINAL = tuple(field.name for field in fields(Marginal))


def record_of(seen: Measurement, known: Experiment, prior: Prior, gates: Sequence[Gate]) -> dict[str, Any]:
    """Return what the tables of a posterior omit, ready for JSON.

    The points of a measured outline are in a group of the file: they are too many for an attribute.
    """
    measured = {name: getattr(seen, name) for name in _MEASURED} | {"conditions": dict(seen.conditions)}
    measured["experiment_file"] = None if seen.experiment_file is None else str(seen.experiment_file)
    if seen.outline is not None:
        noise, pose = vars(seen.outline.noise), vars(seen.outline.pose)
        measured["outline"] = {"noise": noise, "pose": pose, "view": seen.outline.view}
    rate = known.frame_rate
    return {
        "measurement": measured,
        "experiment": {
            "cross_section": known.cross_section,
            "half_width": known.half_width.as_record(),
            **{name: _recorded(getattr(known, name)) for name in _FLUID},
            "source": known.source,
            "sha256": known.sha256,
            "density": known.density.as_record(),
            THICKNESS: _recorded(known.membrane_thickness),
            "frame_rate": None if rate is None else {"value": rate.value, "error": rate.error, "unit": rate.unit},
        },
        "coordinates": {name: quantity.as_record() for name, quantity in prior.coordinates.items()},
        "gates": [[gate.name, *map(json_number, (gate.value, gate.least, gate.most))] for gate in gates],
    }


def _recorded(quantity: Quantity | None) -> Any:
    return None if quantity is None else quantity.as_record()


def work_of(path: Path) -> str | None:
    """Return the hash of what the posterior of a file was computed from, None if it is missing or damaged."""
    import h5netcdf

    try:
        with h5netcdf.File(path, "r") as file:
            return str(file.attrs.get(WORK, ""))
    except OSError:
        return None


def read_fields(path: Path) -> dict[str, Any]:
    """Read the fields of the `Posterior` that a file holds.

    Raises
    ------
    InputError
        If it is missing, damaged, or no such file.
    """
    import h5netcdf

    check_file(path, "file of a posterior")
    with parsing(str(path), "the file of a posterior"), h5netcdf.File(path, "r") as file:
        attributes = {name: file.attrs[name] for name in file.attrs}
        groups = {name: {key: variable[...] for key, variable in file[name].variables.items()} for name in file.groups}
    if RECORD not in attributes or "posterior" not in groups:
        expected, advice = "the file of a posterior, as capsbayes identify writes it", "identify the capsule again"
        raise InputError(str(path), "", expected, "one that lacks what makes it whole", advice)
    with parsing(str(path), "the file of a posterior, whole"):
        return _fields(attributes, groups)


def _fields(attributes: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    tables = {name: _loaded(value) for name, value in attributes.items()}
    record = tables[RECORD]
    measurement = _measurement(record["measurement"], groups["observed_data"].get("outline"))
    experiment = _experiment(record["experiment"])
    draws = {name: values for name, values in groups["posterior"].items() if values.ndim == 2}
    outlines = groups.get("posterior_predictive", {}).get("outline")
    agreement, answer = tables["agreement"], tables["deterministic"]
    return {
        "draws": draws | {name: values for name, values in groups.get("sample_stats", {}).items() if name == "lp"},
        "ensemble": groups["posterior"]["ensemble"],
        "marginals": {name: _marginal(table) for name, table in tables["quantities"].items()},
        "reference": {name: _marginal(table) for name, table in tables["quadrature"].items()},
        "measurement": measurement,
        "experiment": experiment,
        "prior": Prior.of_record(tables["prior"], record["coordinates"]),
        "inputs": Inputs.of(measurement, experiment),
        "model_name": tables["model"]["name"],
        "model_sha256": tables["model"]["sha256"],
        "engine": str(attributes["engine"]),
        "seed": int(attributes["seed"]),
        "gates": tuple(Gate(name, *map(float, numbers)) for name, *numbers in record["gates"]),
        "agreement": None if agreement is None else Agreement(**_without(agreement, "sentence")),
        "shares": tables["variance_of_log_surface_shear_modulus"],
        "deterministic": None if answer is None else _answer(answer),
        "leaning": tables["share_next_to_border"],
        "outlines": None if outlines is None else outlines[0],
        "status": Status[attributes["status"]],
        "version": str(attributes["version"]),
        "p_values": tables.get("p_values", {}),
        "modulus_over_laws": tuple(tables[OVER_LAWS]) if OVER_LAWS in tables else None,
        "expected_log_modulus_sds": tables.get(LOG_MODULUS_SD, {}).get("expected", {}),
        "log_modulus_sd_if_known": tables.get(LOG_MODULUS_SD, {}).get("if_coordinates_known"),
    }


def _loaded(value: Any) -> Any:
    """Return an attribute read as JSON where it is JSON."""
    try:
        return json.loads(value) if isinstance(value, str) else value
    except json.JSONDecodeError:
        return value


def _without(table: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in table.items() if name not in names}


def _marginal(table: Mapping[str, Any]) -> Marginal:
    return Marginal(**{name: float(table[name]) for name in _MARGINAL})


def _answer(table: Mapping[str, float]) -> DeterministicAnswer:
    own: dict[str, Any] = {
        name: value for name, value in table.items() if name in DeterministicAnswer.__dataclass_fields__
    }
    own.setdefault("mean_velocity", None)
    return DeterministicAnswer(**own, assumed=_without(table, *own))


def _measurement(table: Mapping[str, Any], points: Any) -> Measurement:
    outline, file = table.get("outline"), table["experiment_file"]
    seen = None
    if outline is not None:
        seen = MeasuredOutline(points, OutlineNoise(**outline["noise"]), Pose(**outline["pose"]), outline["view"])
    known = _without(table, "outline", "experiment_file")
    return Measurement(**known, outline=seen, experiment_file=None if file is None else Path(file))


def _experiment(table: Mapping[str, Any]) -> Experiment:
    rate, thickness = table["frame_rate"], table.get(THICKNESS)
    viscosity, tension = (
        None if table.get(name) is None else Quantity.of_record(table[name], PARAMETERS[name].si) for name in _FLUID
    )
    return Experiment(
        cross_section=table["cross_section"] if "cross_section" in table else table["section"],
        half_width=Quantity.of_record(table["half_width"], "m"),
        viscosity=viscosity,
        viscous_tension=tension,
        source=table["source"],
        sha256=table["sha256"],
        frame_rate=None if rate is None else Quantity(**rate),
        density=Quantity.of_record(table["density"], "kg/m^3") if "density" in table else WATER,
        membrane_thickness=None if thickness is None else Quantity.of_record(thickness, "m"),
    )
