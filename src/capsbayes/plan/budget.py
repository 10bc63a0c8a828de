"""The share of each input in the interval of a capsule."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.identify import QUANTITIES, REST, add_up, variance_shares
from capsbayes.infer.importance import ExactEngine, WeightedPosterior, engine_near, exact_engine
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.infer.quadrature import Quadrature
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS
from capsbayes.plan.lab import CapsuleDraws, Expectation, LabErrors, root_of, settings_of
from capsbayes.plan.widths import check_model, width_of
from capsbayes.quantity import Given, Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


TOGETHER = "parameters together"
"""What several further coordinates take away of the variance if all become known, beyond what each does alone."""

_SETTING = ("value", "error", "unit")
_ORDER = ("viscosity", "half_width", "capsule_velocity", "axial_extent", "axial_length", "outline", "surrogate")


@dataclass(frozen=True)
class BudgetRow:
    """Influence of one input on G_s and a."""

    name: str  # as in `capsbayes.parameters`, or "outline", "surrogate", `TOGETHER`, "prior and curvature"
    setting: Quantity | None  # of an input that is a number
    share: Mapping[str, float]  # of the variance of log G_s and of log a
    log_slope: Mapping[str, float]  # d ln(quantity) / d ln(input); empty for an input that is no number
    slope: Mapping[str, float]  # d(quantity) / d(input), in SI over the input's unit

    @property
    def change(self) -> dict[str, float]:
        """Change of each quantity with one standard error of the input [SI]."""
        return {name: slope * self.setting.error for name, slope in self.slope.items() if self.setting is not None}

    @property
    def words(self) -> str:
        """Symbol and meaning of the input."""
        parameter = PARAMETERS.get(self.name)
        if parameter is None:
            return _WORDS.get(self.name, self.name)
        return f"{parameter.symbol}, {parameter.meaning}"


_WORDS = {
    "surrogate": "model's own error",
    "outline": "errors of the outline",
    TOGETHER: "the membrane together, beyond each of these",
    REST: "remainder",
}


@dataclass(frozen=True, repr=False)
class ErrorBudget(Readable):
    """Error budget of one capsule."""

    rows: tuple[BudgetRow, ...]
    value: Mapping[str, float]  # posterior median of G_s and a [SI]
    sd: Mapping[str, float]  # standard deviation of their logarithms
    notes: tuple[str, ...]  # what the budget cannot tell, in sentences
    model_name: str
    model_sha256: str
    status: Status  # that of the posterior

    def described(self) -> dict[str, str]:
        """Return the standard deviation of ln G_s and, if they add up, the shares of the inputs in its variance."""
        shares = {name: f"{100.0 * share:.0f} %" for name, share in self.shares_of(QUANTITIES[0]).items()}
        return {"sd of ln G_s": f"{self.sd[QUANTITIES[0]]:.2g}", **shares}

    def __getitem__(self, name: str) -> BudgetRow:
        return next(row for row in self.rows if row.name == name)

    def shares_of(self, quantity: str) -> dict[str, float]:
        """Return the share of each input in the variance of a quantity; empty if they do not add up."""
        shares = {row.name: row.share[quantity] for row in self.rows}
        return shares if add_up(shares) else {}

    def table(self) -> pd.DataFrame:
        """Return a row for each input, SI: value, error, unit; for G_s and a share, slopes, change with an error."""
        import pandas as pd

        records = {}
        for row in self.rows:
            record: dict[str, Any] = {key: getattr(row.setting, key, None) for key in _SETTING}
            for quantity in QUANTITIES:
                symbol = PARAMETERS[quantity].symbol
                record[f"share of variance of {symbol}"] = row.share.get(quantity)
                record[f"d ln {symbol} / d ln input"] = row.log_slope.get(quantity)
                record[f"d {symbol} / d input"] = row.slope.get(quantity)
                record[f"change of {symbol} with an error"] = row.change.get(quantity)
            records[row.name] = record
        return pd.DataFrame.from_dict(records, orient="index")

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "median": dict(self.value),
            "sd_of_logarithm": dict(self.sd),
            "inputs": {
                row.name: {
                    **({} if row.setting is None else {key: getattr(row.setting, key) for key in _SETTING}),
                    "share_of_variance": dict(row.share),
                    "log_slope": dict(row.log_slope),
                    "slope": dict(row.slope),
                    "change_with_an_error": row.change,
                }
                for row in self.rows
            },
            "notes": list(self.notes),
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            "version": __version__,
        }


@checked
def error_budget(posterior: Posterior, model: ForwardModel | None = None) -> ErrorBudget:
    """Compute the share of each input in the variance of G_s and a, and their derivatives with respect to it.

    Everything is computed by quadrature, whichever engine made the posterior.

    Parameters
    ----------
    posterior : Posterior
    model : ForwardModel, optional
        Model of the posterior; by default the database of its name that comes with the library.

    Returns
    -------
    ErrorBudget

    Raises
    ------
    InputError
        If no model is given and no database of the posterior's name and fingerprint comes with the library, or if the
        model given is not that of the posterior.
    """
    forward = posterior.model_of(model, where="error_budget")
    seen, inputs = posterior.measurement, posterior.inputs
    with threadpool_limits(limits=1):
        engine = exact_engine(forward, posterior.experiment, posterior.prior)
        grid = engine(seen, inputs=inputs)
        alone = variance_shares(engine, seen, grid, *QUANTITIES)
        shares = {name: _with_joint(grid, name, of) for name, of in alone.items()}
        settings = settings_of(seen, inputs)
        log_slopes_of = {name: log_slopes(engine, seen, grid, name, given) for name, given in settings.items()}
        centre = {name: grid.marginal(name).median for name in QUANTITIES}
        sd = {name: grid.log_marginal(name).sd for name in QUANTITIES}
    every = shares[QUANTITIES[0]]
    first, last = ([name for name in names if name in every] for names in (_ORDER, (TOGETHER, REST)))
    names = [*first, *(name for name in every if name not in (*first, *last)), *last]
    rows = []
    for name in names:
        share = {quantity: float(of[name]) for quantity, of in shares.items()}
        setting, log_slope = settings.get(name), {q: float(s) for q, s in log_slopes_of.get(name, {}).items()}
        slope = {} if setting is None else {q: s * centre[q] / setting.value for q, s in log_slope.items()}
        rows.append(BudgetRow(name, setting, share, log_slope, slope))
    made = posterior.model_name, posterior.model_sha256, posterior.status
    return ErrorBudget(tuple(rows), centre, sd, _notes(posterior), *made)


def _with_joint(grid: ExactPosterior, quantity: str, shares: Mapping[str, float]) -> dict[str, float]:
    """Return shares with that of several further coordinates together, which is not the sum of those of each."""
    if not isinstance(grid, WeightedPosterior) or len(grid.density.coordinates) < 2:
        return dict(shares)
    alone = sum(shares[coordinate.name] for coordinate in grid.density.coordinates)
    beyond = grid.variance_given_all(quantity) / grid.log_marginal(quantity).sd ** 2 - alone
    return {**shares, TOGETHER: beyond, REST: shares[REST] - beyond}


def _notes(posterior: Posterior) -> tuple[str, ...]:
    """Return sentences on the limits of the budget of such a measurement."""
    seen, notes = posterior.measurement, []
    if seen.outline is not None:
        alone = seen.length_with_outline is None
        notes.append(
            f"The outline is one input{'' if alone else ', with L_a measured too'}: it replaces the lengths, so that "
            f"{'L_z and L_a have' if alone else 'L_z has'} no separate share, and there is no derivative by it."
        )
    elif seen.axial_length is None:
        notes.append(
            "L_a was not measured: L_z alone leaves Ca open, and the share of an input in G_s is small compared with "
            "those of the prior and of the border of the database."
        )
    if seen.length_correlation and seen.outline is None:
        notes.append("The errors of L_z and L_a are correlated: their shares cannot be separated.")
    if posterior.log_modulus_sd_if_known is not None:
        notes.append(
            "The share of a parameter of the membrane is what knowing it alone would take away; what they take away "
            f"together is more. Were all known, ln G_s would have a standard deviation of "
            f"{posterior.log_modulus_sd_if_known:.2g} in place of {posterior.log_modulus_sd:.2g}."
        )
    if not posterior.status.ok:
        notes.append(f"Read the shares with care. {posterior.status}")
    return tuple(notes)


# Slopes of G_s and a by each input: differences of the exact engine's medians. Where one of the two steps makes a shape
# that cannot be, a length on the axis beyond the extent or a shape far from all of the model, the other alone is taken

STEP = 0.5
"""Step in standard errors of the input, so that the slope is that over the range that matters."""

STEP_OF_KNOWN = 5e-3
"""Step over the value of an input that is known."""


def log_slopes(
    engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior, name: str, given: Quantity
) -> dict[str, float]:
    """Compute d ln(quantity) / d ln(input) of the posterior medians of G_s and a; NaN where no step can be made."""
    ends = {}
    step = STEP_OF_KNOWN * given.value if given.known else STEP * given.error
    for value in (given.value - step, given.value + step):
        with contextlib.suppress(InputError):
            moved = _moved(measurement, posterior.density.inputs, name, value)
            ends[value] = _log_medians(_again(engine, posterior, measurement, *moved))
    if len(ends) == 1:
        ends[given.value] = _log_medians(posterior)
    if not ends:
        return dict.fromkeys(QUANTITIES, float("nan"))
    low, high = min(ends), max(ends)
    width = float(np.log(high / low))
    return {quantity: (ends[high][quantity] - ends[low][quantity]) / width for quantity in QUANTITIES}


def _again(
    engine: ExactEngine, before: ExactPosterior, seen: Measurement, moved: Measurement, inputs: Inputs
) -> ExactPosterior:
    """Return the posterior of a moved measurement or of moved inputs, from that before."""
    # An input that the shape does not depend on moves no grid: the same posterior is read with another factor.
    same_width = inputs.half_width is before.density.inputs.half_width
    same_shape = moved is seen and (same_width or before.density.likelihood.over_half_width)
    if same_shape and isinstance(before, GridPosterior) and not before.cut:
        return replace(before, density=replace(before.density, inputs=inputs))
    return engine_near(engine, before)(moved, inputs=inputs)


def _log_medians(posterior: ExactPosterior) -> dict[str, float]:
    return {name: posterior.log_marginal(name).median for name in QUANTITIES}


def _moved(measurement: Measurement, inputs: Inputs, name: str, value: float) -> tuple[Measurement, Inputs]:
    change: dict[str, Any] = {name: value}
    if name.startswith("axial"):
        return replace(measurement, **change), inputs
    return measurement, replace(inputs, **{name: getattr(inputs, name).rescaled(value)})


# Identification of simulated measurements, to check predicted widths

_LOST = 20  # capsules without a shape for each that has one, beyond which the search is given up


@dataclass(frozen=True, eq=False)
class SimulatedWidths:
    """Posteriors of simulated capsules."""

    relative: Floats  # (n,): half of the 68 % interval of G_s over its median
    sd: Floats  # (n,): standard deviation of log G_s
    within: Booleans  # (n,): whether the 68 % interval holds the true G_s
    without_shape: int  # further capsules that were drawn and for which the model has no shape
    refused: int  # further capsules whose measurement no shape of the model has
    seed: int

    @property
    def mean(self) -> float:
        """Mean width."""
        return float(np.mean(self.relative))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean width; NaN for a single capsule."""
        count = len(self.relative)
        return float(np.std(self.relative, ddof=1) / np.sqrt(count)) if count > 1 else float("nan")

    def as_dict(self) -> dict[str, float | int | None]:
        """Return a summary for files."""
        return {
            "capsules": len(self.relative),
            "relative": self.mean,
            "standard_error": self.standard_error if len(self.relative) > 1 else None,
            "within_68": float(self.within.mean()),
            "without_shape": self.without_shape,
            "refused": self.refused,
            "seed": self.seed,
        }


def simulated_widths(
    surface_shear_modulus: Given,
    capsule_radius: Given,
    experiment: Experiment,
    errors: LabErrors,
    model: ForwardModel,
    *,
    mean_velocity: float,
    count: int,
    seed: int,
    prior: Prior | None = None,
) -> SimulatedWidths:
    """Draw capsules at one velocity of the flow, measure them with errors, and identify them by quadrature."""
    # Capsules, liquid and channel are drawn as they are expected. The model is wrong by as much as it says: its own
    # error is drawn too.
    check_model(model, experiment)
    expectation, rng = Expectation.of(surface_shear_modulus, capsule_radius, experiment), np.random.default_rng(seed)
    engine = Quadrature(model, experiment, prior)
    widths: list[tuple[float, float, bool]] = []
    without_shape = refused = 0
    with threadpool_limits(limits=1):
        while len(widths) < count:
            if without_shape + refused > _LOST * (len(widths) + 10):
                expected = f"a velocity at which {model.name} has a shape of such capsules"
                raise InputError("simulated_widths", "mean_velocity", expected, f"{mean_velocity:g} m/s")
            drawn = expectation.drawn(rng, 1)
            lengths = _lengths(drawn, model, mean_velocity, errors, rng)
            if lengths is None:
                without_shape += 1
                continue
            with contextlib.suppress(InputError):
                posterior = engine(errors.measured(*lengths))
                width, interval = width_of(posterior), posterior.marginal("surface_shear_modulus")
                truth = float(drawn.surface_shear_modulus[0])
                widths.append((width.relative, width.sd, interval.contains(truth, level=68)))
                continue
            refused += 1
    relative, sd, within = (np.array(column) for column in zip(*widths, strict=True))
    return SimulatedWidths(relative, sd, within, without_shape, refused, seed)


def _lengths(
    capsule: CapsuleDraws, model: ForwardModel, mean_velocity: float, errors: LabErrors, rng: np.random.Generator
) -> tuple[Floats, float] | None:
    """Draw lengths and velocity as measured; None where the model has no such capsule."""
    shape = model({"capillary_number": capsule.capillary_number(mean_velocity), "size_ratio": capsule.size_ratio})
    if not shape.inside[0]:
        return None
    extent, length, ratio = shape.values[0, :3] + root_of(shape.covariance[0]) @ rng.standard_normal(3)
    seen = np.array([extent, length]) * (1.0 if errors.over_half_width else capsule.half_width[0])
    noise = errors.covariance
    seen[: len(noise)] += root_of(noise) @ rng.standard_normal(len(noise))
    return seen, float(ratio * mean_velocity * (1.0 + errors.capsule_velocity * rng.standard_normal()))
