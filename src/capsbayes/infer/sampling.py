"""The sampling engine: ensembles of emcee, extended until they have converged."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.importance import WeightedPosterior
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.infer.proposal import normalised, tempering
from capsbayes.model import ForwardModel
from capsbayes.run import step_of

# Convergence of walkers: R-hat between ensembles, autocorrelation time, bulk and tail effective sample size; gates.
#
# The definitions are those of ArviZ, with which the tests compare. ArviZ itself is not used: its import takes one to
# two seconds, longer than the sampling, and its R-hat takes the walkers of an ensemble for independent chains.
#
# Vehtari, Gelman, Simpson, Carpenter, Burkner 2021, Bayesian Analysis 16, 667, doi:10.1214/20-BA1221

FEWEST_ENSEMBLES = 4
LARGEST_RHAT = 1.01
FEWEST_TIMES = 50.0
LEAST_STABLE_TIME = 0.01
SMALLEST_ESS = 400.0
ACCEPTANCE = (0.1, 0.9)


def chain_gates(chain: Floats) -> list[Gate]:
    """Return the gates that need every step: R-hat, length in autocorrelation times, acceptance, stuck walkers."""
    steps, ensembles, walkers, dimensions = chain.shape
    flat = chain.reshape(steps, ensembles * walkers, dimensions)
    times = np.array([autocorrelation_time(flat[..., k]) for k in range(dimensions)])
    before = np.array([autocorrelation_time(flat[: int(0.95 * steps), :, k]) for k in range(dimensions)])
    rhat = max(split_rhat(chain[..., k]) for k in range(dimensions))
    moved = np.any(np.diff(chain, axis=0) != 0.0, axis=-1)
    acceptance = moved.mean(axis=(0, 2))
    stuck = int(np.count_nonzero(~moved[len(moved) // 2 :].any(axis=0)))
    unstable = float(np.max(np.abs(before / times - 1.0)))
    low, high = ACCEPTANCE
    return [
        Gate("independent ensembles", ensembles, least=FEWEST_ENSEMBLES),
        Gate("split R-hat between ensembles", rhat, most=LARGEST_RHAT),
        Gate("steps over autocorrelation time", steps / float(times.max()), least=FEWEST_TIMES),
        Gate("change of autocorrelation time over the last twentieth", unstable, most=LEAST_STABLE_TIME),
        Gate("lowest acceptance", float(acceptance.min()), least=low),
        Gate("highest acceptance", float(acceptance.max()), most=high),
        Gate("stuck walkers", stuck, most=0),
    ]


def ess_gates(draws: Mapping[str, Floats]) -> list[Gate]:
    """Return the gates on the effective sample sizes of the reported quantities that vary."""
    varying = [values for values in draws.values() if np.ptp(values) > 0.0]
    found = {"smallest bulk ESS": min(map(bulk_ess, varying)), "smallest tail ESS": min(map(tail_ess, varying))}
    return [Gate(name, value, least=SMALLEST_ESS) for name, value in found.items()]


def split_rhat(draws: Floats) -> float:
    """Return the rank-normalised R-hat between the halves of independent ensembles."""
    # Walkers of one ensemble are pooled: they are not independent chains.
    half = len(draws) // 2
    scores = _normal_scores(draws[: 2 * half])
    chains = np.stack([scores[:half], scores[half:]]).transpose(0, 2, 1, 3).reshape(2 * draws.shape[1], -1)
    count = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean()
    between = count * chains.mean(axis=1).var(ddof=1)
    return float(np.sqrt((count - 1) / count + between / within / count))


def autocorrelation_time(draws: Floats) -> float:
    """Return the integrated autocorrelation time in steps, by emcee's window of five times itself."""
    # The covariances of the walkers are averaged, so that one that never moves counts as such.
    correlation = _autocovariance(draws.T).mean(axis=0)
    times = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    window = np.flatnonzero(np.arange(len(times)) >= 5.0 * times)
    return float(times[window[0] if window.size else -1])


def bulk_ess(draws: Floats) -> float:
    """Return the effective sample size of the rank-normalised draws."""
    return _ess(_normal_scores(_split(draws)))


def tail_ess(draws: Floats) -> float:
    """Return the smaller effective sample size of the 5 % and of the 95 % quantile."""
    halves = _split(draws)
    low, high = np.quantile(halves, [0.05, 0.95])
    return min(_ess((halves <= low).astype(float)), _ess((halves <= high).astype(float)))


def _split(draws: Floats) -> Floats:
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def _normal_scores(draws: Floats) -> Floats:
    """Return the normal quantiles of the ranks, ties in order: repeated draws are neighbours in any case."""
    from scipy.special import ndtri

    order = np.argsort(draws, axis=None, kind="stable")
    ranks = np.empty(draws.size)
    ranks[order] = np.arange(1, draws.size + 1)
    return np.asarray(ndtri((ranks - 0.375) / (draws.size + 0.25))).reshape(draws.shape)


def _autocovariance(chains: Floats) -> Floats:
    """Return the autocovariance of each row : (chains, draws) array."""
    count = chains.shape[1]
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), size, axis=1)
    return np.fft.irfft(np.abs(spectrum) ** 2, size, axis=1)[:, :count] / count


def _ess(chains: Floats) -> float:
    """Return the effective sample size by Geyer's initial monotone sequence, differences between chains included."""
    number, count = chains.shape
    covariance = _autocovariance(chains).mean(axis=0)
    within = covariance[0] * count / (count - 1.0)
    plus = within * (count - 1.0) / count + (chains.mean(axis=1).var(ddof=1) if number > 1 else 0.0)
    if not plus > 0.0:
        return float(number * count)
    rho = 1.0 - (within - covariance) / plus
    rho[0] = 1.0
    pairs = rho[: count // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    kept = np.minimum.accumulate(pairs[: negative[0] if negative.size else None])
    tau = max(-1.0 + 2.0 * float(kept.sum()), 1.0 / np.log10(number * count))
    return number * count / tau


# Log posterior density of a batch of parameter vectors, which the walkers sample


class LogDensity:
    """Log posterior density over (log Ca, a/l, further coordinates, and l if the shape depends on it)."""

    # The inputs that the shape does not depend on are integrated out exactly and drawn afterwards.

    def __init__(self, model: ForwardModel, density: PosteriorDensity) -> None:
        self.model, self.density = model, density
        self.sampled = self._sampled()
        further = tuple(coordinate.name for coordinate in density.coordinates)
        self.names = ("capillary_number", "size_ratio", *further, *self.sampled)
        self.not_a_number = 0

    def __call__(self, coordinates: Floats) -> Floats:
        """Return the log density : (n, d) -> (n,) array, -inf where the density vanishes or is not a number."""
        theta = self.named(coordinates)
        impossible = np.zeros(len(coordinates), dtype=bool)
        for name in self.sampled:
            impossible |= theta[name] <= 0.0
            theta[name] = np.where(impossible, getattr(self.density.inputs, name).value, theta[name])
        points = self.density.evaluated(self.model, theta)
        outside = np.isnan(points.extent)
        log_density = self._of_points(points, coordinates[:, 0], theta)
        for coordinate in self.density.coordinates:
            log_density = log_density + coordinate.log_density(theta[coordinate.name])
        wrong = np.isnan(log_density)
        if wrong.any():
            inside = self.model.domain.contains(*(theta[name] for name in self.names if name not in self.sampled))
            self.not_a_number += int(np.count_nonzero(wrong & inside))
        return np.where(wrong | outside | impossible, -np.inf, log_density)

    def named(self, coordinates: Floats) -> dict[str, Floats]:
        """Return the coordinates (n, d) by name, Ca itself in place of its logarithm."""
        theta = dict(zip(self.names, coordinates.T, strict=True))
        theta["capillary_number"] = np.exp(theta["capillary_number"])
        return theta

    def unfolded(self, coordinates: Floats) -> Floats:
        """Return the coordinates `names` of points (..., d) in which the walkers move : the same here."""
        return coordinates

    def _sampled(self) -> tuple[str, ...]:
        return ("half_width",) if self.density.shape_depends_on_half_width else ()

    def _of_points(self, points: ModelAtPoints, log_ca: Floats, theta: dict[str, Floats]) -> Floats:
        return self.density.log_of_nodes(points, log_ca, theta["size_ratio"], theta.get("half_width"))


# Initial points of the walkers: of finite density, spread somewhat wider than the posterior.
#
# Points are drawn over the whole domain, weighted by a power of their density that keeps enough of them alive, and the
# cloud they describe is drawn from again; a few rounds lead from the domain to the posterior wherever it is

_CLOUD = 4096
_ALIVE = 1024
_ROUNDS = 24
_WIDENING = 1.5


def starting_points(
    log_density: LogDensity, ensembles: int, walkers: int, rng: np.random.Generator, cloud: Floats | None = None
) -> Floats:
    """Draw initial points for several ensembles."""
    if cloud is not None:
        return _finite(log_density, cloud, (ensembles, walkers), rng)
    cloud = _over_domain(log_density, rng)
    for _ in range(_ROUNDS):
        values = log_density(cloud)
        alive = np.isfinite(values)
        if np.count_nonzero(alive) < 4:
            raise ValueError("no point of the model's domain has a finite posterior density")
        cloud, values = cloud[alive], values[alive]
        power = tempering(values, min(_ALIVE, len(values) // 2))
        kept = cloud[rng.choice(len(cloud), size=_CLOUD, p=normalised(power * values))]
        if power == 1.0:
            break
        cloud = _jittered(kept, rng, 0.4)
    return _finite(log_density, kept, (ensembles, walkers), rng)


def _over_domain(log_density: LogDensity, rng: np.random.Generator) -> Floats:
    (ca_low, ca_high), (size_low, size_high) = log_density.model.domain.bounds
    columns = [rng.uniform(np.log(ca_low), np.log(ca_high), _CLOUD), rng.uniform(size_low, size_high, _CLOUD)]
    columns += [each.values(rng.uniform(size=_CLOUD)) for each in log_density.density.coordinates]
    columns += [getattr(log_density.density, name).drawn(rng, _CLOUD) for name in log_density.sampled]
    return np.stack(columns, axis=1)


def _jittered(points: Floats, rng: np.random.Generator, factor: float) -> Floats:
    """Move points by a share of their own spread, so that no two coincide."""
    # The points are rounded to a millionth of the spread: walkers amplify a difference in the last digit until their
    # chains have nothing in common, and that digit depends on the processor.
    away = points - points.mean(axis=0)
    spread = np.linalg.cholesky(np.einsum("ni,nj->ij", away, away) / (len(points) - 1) + 1e-18 * np.eye(away.shape[1]))
    moved = points + factor * np.einsum("nj,ij->ni", rng.standard_normal(points.shape), spread)
    grain = 2.0 ** np.floor(np.log2(1e-6 * np.sqrt(np.sum(spread**2, axis=1))))
    return np.asarray(grain * np.round(moved / grain))


def _finite(log_density: LogDensity, points: Floats, shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """Draw initial points around the points until every one has a finite density."""
    count = shape[0] * shape[1]
    centre = points.mean(axis=0)
    starts = np.empty((0, points.shape[1]))
    while len(starts) < count:
        drawn = points[rng.choice(len(points), size=2 * count)]
        wide = _jittered(centre + _WIDENING * (drawn - centre), rng, 0.1)
        both = np.concatenate([wide, _jittered(drawn, rng, 1e-3)])  # the latter where the former leaves the domain
        good = np.isfinite(log_density(both))
        starts = np.concatenate([starts, both[: len(wide)][good[: len(wide)]], both[len(wide) :][good[len(wide) :]]])
    return starts[:count].reshape(*shape, -1)


# The sampling engine: several independent ensembles of emcee, extended until the gates hold.
#
# Moves are differential evolution with some stretch. `DESnookerMove` of emcee 3.1.6 is never used: its proposal is
# wrong and makes intervals 7 % too narrow.
#
# Goodman, Weare 2010, Commun. Appl. Math. Comput. Sci. 5, 65, doi:10.2140/camcos.2010.5.65. Foreman-Mackey, Hogg, Lang,
# Goodman 2013, PASP 125, 306, doi:10.1086/670067. Nelson, Ford, Payne 2013, ApJS 210, 11,
# doi:10.1088/0067-0049/210/1/11

Moves = Sequence[tuple[Any, float]]


@dataclass(frozen=True)
class Effort:
    """Amount of sampling."""

    ensembles: int = 4
    walkers: int = 64  # of each ensemble
    steps: int = 450  # before the gates are evaluated for the first time
    extension: float = 0.15  # share of the steps done by which the run grows while a gate fails
    budget: int = 10_000  # steps after which sampling ends in any case
    doublings: int = 3  # at most, of a run that passed its gates but is not precise enough


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of the walkers after burn-in."""

    names: tuple[str, ...]  # coordinates; the first is the logarithm of the capillary number
    coordinates: Floats  # (steps, ensembles, walkers, d)
    log_density: Floats  # (steps, ensembles, walkers)
    time: float  # longest autocorrelation time, in steps
    burn_in: int  # steps omitted
    steps: int  # steps kept
    gates: list[Gate]

    def named(self) -> dict[str, Floats]:
        """Return the coordinates by name, Ca itself in place of its logarithm : (steps, ensembles, walkers) arrays."""
        named = dict(zip(self.names, np.moveaxis(self.coordinates, -1, 0), strict=True))
        return named | {"capillary_number": np.exp(named["capillary_number"])}

    def thinned(self) -> Chains:
        """Return the chains thinned so much that consecutive steps are nearly independent."""
        every = max(1, int(self.time / 2.0))
        return replace(self, coordinates=self.coordinates[::every], log_density=self.log_density[::every])


def sampled(
    log_density: LogDensity,
    *,
    seed: int,
    effort: Effort | None = None,
    enough: Callable[[Chains], bool] = lambda chains: True,
    cloud: Floats | None = None,
    moves: Moves | None = None,
) -> Chains:
    """Sample a posterior."""
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
    """Some steps of an ensemble."""

    chain: Floats  # (steps, walkers, d)
    log_density: Floats  # (steps, walkers)
    random: NDArray[np.uint32]  # (624,): state of the random numbers at the end, with the next three
    position: int
    has_gauss: int
    cached_gauss: float
    wrong: int  # points of which the density is not a number


def _begun(log_density: LogDensity, start: Floats, seed: int) -> _Stretch:
    """Return the points (walkers, d) at which an ensemble starts, as its first step."""
    state: Any = np.random.RandomState(seed).get_state()
    random: tuple[NDArray[np.uint32], int, int, float] = state[1:]
    return _Stretch(start[None], log_density(start)[None], *random, 0)


def _continued(log_density: LogDensity, first: _Stretch, last: _Stretch, todo: int, moves: Moves | None) -> _Stretch:
    """Continue an ensemble; the densities at its first points stand for the posterior among what this depends on."""

    def run() -> _Stretch:
        import emcee

        usual = [(emcee.moves.DEMove(), 0.9), (emcee.moves.StretchMove(), 0.1)]
        sampler = emcee.EnsembleSampler(*last.chain[-1].shape, log_density, moves=moves or usual, vectorize=True)
        start = emcee.State(last.chain[-1], log_prob=last.log_density[-1], random_state=("MT19937", *last[2:6]))
        before = log_density.not_a_number
        sampler.run_mcmc(start, todo, skip_initial_state_check=True)
        wrong = log_density.not_a_number - before
        random: tuple[NDArray[np.uint32], int, int, float] = sampler.random_state[1:]
        return _Stretch(sampler.get_chain(), sampler.get_log_prob(), *random, wrong)

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


# The sampling engine for several further coordinates: walkers relative to the sheet on which the posterior lies.
#
# There the posterior is nearly a mixture of normal distributions, and walkers may also jump to draws of a mixture

_JUMPS, _DIFFERENCES, _STRETCHES = 0.45, 0.4, 0.15  # shares of the moves
_SHEET_CLOUD = 4096


class SheetDensity(LogDensity):
    """Log posterior density relative to the sheet of a weighted posterior, each coordinate by its normal score."""

    def __init__(self, posterior: WeightedPosterior) -> None:
        super().__init__(posterior.forward, posterior.density)
        self.posterior = posterior

    def __call__(self, coordinates: Floats) -> Floats:
        points = self.posterior.proposal.sheet.raised(coordinates)
        return self.posterior.frame.evaluated(self.model, self.density, points)[1]

    def unfolded(self, coordinates: Floats) -> Floats:
        flat = coordinates.reshape(-1, coordinates.shape[-1])
        theta = self.posterior.frame.theta(self.posterior.proposal.sheet.raised(flat))
        theta["capillary_number"] = np.log(theta["capillary_number"])
        return np.stack([theta[name] for name in self.names], axis=1).reshape(coordinates.shape)

    def beginning(self, seed: int) -> dict[str, Any]:
        """Return the moves of the walkers, and draws of the weighted posterior about which they start."""
        rows = self.posterior.resampled(np.random.default_rng([seed, 2]), _SHEET_CLOUD)
        cloud = self.posterior.proposal.sheet.flattened(self.posterior.points[rows])
        return {"cloud": cloud, "moves": self._moves()}

    def _moves(self) -> Moves:
        """Return jumps to draws of the mixture, which differential evolution and stretches go on from."""
        import emcee

        proposal = self.posterior.proposal

        def jump(walkers: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
            there = proposal.drawn_flat(random.uniform(size=(len(walkers), walkers.shape[1] + 2)))
            return there, proposal.log_density_flat(walkers) - proposal.log_density_flat(there)

        return (
            (emcee.moves.MHMove(jump), _JUMPS),
            (emcee.moves.DEMove(), _DIFFERENCES),
            (emcee.moves.StretchMove(), _STRETCHES),
        )
