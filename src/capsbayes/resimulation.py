"""The simulator at draws of a posterior: how far the model is off there, and the posterior without that error.

The simulator computes the shapes of some draws. What they differ by from the predictions of the model is a constant
plus a linear function of the parameters, by least squares with a ridge, as a posterior is small. It is added to every
prediction, and what a shape differs by from the fit to the others takes the place of the error that the model states.
Then the capsule is identified again. Beyond the simulated shapes the correction keeps the value that it has at the last
of them, and the stated error of the model counts again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.infer import Membrane, Posterior, Prior, identify
from capsbayes.infer.checks import Gate
from capsbayes.infer.identify import check_applies
from capsbayes.infer.posterior import Resimulation
from capsbayes.infer.sampling import Effort
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, MembraneDatabase
from capsbayes.model import UNSURE_SHAPES, CoordinateRange, Derived, Extended, FixedParameters, ForwardModel, Theta
from capsbayes.physics.load import changed, parameters_of
from capsbayes.physics.membrane import LAWS, MembraneLaw
from capsbayes.physics.scattered import (
    Axis,
    Continuation,
    ScatteredState,
    kept_state,
    membrane_continuation,
    nearest_state,
    scattered_states,
)
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.prediction import NUMBERS, Prediction
from capsbayes.profile import vertex_normals
from capsbayes.run import Store, digest_of
from capsbayes.status import Status
from capsbayes.surrogate import EffectSurrogate, MembraneSurrogate, Surrogate
from capsbayes.surrogate.plane import OUTLINES

FEWEST, MOST = 5, 1000
"""Shapes that may be asked for."""

_REFINEMENT = 12  # of the mesh, unless that of the model is finer
_ROUNDS = 3  # at most, each of as many shapes, while the corrected posterior holds too few of them
_GROUPS = 2  # of shapes, side by side
_LEAST_FOUND = 0.75  # share of the shapes asked for that the simulator finds
_LEAST_WITHIN = 0.5  # of the shapes of a round, as many within the corrected posterior
_PROBABILITY = 0.99  # of a normal posterior within the ellipsoid whose shapes count
_RIDGES = 10.0 ** np.arange(-1.0, 6.0)  # shapes one standard deviation away that speak for a slope of zero
_FLOOR = 1e-5  # of the standard deviations of the numbers of a shape
_STREAM = 7  # of the random numbers
_CASE = ("capillary_number", "size_ratio")


@checked
def resimulate(
    posterior: Posterior,
    model: ForwardModel | None = None,
    count: int = 20,
    *,
    folder: str | Path,
    membrane: Membrane | None = None,
    effort: Effort | None = None,
) -> Posterior:
    """Check a posterior by the simulator, and correct it for what the model is off.

    Parameters
    ----------
    posterior : Posterior
    model : ForwardModel, optional
        With which it was identified; by default the shipped database of its name.
    count : int
        Draws of the posterior that are simulated, from 5 to 1000; as many again, at most twice, while the corrected
        posterior lies beyond them. A shape takes about 3 s.
    folder : path
        Where the shapes are kept, so that none is computed twice.
    membrane : Membrane, optional
        What was stated of it when the capsule was identified.
    effort : Effort, optional
        How long emcee samples.

    Returns
    -------
    Posterior
        The corrected one; its `resimulation` holds what the simulator and the model differ by. Its status tells whether
        the intervals can be used.

    Raises
    ------
    InputError
        If the model is not that of the posterior, or has a parameter that the simulator does not follow.
    CapsbayesError
        If the simulator finds no shape to begin with.

    Examples
    --------
    ``resimulate(identify(measurement, model, experiment, seed=1), model, 20, folder="shapes")``
    """
    if not FEWEST <= count <= MOST:
        raise InputError("resimulate", "count", f"from {FEWEST} to {MOST} shapes", str(count))
    if membrane is not None and model is not None:
        model, _ = membrane.applied(model, Prior())
    forward = posterior.model_of(model, where="resimulate")
    check_applies(forward, posterior.measurement, posterior.experiment, viscosity_needed=False)
    source, corrected, after, rounds = ShapeSource.of(forward), forward, posterior, []
    how: dict[str, Any] = {"engine": posterior.engine, "seed": posterior.seed, "prior": posterior.prior}
    how |= {"effort": effort, "error_budget": bool(posterior.shares)}
    for _ in range(_ROUNDS):
        rounds.append(source.shapes(_drawn(after, forward, count), posterior, Path(folder)))
        corrected = ResimulatedModel(corrected, PosteriorFrame.of(after, forward), rounds[-1])
        after = identify(posterior.measurement, corrected, posterior.experiment, **how)
        number = sum(float(np.sum(PosteriorFrame.of(after, forward).holds(shapes.theta))) for shapes in rounds)
        within = Gate("simulated shapes within the corrected posterior", number, least=_LEAST_WITHIN * count)
        if within.passed:
            break
    asked, shapes = len(rounds) * count, SimulatedShapes.joined(rounds)
    found = Gate("share of the shapes that the simulator found", len(shapes.numbers) / asked, least=_LEAST_FOUND)
    return replace(
        after,
        model_sha256=forward.sha256,
        gates=(*after.gates, found, within),
        status=after.status if found.passed and within.passed else Status.NOT_RESIMULATED,
        resimulation=_compared(forward, posterior, shapes, source.refinement, asked - len(shapes.numbers)),
    )


def _drawn(posterior: Posterior, model: ForwardModel, count: int) -> dict[str, Floats]:
    """Return the parameters of draws of a posterior : (count,) arrays; the first ones of more draws are the same."""
    flat = {name: np.ravel(posterior.draws[name]) for name in (*_CASE, *model.coordinates)}
    rng = np.random.default_rng([posterior.seed, _STREAM])
    rows = rng.permutation(len(flat["size_ratio"]))[:count]
    return {name: values[rows] for name, values in flat.items()}


# The simulator that made the shapes of a model, at other parameters


class SimulatedShapes(NamedTuple):
    """Simulated shapes at n points."""

    theta: Mapping[str, Floats]  # (n,) arrays
    numbers: Floats  # (n, 4): of `NUMBERS`
    outlines: Floats  # (n, p, 2) [l]

    @classmethod
    def joined(cls, parts: Sequence[SimulatedShapes]) -> SimulatedShapes:
        """Return those of several parts."""
        theta = {name: np.concatenate([part.theta[name] for part in parts]) for name in parts[0].theta}
        return cls(theta, *(np.concatenate(arrays) for arrays in zip(*(part[1:] for part in parts), strict=True)))


@dataclass(frozen=True)
class ShapeSource:
    """The simulator of the shapes that a model is made of."""

    continuation: Continuation
    known: Mapping[str, float]  # parameters of the continuation that are no coordinates of the model
    view: str
    states: MembraneDatabase | None = None  # to begin from

    @classmethod
    def of(cls, model: ForwardModel) -> ShapeSource:
        """Return that of a model on a database; refuse one with parameters that the simulator does not follow."""
        inner, known = _stripped(model)
        if isinstance(inner, MembraneSurrogate):
            states = inner.membrane_database
            refinement = max(_REFINEMENT, int(states.settings["refinement"]))
            _check_known(known, FREE_PARAMETERS)
            plain = dict(zip(FREE_PARAMETERS, NULL_VALUES, strict=True))
            return cls(membrane_continuation(states.cross_section, refinement), plain | known, model.view, states)
        if not isinstance(inner, (Surrogate, EffectSurrogate)):
            raise InputError("resimulate", "model", "a model on a database of simulated shapes", inner.name)
        database = inner.effect_database if isinstance(inner, EffectSurrogate) else inner.database
        simulator = simulator_of(database.settings, tuple(inner.coordinates))
        _check_known(known, tuple(parameters_of(simulator)))
        for name, value in known.items():
            simulator = changed(simulator, name, value)
        _check_known(model.coordinates, tuple(parameters_of(simulator.problem)))
        (low, high), sizes = model.domain.bounds
        axes = [Axis("capillary_number", low, high, offset=0.0), Axis("size_ratio", *sizes)]
        axes += [Axis(name, ends.low, ends.high) for name, ends in model.coordinates.items()]
        return cls(Continuation(simulator, tuple(axes)), {}, model.view)

    @property
    def refinement(self) -> int:
        """Refinement of the mesh."""
        return self.continuation.simulator.refinement

    def shapes(self, theta: Mapping[str, Floats], near: Posterior, folder: Path) -> SimulatedShapes:
        """Return the shapes at points that have a steady state; all are kept in a folder."""
        own = folder / digest_of(self.continuation.settings)[:12]
        start = self._start(Store.open(own, self.continuation.settings), near)
        places = self.continuation.places(self._values(theta))
        states = scattered_states(self.continuation, start, places, folder=own, groups=_GROUPS)
        reached = [number for number, state in enumerate(states) if state is not None]
        seen = [self.continuation.seen(state) for state in states if state is not None]
        outlines = [each[OUTLINES[self.view]].reshape(-1, 2) for each in seen]
        found = {name: values[reached] for name, values in theta.items()}
        if len(seen) < FEWEST:
            raise CapsbayesError(f"The simulator found {len(seen)} of {len(states)} shapes, too few to compare.")
        return SimulatedShapes(found, np.array([each["numbers"] for each in seen]), np.array(outlines))

    def _values(self, theta: Mapping[str, Floats]) -> Floats:
        """Return the parameters (n, p) of the continuation."""
        count = len(theta["size_ratio"])
        known = {name: np.full(count, value) for name, value in self.known.items()} | dict(theta)
        return np.column_stack([known[name] for name in self.continuation.names])

    def _start(self, store: Store, posterior: Posterior) -> ScatteredState:
        """Return a state next to the draw that is nearest to the median of a posterior."""
        flat = {name: np.ravel(values) for name, values in posterior.draws.items() if name in self.continuation.names}
        away = [(values - np.median(values)) / (np.std(values) or 1.0) for values in flat.values()]
        middle = int(np.argmin(np.sum(np.square(away), axis=0)))
        values = self._values({name: column[[middle]] for name, column in flat.items()})[0]
        start = kept_state(store, f"start-{digest_of(values)[:24]}", lambda: self._begun(values))
        if start is None:
            raise CapsbayesError("The simulator found no steady shape near the median of the posterior to begin with.")
        return start

    def _begun(self, values: Floats) -> ScatteredState | None:
        if self.states is not None:
            return nearest_state(self.states, self.continuation, self.continuation.places(values[None])[0])
        case, simulator = dict(zip(self.continuation.names, values.tolist(), strict=True)), self.continuation.simulator
        for name in self.continuation.names[len(_CASE) :]:
            simulator = changed(simulator, name, case[name])
        state = simulator.run(**{name: case[name] for name in _CASE})
        return Continuation(simulator, self.continuation.axes).taken(state) if state.status.ok else None


def simulator_of(settings: Mapping[str, object], parameters: tuple[str, ...]) -> Simulator:
    """Return the simulator of a database by its settings, on a mesh that is fine enough, with a law of parameters."""
    if "walls" not in settings:
        raise InputError("resimulate", "model", "a database that this simulator made", "one without its settings")
    plain = {field.name: settings[field.name] for field in fields(Simulator) if field.name in settings}
    plain |= {"law": Simulator().law, "walls": WallDiscretisation(**settings["walls"])}  # type: ignore[arg-type]
    simulator = Simulator(**plain).refined(max(_REFINEMENT, int(plain["refinement"])))  # type: ignore[arg-type, call-overload]
    needed = set(parameters) - parameters_of(simulator).keys()
    for law in _laws(str(settings["law"])):
        if needed <= parameters_of(law).keys():
            return replace(simulator, law=law)
    expected = f"one of the laws {', '.join(LAWS)} with {', '.join(needed)}" if needed else "a law of the library"
    raise InputError("resimulate", "law", expected, str(settings["law"]))


def _laws(name: str) -> Iterator[MembraneLaw]:
    """Yield the laws of a name, in which the last number is the value of a single parameter."""
    for kind in LAWS.values():
        parameters = [field.name for field in fields(kind)]
        tried = [kind()]
        if len(parameters) == 1:
            with suppress(ValueError, InputError):
                tried.append(kind(**{parameters[0]: float(name.rpartition("= ")[2])}))
        yield from (law for law in tried if law.name == name)


def _stripped(model: ForwardModel) -> tuple[ForwardModel, dict[str, float]]:
    """Return a model without effects and fixed parameters, and the values of the latter."""
    known: dict[str, float] = {}
    while isinstance(model, (Extended, FixedParameters)):
        known = {**getattr(model, "values", {}), **known}
        model = model.model
    return model, known


def _check_known(names: Mapping[str, object], followed: tuple[str, ...]) -> None:
    for name in names:
        if name not in followed:
            expected = f"parameters that the simulator follows, as {', '.join(followed)}"
            raise InputError("resimulate", "model", expected, name)


# The model with what the simulator differs from it


class Fit(NamedTuple):
    """Constants and slopes (1 + d, q) of differences, and what each (n, q) differs by from the fit to the others."""

    coefficients: Floats
    left: Floats

    @classmethod
    def of(cls, places: Floats, differences: Floats) -> Fit:
        """Fit differences (n, q) at places (n, d), with the ridge on the slopes that leaves the least."""
        design = np.column_stack([np.ones(len(places)), places])
        fits = []
        for ridge in _RIDGES:
            penalty = np.diag([0.0, *np.full(places.shape[1], ridge)])
            solution = np.linalg.solve(design.T @ design + penalty, design.T)
            hat = design @ solution
            fits.append(cls(solution @ differences, (differences - hat @ differences) / (1.0 - np.diag(hat))[:, None]))
        return min(fits, key=lambda fit: float(np.sum(fit.left**2)))


@dataclass(frozen=True, eq=False)
class PosteriorFrame:
    """Coordinates about the middle of a posterior, in its standard deviations: log Ca, a/l and those of a model."""

    coordinates: Mapping[str, CoordinateRange]
    middle: Floats  # (d,)
    root: Floats  # (d, d): lower triangular factor of the covariance

    @classmethod
    def of(cls, posterior: Posterior, model: ForwardModel) -> PosteriorFrame:
        """Return that of the draws of a posterior."""
        columns = _columns(posterior.draws, model.coordinates)
        root = np.linalg.cholesky(np.asarray(np.cov(columns.T), np.float64))
        return cls(model.coordinates, columns.mean(axis=0), root)

    @property
    def reach(self) -> float:
        """Distance from the middle within which points count as within the posterior."""
        return float(np.sqrt(chi2.ppf(_PROBABILITY, len(self.middle))))

    def places(self, theta: Mapping[str, ArrayLike]) -> Floats:
        """Return the coordinates (n, d) of points."""
        away = _columns(theta, self.coordinates) - self.middle
        return np.asarray(np.linalg.solve(self.root, away.T).T)

    def holds(self, theta: Mapping[str, ArrayLike]) -> Booleans:
        """Return which points count as within the posterior : (n,) array."""
        return np.asarray(np.linalg.norm(self.places(theta), axis=1) <= self.reach)


def _columns(theta: Mapping[str, ArrayLike], coordinates: Mapping[str, CoordinateRange]) -> Floats:
    columns = [np.log(np.ravel(theta["capillary_number"])), np.ravel(theta["size_ratio"])]
    for name, ends in coordinates.items():
        values = np.ravel(theta.get(name, np.full(len(columns[0]), ends.null_value)))
        columns.append(np.log(values) if ends.logarithmic else values)
    return np.column_stack(columns)


class ResimulatedModel(Derived):
    """A model with the differences of simulated shapes from it, by those drawn from the posterior of a frame."""

    def __init__(self, model: ForwardModel, frame: PosteriorFrame, shapes: SimulatedShapes) -> None:
        super().__init__(model)
        self._frame, places = frame, frame.places(shapes.theta)
        predicted, outlines = _predicted(model, shapes.theta)
        self._reach = max(frame.reach, float(np.max(np.linalg.norm(places, axis=1))))
        self._numbers = Fit.of(places, shapes.numbers - _table(predicted))
        left = self._numbers.left[:, :3]
        self._covariance = left.T @ left / len(left) + _FLOOR**2 * np.eye(3)
        self._outlines = Fit.of(places, (shapes.outlines - outlines).reshape(len(places), -1))
        self._modes = _along_normals(self._outlines.left, outlines) / np.sqrt(len(places))
        self.sha256 = digest_of(model.sha256, shapes.theta, *shapes[1:])

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        seen = self.model(theta, outline=outline)
        places = self._frame.places(theta)
        share = self._share(places)
        design = np.column_stack([np.ones(len(places)), share[:, None] * places])
        numbers = dict(zip(NUMBERS, (_table(seen) + design @ self._numbers.coefficients).T, strict=True))
        shapes = seen.outline
        if shapes is not None:
            shapes = shapes + (design @ self._outlines.coefficients).reshape(shapes.shape)
        covariance = self._covariance + (1.0 - share**2)[:, None, None] * seen.covariance
        return Prediction(**numbers, covariance=covariance, inside=seen.inside, outline=shapes)

    def outline_modes(self, **theta: float) -> Floats | None:
        own = self.model.outline_modes(**theta)
        share = self._share(self._frame.places({name: np.array([value]) for name, value in theta.items()}))[0]
        return self._modes if own is None else np.concatenate([self._modes, np.sqrt(1.0 - share**2) * own])

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        return {kind: here for kind, here in super().caveats(theta).items() if kind != UNSURE_SHAPES}

    def _share(self, places: Floats) -> Floats:
        """Return the share (n,) of the way to places (n, d) that is within reach."""
        return np.asarray(1.0 / np.maximum(np.linalg.norm(places, axis=1) / self._reach, 1.0))


def _predicted(model: ForwardModel, theta: Theta) -> tuple[Prediction, Floats]:
    """Return a prediction and its outlines (n, p, 2) [l]."""
    predicted = model(theta, outline=True)
    assert predicted.outline is not None, "of a model of simulated shapes"
    return predicted, predicted.outline


def _table(prediction: Prediction) -> Floats:
    return np.column_stack([getattr(prediction, name) for name in NUMBERS])


def _along_normals(displacements: Floats, outlines: Floats) -> Floats:
    """Return the parts (n, p) along the normals of outlines (n, p, 2) of displacements of their points."""
    normals = np.array([vertex_normals(outline) for outline in outlines])
    return np.asarray(np.sum(displacements.reshape(outlines.shape) * normals, axis=-1))


def _compared(
    model: ForwardModel, before: Posterior, shapes: SimulatedShapes, refinement: int, lost: int
) -> Resimulation:
    """Return what simulated shapes and a model differ by, with the errors that the model states."""
    (predicted, outlines), modes = _predicted(model, shapes.theta), []
    for row in range(len(predicted)):
        own = model.outline_modes(**{name: float(values[row]) for name, values in shapes.theta.items()})
        assert own is not None, "a surrogate states its error"
        modes.append(own)
    return Resimulation(
        refinement=refinement,
        lost=lost,
        before=before.marginals["surface_shear_modulus"],
        differences=shapes.numbers[:, :3] - predicted.values,
        stated=np.sqrt(np.diagonal(predicted.covariance, axis1=1, axis2=2)),
        outlines=_along_normals(shapes.outlines - outlines, outlines),
        outlines_stated=np.array([np.linalg.norm(own, axis=0) for own in modes]),
    )
