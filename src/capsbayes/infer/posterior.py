"""The posterior of one capsule: draws, summary, and its file."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from capsbayes import __version__
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, capsule_radius, surface_shear_modulus
from capsbayes.files.input_file import check_file, parsing
from capsbayes.files.output_file import write_dataset
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.predictive import Predictive
from capsbayes.infer.prior import LIMITED, THICKNESS, Inputs, Marginal, Prior
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise, Pose
from capsbayes.model import ForwardModel, name_parts
from capsbayes.parameters import PARAMETERS
from capsbayes.prediction import ERRING
from capsbayes.quantity import Quantity, json_number
from capsbayes.readable import as_html
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


# What results have in common: draws as datasets with units, JSON in attributes, groups as an `arviz.InferenceData`


def chains(arrays: Mapping[str, Floats], **coordinates: Any) -> xr.Dataset:
    """Return (chain, draw) arrays as a dataset, with the attributes of the quantities that they are named for."""
    import xarray as xr

    number, length = next(iter(arrays.values())).shape
    known = {name: PARAMETERS[name] for name in arrays if name in PARAMETERS}
    attributes = {name: {"long_name": it.meaning, "symbol": it.symbol, "units": it.unit} for name, it in known.items()}
    variables = {name: (("chain", "draw"), values, attributes.get(name)) for name, values in arrays.items()}
    return xr.Dataset(variables, {"chain": np.arange(number), "draw": np.arange(length), **coordinates})


def read_attributes(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return attributes of a file, read as JSON where they are JSON."""
    return {str(name): _loaded(value) for name, value in attributes.items()}


def _loaded(value: Any) -> Any:
    try:
        return json.loads(value) if isinstance(value, str) else value
    except json.JSONDecodeError:
        return value


def inference_data(groups: Mapping[str, xr.Dataset], units: str) -> Any:
    """Return groups as an `arviz.InferenceData`, if they are wanted with quantities in display units."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of ArviZ itself, once a day
        import arviz  # a second to import
    if units == "shown":
        groups = {name: group if name.startswith("log_") else _shown(group) for name, group in groups.items()}
    return arviz.InferenceData(**groups, warn_on_custom_groups=False)


def check_units(units: str, where: str) -> None:
    """Refuse units that are neither SI nor those of display."""
    if units not in ("si", "shown"):
        raise InputError(where, "units", '"si" or "shown"', repr(units))


def _shown(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset with all quantities in display units, named as ``G_s [mN/m]``."""
    made = {}
    for name, variable in dataset.data_vars.items():
        parameter = PARAMETERS.get(str(name).removesuffix("_error"))
        if parameter is None:
            made[str(name)] = variable
            continue
        metres = variable.attrs.get("units") == "m" and parameter.unit == "l"
        scale, unit = (1e6, "µm") if metres else (parameter.scale, parameter.shown_unit)
        error = "error of " if str(name).endswith("_error") else ""
        label = f"{error}{parameter.symbol} [{unit}]" if unit not in ("", "-") else f"{error}{parameter.symbol}"
        made[label] = (scale * variable).assign_attrs({**variable.attrs, "units": unit})
    return dataset.drop_vars(list(dataset.data_vars)).assign(made)


# Deterministic identification of the same capsule by the procedure of the paper: one number each, no errors


@dataclass(frozen=True)
class DeterministicAnswer:
    """Quantities by diffuse approximation, SI; named as in `capsbayes.parameters`."""

    # The mean velocity is missing where mu U is given as one quantity. `assumed` holds the null value of a further
    # coordinate of the model, which the procedure does not know.

    surface_shear_modulus: float
    capsule_radius: float
    mean_velocity: float | None
    capillary_number: float
    size_ratio: float
    velocity_ratio: float
    assumed: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, float]:
        """Return the quantities by name, those assumed included."""
        quantities = asdict(self)
        quantities |= quantities.pop("assumed")
        return {name: value for name, value in quantities.items() if value is not None}


def deterministic_answer(measurement: Measurement, model: ForwardModel, inputs: Inputs) -> DeterministicAnswer | None:
    """Identify with the paper's procedure on the model's database."""
    database = model.database
    if database is None or measurement.axial_length is None:
        return None
    from capsbayes.surrogate import inverse

    scale = 1.0 if measurement.over_half_width else inputs.half_width.value
    found = inverse(database)(
        axial_extent=measurement.axial_extent / scale, axial_length=measurement.axial_length / scale
    )
    flow = inputs.mean_velocity(found.velocity_ratio)
    modulus = surface_shear_modulus(
        viscosity=inputs.viscosity.value, mean_velocity=flow, capillary_number=found.capillary_number
    )
    radius = capsule_radius(size_ratio=found.size_ratio, half_width=inputs.half_width.value)
    assumed = {name: ends.null_value for name, ends in model.coordinates.items()}
    shape = found.capillary_number, found.size_ratio, found.velocity_ratio
    known = None if inputs.viscous_tension else float(flow)
    return DeterministicAnswer(float(modulus), float(radius), known, *shape, assumed)


# The file of a posterior: one NetCDF file of groups that ArviZ reads, and a record by which it is read back whole

RECORD = "record"  # attribute of the file that holds `record_of`
WORK = "work"
"""Attribute of the file that holds the hash of what the posterior is computed from, empty if it was not stated."""

LOG_MODULUS_SD = "sd_of_log_surface_shear_modulus"
"""Attribute of the file of a posterior over several further coordinates: found, were they known, and expected."""

OVER_LAWS = "surface_shear_modulus_over_laws"
"""Attribute of the file of a posterior with one law: the least and the largest G_s of others."""

RESIMULATED = "resimulation"
"""Attribute and group of the file of a posterior that the simulator corrected."""

_APART = ("outline", "experiment_file", "conditions", "status")  # of a measurement: not stored as they are
_TEXTS = ("cross_section", "source", "sha256")  # of an experiment
_QUANTITIES = ("half_width", "viscosity", "viscous_tension", "density", THICKNESS)


def record_of(seen: Measurement, known: Experiment, prior: Prior, gates: Sequence[Gate]) -> dict[str, Any]:
    """Return what the tables of a posterior omit, ready for JSON."""
    # The points of a measured outline are in a group of the file: they are too many for an attribute.
    measured = {each.name: getattr(seen, each.name) for each in fields(seen) if each.name not in _APART}
    file = seen.experiment_file and str(seen.experiment_file)
    measured |= {"conditions": dict(seen.conditions), "experiment_file": file}
    if seen.outline is not None:
        noise, pose = vars(seen.outline.noise), vars(seen.outline.pose)
        measured["outline"] = {"noise": noise, "pose": pose, "view": seen.outline.view}
    rate, quantities = known.frame_rate, {name: getattr(known, name) for name in _QUANTITIES}
    return {
        "measurement": measured,
        "experiment": {
            **{name: getattr(known, name) for name in _TEXTS},
            **{name: quantity and quantity.as_record() for name, quantity in quantities.items()},
            "frame_rate": rate and {"value": rate.value, "error": rate.error, "unit": rate.unit},
        },
        "coordinates": {name: quantity.as_record() for name, quantity in prior.coordinates.items()},
        "gates": [[gate.name, *map(json_number, (gate.value, gate.least, gate.most, gate.doubtful))] for gate in gates],
    }


def work_of(path: Path) -> str | None:
    """Return the hash of what the posterior of a file was computed from, None if it is missing or damaged."""
    import h5netcdf

    try:
        with h5netcdf.File(path, "r") as file:
            return str(file.attrs.get(WORK, ""))
    except OSError:
        return None


def _fields(attributes: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the fields of the `Posterior` that a file holds."""
    tables = read_attributes(attributes)
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
        "refinement": tables.get("refinement"),
        "modulus_over_laws": tuple(tables[OVER_LAWS]) if OVER_LAWS in tables else None,
        "expected_log_modulus_sds": tables.get(LOG_MODULUS_SD, {}).get("expected", {}),
        "log_modulus_sd_if_known": tables.get(LOG_MODULUS_SD, {}).get("if_coordinates_known"),
        "resimulation": _resimulation(tables[RESIMULATED], groups[RESIMULATED]) if RESIMULATED in groups else None,
    }


def _without(table: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in table.items() if name not in names}


def _marginal(table: Mapping[str, Any]) -> Marginal:
    return Marginal(**{field.name: float(table[field.name]) for field in fields(Marginal)})


def _answer(table: Mapping[str, float]) -> DeterministicAnswer:
    names = [field.name for field in fields(DeterministicAnswer) if field.name != "assumed"]
    own: dict[str, Any] = {name: table.get(name) for name in names}
    return DeterministicAnswer(**own, assumed=_without(table, *names))


def _measurement(table: Mapping[str, Any], points: Any) -> Measurement:
    outline, file = table.get("outline"), table["experiment_file"]
    seen = None
    if outline is not None:
        seen = MeasuredOutline(points, OutlineNoise(**outline["noise"]), Pose(**outline["pose"]), outline["view"])
    known = _without(table, "outline", "experiment_file")
    return Measurement(**known, outline=seen, experiment_file=None if file is None else Path(file))


def _experiment(table: Mapping[str, Any]) -> Experiment:
    rate, stated = table["frame_rate"], {name: table[name] for name in _QUANTITIES if table.get(name) is not None}
    read: dict[str, Any] = {name: Quantity.of_record(each, PARAMETERS[name].si) for name, each in stated.items()}
    return Experiment(
        cross_section=table["cross_section"] if "cross_section" in table else table["section"],
        source=table["source"],
        sha256=table["sha256"],
        frame_rate=None if rate is None else Quantity(**rate),
        **read,
    )


# What the simulator says at draws of a posterior, next to what the model says there


@dataclass(frozen=True, eq=False)
class Resimulation:
    """Simulated shapes at n draws of the posterior of the model alone; differences are simulated minus predicted."""

    refinement: int  # of the mesh
    lost: int  # draws at which the simulator found no steady state
    before: Marginal  # of G_s by the model alone
    differences: Floats  # (n, 3): of those in `ERRING`
    stated: Floats  # (n, 3): standard errors that the model states there
    outlines: Floats  # (n, p) [l]: normal distances of the simulated outlines from the predicted ones
    outlines_stated: Floats  # (n, p) [l]: standard errors that the model states there

    def __len__(self) -> int:
        return len(self.differences)

    @property
    def compared(self) -> dict[str, tuple[Floats, Floats]]:
        """Differences and stated errors by name, of the outline as ``"outline"``."""
        pairs = zip(self.differences.T, self.stated.T, strict=True)
        return {**dict(zip(ERRING, pairs, strict=True)), "outline": (self.outlines, self.outlines_stated)}

    def moved(self, modulus: Marginal) -> float:
        """Return the relative change of the median of G_s by the correction."""
        return modulus.median / self.before.median - 1.0

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the differences of single shapes, ready for JSON."""
        return {
            "shapes": len(self),
            "lost": self.lost,
            "refinement": self.refinement,
            "surface_shear_modulus_before": self.before.as_dict(),
            "simulated_minus_predicted": {
                name: {
                    "mean": float(np.mean(off)),
                    "rms": _rms(off),
                    "largest": float(np.max(np.abs(off))),
                    "rms_in_standard_errors": _rms(off / stated),
                }
                for name, (off, stated) in self.compared.items()
            },
        }

    def dataset(self) -> xr.Dataset:
        """Return the differences of single shapes."""
        import xarray as xr

        columns = {"differences": "number", "stated": "number", "outlines": "point", "outlines_stated": "point"}
        return xr.Dataset({name: (("shape", column), getattr(self, name)) for name, column in columns.items()})


def _resimulation(table: Mapping[str, Any], arrays: Mapping[str, Floats]) -> Resimulation:
    return Resimulation(table["refinement"], table["lost"], _marginal(table["surface_shear_modulus_before"]), **arrays)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# Posterior of one capsule: draws, summaries, checks, and everything needed to repeat it. Data, no plots

REPORTED = (
    "surface_shear_modulus",
    "capsule_radius",
    "mean_velocity",
    "capillary_number",
    "size_ratio",
    "velocity_ratio",
    "stretch_ratio",
)
"""Quantities whose intervals are reported and whose chains are checked; further coordinates of the model are added."""

OF_VELOCITY = ("viscosity", "capsule_velocity", "mean_velocity", "velocity_ratio")
"""Quantities that a posterior lacks where mu U was given as one quantity."""

_LENGTHS = ("axial_extent", "axial_length")
_WITHIN_68 = 0.68


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of one capsule.

    Parameters
    ----------
    draws : mapping of (chain, draw) arrays
        Draws of every quantity, by name, in SI.
    ensemble : (chain,) int array
        Number of the independent ensemble to which each chain belongs.
    marginals : mapping of Marginal
        Summaries of the quantities, computed by the engine.
    reference : mapping of Marginal
        The same, computed by quadrature; empty if quadrature is the engine.
    measurement, experiment, prior, inputs
        From which the posterior was computed.
    model_name, model_sha256 : str
        The forward model and the fingerprint of its data.
    engine : str
    seed : int
    gates : tuple of Gate
    agreement : Agreement or None
        Agreement of the engine with quadrature.
    shares : mapping of float
        Share of the variance of log G_s due to each input; empty where it was not asked for.
    deterministic : DeterministicAnswer or None
        Result of the paper's procedure.
    leaning : mapping of float
        Share of the posterior next to the model's border and to the ends of the prior ranges.
    outlines : (d, p, 2) array or None [l]
        Predicted outlines of some draws.
    status : Status
    version : str
        Of capsbayes, when it was identified.
    p_values : mapping of float
        Predictive p-values of what was measured, see `capsbayes.infer.verdict`.
    log_modulus_sd_if_known : float or None
        Standard deviation of ln G_s if the further coordinates of the model were known, at their most probable values;
        None for a model without several of them.
    expected_log_modulus_sds : mapping of float
        Expected standard deviation of ln G_s after one more measurement, by name, see `capsbayes.infer.identify`;
        empty for a model without several further coordinates.
    modulus_over_laws : tuple of float or None [N/m]
        Least and largest G_s that other laws of the membrane give, see `capsbayes.infer.identify`.
    resimulation : Resimulation or None
        What the simulator says at draws of the posterior of the model alone, if `capsbayes.resimulate` corrected it.
    refinement : mapping or None
        What was added to the model where the posterior lies, see `Refinement.as_dict`.
    """

    draws: Mapping[str, Floats]
    ensemble: Integers
    marginals: Mapping[str, Marginal]
    reference: Mapping[str, Marginal]
    measurement: Measurement
    experiment: Experiment
    prior: Prior
    inputs: Inputs
    model_name: str
    model_sha256: str
    engine: str
    seed: int
    gates: tuple[Gate, ...]
    agreement: Agreement | None
    shares: Mapping[str, float]
    deterministic: DeterministicAnswer | None
    leaning: Mapping[str, float]
    outlines: Floats | None
    status: Status
    version: str = __version__
    p_values: Mapping[str, float] = field(default_factory=dict)
    log_modulus_sd_if_known: float | None = None
    expected_log_modulus_sds: Mapping[str, float] = field(default_factory=dict)
    modulus_over_laws: tuple[float, float] | None = None
    resimulation: Resimulation | None = None
    refinement: Mapping[str, Any] | None = None

    @classmethod
    def read(cls, path: str | Path) -> Posterior:
        """Read a file that `write` wrote, as ``posterior.nc`` of ``capsbayes identify``.

        Raises
        ------
        InputError
            If it is missing, damaged, or no such file.
        """
        import h5netcdf

        where = str(path)
        check_file(Path(path), "file of a posterior")
        with parsing(where, "the file of a posterior"), h5netcdf.File(path, "r") as file:
            attributes = {name: file.attrs[name] for name in file.attrs}
            groups = {name: {key: item[...] for key, item in file[name].variables.items()} for name in file.groups}
        if RECORD not in attributes or "posterior" not in groups:
            expected, advice = "the file of a posterior, as capsbayes identify writes it", "identify the capsule again"
            raise InputError(where, "", expected, "one that lacks what makes it whole", advice)
        with parsing(where, "the file of a posterior, whole"):
            return cls(**_fields(attributes, groups))

    def __getitem__(self, name: str) -> Marginal:
        """Return median and intervals of a quantity by its name or its symbol, as ``"G_s"``; see `marginals`."""
        for known, marginal in self.marginals.items():
            if name in (known, PARAMETERS[known].symbol):
                return marginal
        expected = ", ".join(f"{known} ({PARAMETERS[known].symbol})" for known in self.marginals)
        raise InputError("posterior", "", f"one of {expected}", repr(name))

    def plot(self) -> Figure:
        """Draw the corner plot of the report : matplotlib.figure.Figure."""
        figures = import_module("capsbayes.report.posterior_figures")  # a floor above, for those who ask for a plot
        return cast("Figure", figures.corner_of_all(self))

    def __repr__(self) -> str:
        names = "surface_shear_modulus", "capsule_radius"
        shown = ", ".join(f"{PARAMETERS[name].symbol} = {self[name].shown(name)}" for name in names)
        return f"<Posterior of {self.measurement.source or 'a capsule'}: {shown} (95 %); {self.status.name}>"

    def _repr_html_(self) -> str:
        return as_html(repr(self).strip("<>"), self.summary())

    def summary(self) -> pd.DataFrame:
        """Return a table of the reported quantities: median and equal-tailed 68 % and 95 % intervals, SI.

        With several further coordinates, one more column is `widths_over_prior`.
        """
        import pandas as pd

        rows = {name: marginal.as_dict() for name, marginal in self.marginals.items()}
        table = pd.DataFrame.from_dict(rows, orient="index")
        table.insert(0, "unit", [PARAMETERS[name].unit for name in rows])
        if self.log_modulus_sd_if_known is not None:
            table["width_over_prior"] = pd.Series(self.widths_over_prior())
        return table

    def widths_over_prior(self) -> dict[str, float]:
        """Return the width of the 68 % interval of each further coordinate over that of its prior.

        Widths are measured by the probability of the prior within the interval, so that it does not matter whether a
        coordinate is stated by itself or by its logarithm: one if the data say nothing of the coordinate, zero if
        they determine it exactly.
        """
        return {name: width_over_prior(self.marginals[name], prior) for name, prior in self.prior.uncertain.items()}

    @cached_property
    def prior_sensitivity(self) -> dict[str, float]:
        """How much the posteriors of G_s and a follow their priors; above 0.05 the choice of the prior matters.

        The power-scaling sensitivity of `arviz.psens`, of the densities of G_s, of a and of the further coordinates
        together (Kallioinen et al., Stat. Comput. 34, 57, 2024, doi:10.1007/s11222-023-10366-5).
        """
        groups = {"posterior": chains({name: self.draws[name] for name in LIMITED}), "log_prior": self.log_prior()}
        data = inference_data(groups, "si")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of densities that are the same everywhere
            from arviz import psens

            found = psens(data, component="prior")
        return {name: float(np.nan_to_num(found[name])) for name in LIMITED}

    def log_prior(self) -> xr.Dataset:
        """Return the log density of the prior of each parameter at the draws."""
        priors = {**dict(zip(LIMITED, self.prior.both, strict=True)), **self.prior.uncertain}
        return chains({name: prior.logpdf(self.draws[name]) for name, prior in priors.items() if name in self.draws})

    @property
    def log_modulus_sd(self) -> float:
        """Standard deviation of ln G_s."""
        return float(np.std(np.log(self.draws["surface_shear_modulus"])))

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the draws, ready for JSON."""
        marginals, seen = self.marginals, self.resimulation
        moved = {} if seen is None else {"surface_shear_modulus_moved": seen.moved(marginals["surface_shear_modulus"])}
        reynolds = None  # where neither viscosity nor velocity is known
        if not self.inputs.viscous_tension:
            reynolds = float(self.experiment.reynolds_number(marginals["mean_velocity"].median))
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "quantities": {
                name: {"symbol": PARAMETERS[name].symbol, "unit": PARAMETERS[name].unit, **marginal.as_dict()}
                for name, marginal in marginals.items()
            },
            "quadrature": {name: marginal.as_dict() for name, marginal in self.reference.items()},
            "agreement": None if self.agreement is None else {**vars(self.agreement), "sentence": str(self.agreement)},
            "deterministic": None if self.deterministic is None else self.deterministic.as_dict(),
            "variance_of_log_surface_shear_modulus": dict(self.shares),
            "share_next_to_border": dict(self.leaning),
            "p_values": dict(self.p_values),
            **self._of_coordinates(),
            RESIMULATED: seen and {**moved, **seen.as_dict()},
            "reynolds_number": reynolds,
            "gates": [gate.as_dict() for gate in self.gates],
            "inputs": self._inputs(),
            "prior": self._priors(),
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            **({} if self.refinement is None else {"refinement": dict(self.refinement)}),
            "engine": self.engine,
            "seed": self.seed,
            "version": self.version,
        }

    def _of_coordinates(self) -> dict[str, Any]:
        if self.modulus_over_laws is not None:
            return {OVER_LAWS: list(self.modulus_over_laws)}
        if self.log_modulus_sd_if_known is None:
            return {}
        return {
            "width_over_prior": self.widths_over_prior(),
            LOG_MODULUS_SD: {
                "found": self.log_modulus_sd,
                "if_coordinates_known": self.log_modulus_sd_if_known,
                "expected": dict(self.expected_log_modulus_sds),
            },
        }

    def _priors(self) -> dict[str, Any]:
        described = self.prior.described()
        for name, quantity in self.prior.coordinates.items():
            described[name] = {"distribution": quantity.shape, "low": quantity.low, "high": quantity.high}
            described[name] |= {"mean": quantity.mean, "sd": quantity.sd, "unit": PARAMETERS[name].unit}
        return described

    def _inputs(self) -> dict[str, Any]:
        seen, known = self.measurement, self.experiment
        lengths = "l" if seen.over_half_width else "m"
        pairs = {
            "axial_extent": (seen.axial_extent, seen.axial_extent_error, lengths),
            "axial_length": (seen.axial_length, seen.axial_length_error, lengths),
            "capsule_velocity": (seen.capsule_velocity, seen.capsule_velocity_error, "m/s"),
            "flow_rate": (seen.flow_rate, seen.flow_rate_error, "m^3/s"),
            "half_width": (self.inputs.half_width.value, self.inputs.half_width.error, "m"),
        }
        if self.inputs.viscous_tension or self.inputs.by_flow_rate:
            del pairs["capsule_velocity"]  # it is not used, or was not measured
        liquid, unit = ("viscous_tension", "N/m") if self.inputs.viscous_tension else ("viscosity", "Pa s")
        pairs[liquid] = self.inputs.viscosity.value, self.inputs.viscosity.error, unit
        return {
            **{name: dict(zip(("value", "error", "unit"), pair, strict=True)) for name, pair in pairs.items()},
            "length_correlation": seen.length_correlation,
            "cross_section": known.cross_section,
            "files": {Path(origin.source).name: origin.sha256 for origin in (seen, known) if origin.source},
        }

    def groups(self) -> dict[str, xr.Dataset]:
        """Return the groups of an ArviZ InferenceData, as datasets."""
        import xarray as xr

        ensemble = ("chain", self.ensemble)
        parameters = {name: values for name, values in self.draws.items() if name != "lp"}
        groups = {"posterior": chains(parameters, ensemble=ensemble)}
        if "lp" in self.draws:
            groups["sample_stats"] = chains({"lp": self.draws["lp"]}, ensemble=ensemble)
        if self.outlines is not None:
            outline = xr.DataArray(self.outlines[None], dims=("chain", "draw", "point", "plane"))
            outline = outline.assign_attrs(units="l", long_name="predicted outline, columns (z, y) from the nose")
            groups["posterior_predictive"] = outline.to_dataset(name="outline")
        if self.resimulation is not None:
            groups[RESIMULATED] = self.resimulation.dataset()
        stated = self._inputs().items()
        seen = {name: each for name, each in stated if isinstance(each, dict) and each.get("value") is not None}
        values = {name: ((), each["value"], {"units": each["unit"]}) for name, each in seen.items()}
        errors = {f"{name}_error": ((), each["error"], {"units": each["unit"]}) for name, each in seen.items()}
        measured = ("axial_extent", "axial_length", "capsule_velocity", "flow_rate")
        groups["observed_data"] = xr.Dataset({name: values.pop(name) for name in measured if name in values})
        if self.measurement.outline is not None:
            points = self.measurement.outline.points, {"units": "l", "long_name": "measured outline, columns (z, y)"}
            groups["observed_data"]["outline"] = (("measured_point", "plane"), *points)
        groups["constant_data"] = xr.Dataset(errors | values)
        return groups

    def write(self, path: str | Path, *, work: str = "") -> Path:
        """Write one NetCDF file, whole or not at all, that `read` and `arviz.from_netcdf` read.

        The attributes of the file hold the fingerprint of the model, priors, inputs, seed, version, engine, gates and
        status.

        The hash `work` of what the posterior is computed from is kept too, so that a batch finds its finished work.
        """
        import xarray as xr  # slow to import

        record = record_of(self.measurement, self.experiment, self.prior, self.gates)
        stated = {**self.as_dict(), "inference_library": self.engine, RECORD: record, WORK: work}
        attributes = {key: json.dumps(value) for key, value in stated.items() if not isinstance(value, (str, int))}
        return write_dataset(path, xr.Dataset(attrs=stated | attributes), groups=self.groups())

    def model_of(self, model: ForwardModel | None = None, *, where: str = "posterior") -> ForwardModel:
        """Return the model that made this posterior: the one given, or the database of its name.

        An `InputError` says that no database of this name and fingerprint comes with the library, or that the model
        given is not the one that made this posterior.
        """
        if self.resimulation is not None:
            expected, advice = "one of a model alone", "give the one before it was corrected"
            raise InputError(where, "posterior", expected, "one that the simulator corrected", advice)
        if model is None:
            name, coordinate, held = name_parts(self.model_name)
            if coordinate:
                name = f"{name.split('-')[0]}-{coordinate.replace('_', '-')}"
            from capsbayes.database import Database

            if held or name not in Database.shipped():
                expected = f"the model of the posterior, {self.model_name}"
                raise InputError(where, "model", expected, "nothing, and no such database comes with the library")
            from capsbayes.surrogate import Surrogate

            model = Surrogate.open(name, view=self.measurement.view)
        if model.sha256 != self.model_sha256:
            expected = f"the model of the posterior, {self.model_name}, sha256 {self.model_sha256[:12]}"
            got = f"{model.name}, sha256 {model.sha256[:12]}"
            raise InputError(where, "model", expected, got, "give the model that it was identified with")
        return model

    def to_inference_data(self, model: ForwardModel | None = None, *, units: str = "si") -> Any:
        """Return an `arviz.InferenceData` with every group that ArviZ uses.

        In addition to the groups of the file it has ``prior`` (given the velocity, see `capsbayes.infer.predictive`),
        ``prior_predictive`` and ``posterior_predictive`` of lengths, velocity and flow rate, ``log_prior``, and
        ``log_likelihood`` of the lengths together (or of the outline) and of the velocity. They are computed here.
        A chain of it is an ensemble: the walkers one after the other, so that what they share is seen between chains.

        Parameters
        ----------
        model : ForwardModel, optional
            Model of the posterior; by default the database of its name that comes with the library.
        units : str
            ``"si"``, or ``"shown"`` for display units, with variables named as ``G_s [mN/m]``: tables of
            ArviZ, which round to three digits, can be read then.

        Raises
        ------
        InputError
            If the model cannot be found, or `units` is neither.

        Examples
        --------
        >>> from capsbayes import Experiment, Measurement, Surrogate, identify
        >>> seen = Measurement(axial_extent="2.14 +/- 0.02", axial_length="1.81 +/- 0.02",
        ...                    capsule_velocity="6.20 +/- 0.06 mm/s")
        >>> channel = Experiment(cross_section="square", half_width="25.0 +/- 0.2 um", viscosity="0.85 +/- 0.02 Pa s")
        >>> found = identify(seen, Surrogate.open("square-neo-hookean"), channel, engine="quadrature", seed=1)
        >>> data = found.to_inference_data(units="shown")
        >>> sorted(data.groups())  # doctest: +NORMALIZE_WHITESPACE
        ['constant_data', 'log_likelihood', 'log_prior', 'observed_data', 'posterior', 'posterior_predictive', 'prior',
         'prior_predictive', 'sample_stats']
        >>> import arviz
        >>> table = arviz.summary(data, var_names=["G_s [mN/m]", "a [µm]"], kind="stats")
        >>> table["mean"].round().tolist()
        [51.0, 24.0]
        """

        check_units(units, "posterior")
        of_walkers = [self.ensemble == number for number in np.unique(self.ensemble)]
        draws = {
            name: np.array([values[walkers].ravel() for walkers in of_walkers]) for name, values in self.draws.items()
        }
        walked = replace(self, draws=draws, ensemble=np.arange(len(of_walkers)))
        groups = {**walked.groups(), "log_prior": walked.log_prior()}
        what = (draws, self.measurement, self.experiment, self.prior, self.inputs, self.model_of(model), self.seed)
        further = Predictive(*what).groups()
        if "sample_stats" in groups:  # of the chains themselves
            del further["sample_stats"]
        made = {group: chains(arrays) for group, arrays in further.items()}
        if not self.measurement.over_half_width:
            for length in (dataset[name] for dataset in made.values() for name in _LENGTHS if name in dataset):
                length.attrs["units"] = "m"
        if self.outlines is not None:  # of some of the draws
            outlines = groups["posterior_predictive"]["outline"][0].rename(draw="outline_draw")
            made["posterior_predictive"] = made["posterior_predictive"].assign(outline=outlines)
        return inference_data(groups | made, units)


def width_over_prior(marginal: Marginal, prior: Quantity) -> float:
    """Return the probability that the prior gives to a 68 % interval, over 68 %."""
    return float(np.diff(prior.cdf([marginal.lower_68, marginal.upper_68]))[0]) / _WITHIN_68
