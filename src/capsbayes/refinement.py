"""States added to the model of the membrane where the posterior of one capsule, or of a batch, lies."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.conditional import MODULUS, Capsules, Shapes, Start, Unknowns
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.prior import Membrane, Prior
from capsbayes.infer.proposal import normalised, rows_by_weight
from capsbayes.infer.shared_membrane import (
    MembraneSampling,
    Sampled,
    SharedMembrane,
    capsules_of,
    model_of,
    spreads_of,
    step_of_all,
    unknowns_of,
    wide_weights,
    with_model_error,
)
from capsbayes.measurement import Measurement
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase
from capsbayes.physics.scattered import (
    Continuation,
    ScatteredState,
    continuation_of,
    further_states,
    kept_states,
    scattered_dataset,
)
from capsbayes.run import digest_of
from capsbayes.surrogate import MembraneSurrogate
from capsbayes.surrogate.membrane import parameter_columns
from capsbayes.surrogate.plane import OUTLINES

# Local approximation: a model is made of more simulations where its error counts.
#
# Candidates are draws of the widened posterior, several membranes times several capsules: states at its mean alone
# would make a wrong membrane fit, and be surer. At each the model states its error, in standard errors of what was
# measured. A state tells the error of its neighbours as far as the two are correlated; the next one is where it takes
# most from the variance that the others have left. Some states of each round are drawn at random, and compared with
# what the model said there before they are added to it.
#
# Conrad, Marzouk, Pillai, Smith 2016, J. Am. Stat. Assoc. 111, 1591, arXiv:1402.1694; Davis, Marzouk, Smith, Pillai
# 2022, arXiv:2006.00032 (local approximation MCMC)

R = TypeVar("R", Posterior, SharedMembrane)

_HERE = "refine_model"
_OF_CAPSULES = ("surface_shear_modulus", "capsule_radius")  # priors of single capsules, which a batch has none of
_CANDIDATES = 2000
_ROUNDS = 3
_TESTED, _FEWEST_TESTED = 0.2, 3  # share of the states of a round that are drawn at random, and at least so many
_KNOWN = 1e-6  # share of the largest variance that is left where the error is known
_NEAR = 2.0  # distance from a candidate up to which a state of an earlier run is taken; over 1 the error changes
_ENOUGH = 0.1  # share of the model in the variance of ln G_s
_AGREES = 1.5  # root mean square of the errors of the tested states, in standard errors


class Round(NamedTuple):
    """States that were added together, and what they changed."""

    simulated: int
    not_reached: int
    reused: int  # states of earlier runs
    tested: int  # states of earlier runs, or those that were drawn at random and reached
    score: float  # root mean square of their errors over the stated ones, by the model before; NaN if none was tested
    share: float  # of the model in the variance of ln G_s, afterwards


@dataclass(frozen=True, eq=False)
class Refinement:
    """A model with states where a posterior lies.

    Parameters
    ----------
    model : MembraneSurrogate
        To identify the same measurements with.
    share_before, share_after : float
        Share of the variance of ln G_s that the error of the model has, without the added states and with them: one
        minus the variance with the model taken as exact, over the variance. Over the membranes, the errors are left
        out of the average of the posterior, and at the best membrane out of those of the measurements.
    rounds : tuple of Round
    """

    model: MembraneSurrogate
    share_before: float
    share_after: float
    rounds: tuple[Round, ...]

    @property
    def small(self) -> bool:
        """Whether the share of the model is below a tenth."""
        return self.share_after < _ENOUGH

    @property
    def agrees(self) -> bool | None:
        """Whether the tested states of the last round agreed with the stated error; None if there were none."""
        score = self.rounds[-1].score if self.rounds else np.nan
        return bool(score <= _AGREES) if np.isfinite(score) else None

    def noted_in(self, result: R) -> R:
        """Return what was identified with the model, with a note of what was added to it."""
        return replace(result, refinement=self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the model, ready for JSON."""
        names = ("simulated", "not_reached", "reused")
        total = {name: sum(getattr(each, name) for each in self.rounds) for name in names}
        return {
            "states": total["simulated"] - total["not_reached"] + total["reused"],
            "refinement": self.model.membrane_database.settings["refinement"],
            **total,
            "share_before": self.share_before,
            "share_after": self.share_after,
            "small": self.small,
            "agrees": self.agrees,
            "rounds": [each._asdict() | {"score": each.score if each.tested else None} for each in self.rounds],
        }


@checked
def refine_model(
    measurements: Sequence[Measurement],
    experiment: Experiment,
    *,
    states: int,
    seed: int,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    prior: Prior | None = None,
    same_capsule: bool = False,
    inflation_varies: bool = False,
    scale_error: float = 0.0,
    folder: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Refinement:
    """Simulate more states where the posterior of one capsule or of a batch lies, and add them to the model.

    States of earlier runs that lie near the posterior are added first. New ones are simulated in rounds, until the
    model has less than a tenth of the variance of ln G_s and its errors at states that it had not seen are as stated.

    Parameters
    ----------
    measurements, experiment, membrane, same_capsule, inflation_varies, scale_error
        As of `identify_membrane`; one measurement is a batch of one.
    states : int
        At most so many are simulated.
    seed : int
    model : MembraneSurrogate, optional
        Default: that which comes with the library for the channel and the view of the outlines.
    prior : Prior, optional
        Of the parameters of the membrane; priors of G_s and a do not count here.
    folder : path, optional
        Where simulated states are kept and looked for; default: a folder in the user's cache.
    scheduler : str or None
    workers : int or None
        Where the states are simulated, see `identify_membrane`.
    progress : bool
        Show a bar on a terminal.

    Returns
    -------
    Refinement
        Its `model` is given to `identify` or `identify_membrane`.

    Raises
    ------
    InputError
        If a measurement cannot be used, nothing of the membrane is unknown, or no state is asked for.

    References
    ----------
    Conrad, Marzouk, Pillai, Smith 2016, J. Am. Stat. Assoc. 111, 1591, arXiv:1402.1694.
    """
    if states < 1:
        raise InputError(_HERE, "states", "a number from 1 on", str(states))
    if model is not None and not isinstance(model, MembraneSurrogate):  # opened by its name
        raise InputError(_HERE, "model", "one over the membrane, a MembraneSurrogate", model.name)
    first = model_of(measurements, experiment, model)
    spreads = spreads_of(len(measurements), same_capsule=same_capsule, inflation_varies=inflation_varies)
    of_capsules = {name: getattr(Prior(), name) for name in _OF_CAPSULES}
    unknowns = unknowns_of(first, membrane or Membrane(), replace(prior or Prior(), **of_capsules), experiment, spreads)
    if not unknowns.coordinates:
        raise InputError(_HERE, "membrane", "one of which something is unknown", "a known one")
    continuation = continuation_of(first.membrane_database)
    first.membrane_database.check_settings(continuation.settings)
    place = _folder_of_user(continuation) if folder is None else Path(folder)
    infer = partial(_Posterior.of, measurements, experiment, unknowns, scale_error)
    simulate = partial(further_states, folder=place, scheduler=scheduler, workers=workers, progress=progress)
    with threadpool_limits(limits=1):
        work = _Refining(first, continuation, infer, simulate, seed)
        work.reuse(kept_states(place, continuation))
        for count in map(len, np.array_split(np.arange(states), min(states, _ROUNDS))):
            if work.result.small and work.result.agrees:
                break
            work.add_new(count)
        return work.result


class _Refining:
    """A model, the states that were added to it, and the posterior by it."""

    def __init__(
        self,
        first: MembraneSurrogate,
        continuation: Continuation,
        infer: Callable[[MembraneSurrogate], _Posterior],
        simulate: Callable[[MembraneDatabase, Continuation, Floats], list[ScatteredState | None]],
        seed: int,
    ) -> None:
        self.first, self.continuation, self.seed = first, continuation, seed
        self.infer, self.simulate = infer, simulate
        self.added: list[ScatteredState] = []
        self.posterior = infer(first)
        self.result = Refinement(first, self.posterior.share, self.posterior.share, ())

    def reuse(self, kept: list[ScatteredState]) -> None:
        """Add those of some states that lie near the posterior."""
        candidates = self.posterior.candidates([self.seed])
        near = self._near(kept, candidates) if kept else {}
        states = [kept[number] for number in near]
        score = self._score(states, candidates.capsule[list(near.values())])
        self._add(Round(0, 0, len(states), len(states), score, np.nan), states)

    def add_new(self, count: int) -> None:
        """Simulate states where they are needed, of which the first ones test the model, and add them."""
        candidates = self.posterior.candidates([self.seed, len(self.result.rounds)])
        tests = min(max(round(_TESTED * count), _FEWEST_TESTED), count)
        rows = candidates.chosen(count, tests)
        places = self.continuation.places(candidates.values[rows])
        found = self.simulate(self.posterior.model.membrane_database, self.continuation, places)
        tested = [number for number in range(tests) if found[number] is not None]
        reached = [state for state in found if state is not None]
        score = self._score(reached[: len(tested)], candidates.capsule[rows][tested])
        self._add(Round(count, found.count(None), 0, len(tested), score, np.nan), reached)

    def _near(self, kept: list[ScatteredState], candidates: _Candidates) -> dict[int, int]:
        """Return the numbers of those of some states that lie near candidates, and the rows of the nearest of these."""
        places = self.posterior.model.error_places(self._theta(kept))
        away = cdist(places, candidates.places)
        return {number: int(np.argmin(row)) for number, row in enumerate(away) if row.min() < _NEAR}

    def _score(self, states: list[ScatteredState], capsule: Integers) -> float:
        """Return the root mean square of the model's errors at states over the stated ones; NaN without states."""
        if not states:
            return np.nan
        seen = [self.continuation.seen(state) for state in states]
        return float(np.sqrt(np.nanmean(self.posterior.square_errors(self._theta(states), capsule, seen))))

    def _theta(self, states: list[ScatteredState]) -> dict[str, Floats]:
        values = self.continuation.values(np.array([state.place for state in states]))
        return dict(zip(FREE_PARAMETERS, values.T, strict=True))

    def _add(self, made: Round, states: list[ScatteredState]) -> None:
        if states:
            self.added = sorted([*self.added, *states], key=lambda state: digest_of(state.place))  # as in any other run
            places = np.array([state.place for state in self.added])
            database = self.first.membrane_database.joined(scattered_dataset(self.continuation, places, self.added))
            self.posterior = self.infer(MembraneSurrogate(database, self.first.view))
        if states or made.simulated:
            model, share = self.posterior.model, self.posterior.share
            rounds = (*self.result.rounds, made._replace(share=share))
            self.result = replace(self.result, model=model, share_after=share, rounds=rounds)


class _Candidates(NamedTuple):
    """Draws of the widened posterior : shapes of single capsules, each as often as its weight says."""

    values: Floats  # (n, 6): of `FREE_PARAMETERS`
    capsule: Integers  # (n,): which of the batch has this shape
    places: Floats  # (n, 6): scaled, so that the model's own error changes over one
    variance: Floats  # (n,): of the model's own error, over that of what was measured, summed

    def chosen(self, count: int, tests: int) -> list[int]:
        """Return rows: at first some by chance, then those where states take most of the variance that is left."""
        # The errors are taken for a Gaussian process, of correlation exp(-r^2 / 2) at a distance r.
        _, distinct = np.unique(self.values, axis=0, return_index=True)
        chosen = np.sort(distinct)[:tests].tolist()
        deviation = np.sqrt(self.variance)
        left = deviation[:, None] * np.exp(-0.5 * cdist(self.places, self.places, "sqeuclidean")) * deviation
        least = _KNOWN * left.diagonal().max()
        for number in range(count):
            if number == len(chosen):
                chosen.append(int(np.argmax(np.sum(left**2, axis=0) / (left.diagonal() + least))))
            column = left[:, chosen[number]]
            left = left - np.outer(column, column) / (column[chosen[number]] + least)
        return chosen


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Posterior of the membrane by a model."""

    model: MembraneSurrogate
    capsules: Capsules  # without the error of the model
    unknowns: Unknowns
    sampled: Sampled
    share: float  # of the model in the variance of ln G_s

    @classmethod
    def of(
        cls,
        measurements: Sequence[Measurement],
        experiment: Experiment,
        unknowns: Unknowns,
        scale_error: float,
        model: MembraneSurrogate,
    ) -> _Posterior:
        exact = capsules_of(measurements, experiment, model, scale_error=scale_error)
        capsules = with_model_error(exact, unknowns)
        sampled = MembraneSampling(capsules, unknowns)()
        return cls(model, exact, unknowns, sampled, _share(exact, capsules, unknowns, sampled))

    def candidates(self, seed: list[int]) -> _Candidates:
        """Draw membranes of the widened posterior, and of each one of the capsules."""
        rng, draws = np.random.default_rng([*seed, 13]), self.sampled.draws
        rows = rng.permutation(rows_by_weight(normalised(wide_weights(draws)), rng, _CANDIDATES))
        capsule = rng.permutation(np.arange(_CANDIDATES) % len(self.capsules.batch))
        own = draws.found.own[rows, capsule][:, None]
        theta = self.capsules.model.theta(self.unknowns.membranes(draws.points[rows]), own)
        variance = np.nan_to_num(self._variance(theta, capsule)[0])  # none on the border of the model
        return _Candidates(parameter_columns(theta), capsule, self.model.error_places(theta), variance)

    def square_errors(
        self, theta: Mapping[str, Floats], capsule: Integers, seen: Sequence[Mapping[str, Floats]]
    ) -> Floats:
        """Return the squared errors (n,) of the model, over the stated ones, where n states were simulated."""
        stated, shapes = self._variance(theta, capsule)
        numbers = np.array([each["numbers"][:2] for each in seen])
        if self.capsules.model.outline:
            states, kind = self.model.membrane_database, OUTLINES[self.model.view]
            away = np.array([each[kind] for each in seen]) - states[f"{kind}_mean"].ravel()
            coefficients = away @ self.model.mode_shapes.reshape(len(self.model.mode_shapes), -1).T
            numbers = np.column_stack([coefficients, numbers[:, 1]])
        rows = self.capsules.batch.rows[capsule]
        error = np.einsum("nqk,nk->nq", rows, numbers - shapes.numbers)
        return np.asarray(np.sum(error**2, axis=1) / stated)

    def _variance(self, theta: Mapping[str, Floats], capsule: Integers) -> tuple[Floats, Shapes]:
        """Return the summed variance of the model's own error over that of the measurements, and the shapes."""
        rows, shapes = self.capsules.batch.rows, self.capsules.model(theta)
        precision = (rows.swapaxes(1, 2) @ rows)[capsule]
        return np.einsum("nkl,nkl->n", precision, shapes.covariances), shapes


def _share(exact: Capsules, capsules: Capsules, unknowns: Unknowns, sampled: Sampled) -> float:
    """Return the share of the model in the variance of ln G_s, see `Refinement`."""
    draws = sampled.draws
    log_modulus = draws.found.common[:, MODULUS]
    narrow, wide = (_variance(log_modulus, logs) for logs in (draws.log_weights, sampled.log_weights))
    best = slice(np.argmax(draws.log_density), np.argmax(draws.log_density) + 1)
    there = unknowns, draws.points[best], Start(draws.found.own[best], draws.found.common[best])
    known, stated = (step_of_all(each, *there).covariance[0, MODULUS, MODULUS] for each in (exact, capsules))
    return float(np.clip(1.0 - narrow / wide * known / stated, 0.0, 1.0))


def _variance(values: Floats, log_weights: Floats) -> float:
    """Return the variance of weighted draws."""
    weights = normalised(log_weights)
    return float(weights @ (values - weights @ values) ** 2)


def _folder_of_user(continuation: Continuation) -> Path:
    """Return where states of a continuation are kept."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    simulator = continuation.simulator
    name = f"{simulator.cross_section}-{simulator.refinement}-{digest_of(__version__, continuation.settings)[:12]}"
    return caches / "capsbayes" / "states" / name
