"""The sampling engine: several independent ensembles of emcee, extended until the gates hold.

Moves are differential evolution with some stretch. `DESnookerMove` of emcee
3.1.6 is never used: its proposal is wrong and makes intervals 7 % too narrow.

References
----------
Goodman, Weare 2010, Commun. Appl. Math. Comput. Sci. 5, 65, doi:10.2140/camcos.2010.5.65.
Foreman-Mackey, Hogg, Lang, Goodman 2013, PASP 125, 306, doi:10.1086/670067.
Nelson, Ford, Payne 2013, ApJS 210, 11, doi:10.1088/0067-0049/210/1/11.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer.checks import Gate
from capsbayes.infer.sampling.convergence import autocorrelation_time, chain_gates
from capsbayes.infer.sampling.initial_points import starting_points
from capsbayes.infer.sampling.log_density import LogDensity
from capsbayes.work.steps import step_of

Moves = Sequence[tuple[Any, float]]


@dataclass(frozen=True)
class Effort:
    """Amount of sampling.

    Parameters
    ----------
    ensembles : int
        Independent ensembles.
    walkers : int
        Of each ensemble.
    steps : int
        Before the gates are evaluated for the first time.
    extension : float
        Share of the steps done by which the run grows while a gate fails.
    budget : int
        Steps after which sampling ends in any case.
    doublings : int
        Largest number of times that a run which passed its gates is doubled because it is not precise enough.
    """

    ensembles: int = 4
    walkers: int = 64
    steps: int = 450
    extension: float = 0.15
    budget: int = 10_000
    doublings: int = 3


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of the walkers after burn-in.

    Parameters
    ----------
    names : tuple of str
        Coordinates; the first is the logarithm of the capillary number.
    coordinates : (steps, ensembles, walkers, d) array
    log_density : (steps, ensembles, walkers) array
    time : float
        Longest autocorrelation time, in steps.
    burn_in, steps : int
        Steps omitted and kept.
    gates : list of Gate
    """

    names: tuple[str, ...]
    coordinates: Floats
    log_density: Floats
    time: float
    burn_in: int
    steps: int
    gates: list[Gate]

    def named(self) -> dict[str, Floats]:
        """Return the coordinates by name, Ca itself in place of its logarithm : (steps, ensembles, walkers) arrays."""
        named = dict(zip(self.names, np.moveaxis(self.coordinates, -1, 0), strict=True))
        return named | {"capillary_number": np.exp(named["capillary_number"])}

    def thinned(self) -> Chains:
        """Return the chains thinned so much that consecutive steps are nearly independent."""
        every = max(1, int(self.time / 2.0))
        return Chains(
            self.names,
            self.coordinates[::every],
            self.log_density[::every],
            self.time,
            self.burn_in,
            self.steps,
            self.gates,
        )


def sampled(
    log_density: LogDensity,
    *,
    seed: int,
    effort: Effort | None = None,
    enough: Callable[[Chains], bool] = lambda chains: True,
    cloud: Floats | None = None,
    moves: Moves | None = None,
) -> Chains:
    """Sample a posterior.

    Parameters
    ----------
    log_density : LogDensity
    seed : int
        Of the starts and of every ensemble.
    effort : Effort, optional
    enough : callable
        Called once the gates hold; while it returns False the run is doubled, at most `Effort.doublings` times.
    cloud : (n, d) array, optional
        Points of the posterior about which the walkers start; by default they are sought over the whole domain.
    moves : sequence of pairs of a move of emcee and its share, optional
        By default differential evolution with some stretch.

    Returns
    -------
    Chains
        With the gates as they stood at the end; they need not have passed.
    """
    effort = effort or Effort()
    if effort.walkers < 2 * len(log_density.names):
        expected = f"at least two for each of {len(log_density.names)} dimensions"
        raise InputError("effort", "walkers", expected, str(effort.walkers))
    root = np.random.SeedSequence(seed)
    rng = np.random.default_rng(root.spawn(1)[0])
    starts = starting_points(log_density, effort.ensembles, effort.walkers, rng, cloud)
    seeds = [int(word) for word in root.generate_state(effort.ensembles)]
    ensembles = [[_begun(log_density, *pair)] for pair in zip(starts, seeds, strict=True)]
    ahead, todo, doublings = 0, effort.steps, 0
    while True:
        for stretches in ensembles:
            stretches.append(_continued(log_density, stretches[0], stretches[-1], todo, moves))
        ahead += todo
        chains = _gathered(ensembles, log_density)
        if ahead >= effort.budget:
            return chains
        growth = effort.extension
        if all(gate.passed for gate in chains.gates):
            if doublings == effort.doublings or enough(chains):
                return chains
            growth, doublings = 1.0, doublings + 1
        todo = min(math.ceil(growth * ahead), effort.budget - ahead)


class _Stretch(NamedTuple):
    """Some steps of an ensemble.

    Parameters
    ----------
    chain : (steps, walkers, d) array
    log_density : (steps, walkers) array
    random : (624,) array
        State of the random numbers at the end, with the next three.
    position, has_gauss : int
    cached_gauss : float
    wrong : int
        Points that were visited whose density is not a number.
    """

    chain: Floats
    log_density: Floats
    random: NDArray[np.uint32]
    position: int
    has_gauss: int
    cached_gauss: float
    wrong: int


def _begun(log_density: LogDensity, start: Floats, seed: int) -> _Stretch:
    """Return the points (walkers, d) at which an ensemble starts, as its first step."""
    state: Any = np.random.RandomState(seed).get_state()
    random: tuple[NDArray[np.uint32], int, int, float] = state[1:]
    return _Stretch(start[None], log_density(start)[None], *random, 0)


def _continued(log_density: LogDensity, first: _Stretch, last: _Stretch, todo: int, moves: Moves | None) -> _Stretch:
    """Continue an ensemble; the densities at its first points stand for the posterior among what this depends on."""

    def run() -> _Stretch:
        import emcee

        kinds, shares = zip(*(moves or [(emcee.moves.DEMove(), 0.9), (emcee.moves.StretchMove(), 0.1)]), strict=True)
        rng = np.random.RandomState()
        rng.set_state(("MT19937", *last[2:6]))
        before = log_density.not_a_number
        # the loop of emcee's sampler, which checks and copies for longer than the density takes
        model = emcee.model.Model(log_density, lambda points: (log_density(points), None), map, rng)
        state = emcee.State(last.chain[-1], log_prob=last.log_density[-1], copy=True)
        chain, densities = np.empty((todo, *state.coords.shape)), np.empty((todo, len(state.coords)))
        for step in range(todo):
            state, _ = rng.choice(kinds, p=shares).propose(model, state)
            chain[step], densities[step] = state.coords, state.log_prob
        wrong = log_density.not_a_number - before
        after: Any = rng.get_state()
        random: tuple[NDArray[np.uint32], int, int, float] = after[1:]
        return _Stretch(chain, densities, *random, wrong)

    return step_of(_Stretch, ("ensemble", first, last.chain[-1], last[2:6], todo), run)


def _gathered(ensembles: list[list[_Stretch]], log_density: LogDensity) -> Chains:
    """Return the chains of all ensembles without the first points and the burn-in, and their gates."""
    moved = np.stack([np.concatenate([each.chain for each in stretches[1:]]) for stretches in ensembles], axis=1)
    chain = log_density.unfolded(moved)
    steps, _, _, dimensions = chain.shape
    flat = chain[steps // 4 :].reshape(steps - steps // 4, -1, dimensions)
    time = max(autocorrelation_time(flat[..., k]) for k in range(dimensions))
    burn_in = min(math.ceil(6.0 * time), steps // 2)
    each_density = [np.concatenate([each.log_density for each in stretches[1:]]) for stretches in ensembles]
    density = np.stack(each_density, axis=1)
    kept = chain[burn_in:]
    wrong = sum(each.wrong for stretches in ensembles for each in stretches)
    gates = [*chain_gates(kept), Gate("densities that are not a number", wrong, most=0)]
    return Chains(log_density.names, kept, density[burn_in:], time, burn_in, steps - burn_in, gates)
