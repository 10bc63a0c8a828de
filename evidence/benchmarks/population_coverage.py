"""Coverage of the intervals of populations.

Run ``python -m evidence.benchmarks.population_coverage [kinds|shared|cut] [--sessions 200] [--only t3]``. ``kinds``
writes the counts to ``evidence/results/population-coverage.json``, row by row, and the table into
``evidence/results/populations.md``, where the sessions are described. ``shared`` counts 95 % intervals in sessions of
150 and 1000 capsules, also with viscosity and half width taken as exact; ``cut`` those of sessions of which only the
capsules above Lambda = 1.08 are kept, with the cut ignored and accounted for. Their tables are printed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from evidence.benchmarks.counts import LEVELS, covered, percent
from evidence.benchmarks.stored import ROOT, Stored, arguments
from evidence.markdown import table

sys.path.insert(0, str(ROOT / "tests" / "support"))
from drawn_populations import TRUTH, drawn_population

from capsbayes.infer.hierarchy import hierarchy
from capsbayes.infer.population import Population
from capsbayes.infer.selection import half_width_of, kept_rows
from capsbayes.surrogate import Surrogate

DRAWN = 80  # capsules of a session, of which some are lost
SHARED = 0.2  # of the errors of the drawn sessions: a viscosity known to 1 %, a half width to 0.2 %
SOFT = TRUTH | {"surface_shear_modulus": 0.029}
SPREADS = ("modulus_spread_at_given_size", "radius_spread")
QUANTITIES = ("surface_shear_modulus", "modulus_spread_at_given_size", "capsule_radius", "radius_spread")
HEAD = ("population", "sessions", "seen", "G_s", "its spread at given size", "a", "its spread", "objections")
LARGER, LARGEST, CUT = 150, 1000, 1.08  # capsules of the further sessions, and the least Lambda that is kept

PLAIN: dict[str, Any] = {}
STUDENT: dict[str, Any] = {"tails": "student"}


class Row(NamedTuple):
    """Sessions of one kind, and how they are fitted."""

    title: str
    session: dict[str, Any]
    fit: dict[str, Any]


ROWS = {
    "normal": Row("normal", {}, PLAIN),
    "normal, t fitted": Row("normal, t distributions fitted", {}, STUDENT),
    "lost, ignored": Row("three in ten lost, ignored", {"truth": SOFT}, {"existence": False}),
    "lost": Row("three in ten lost", {"truth": SOFT}, PLAIN),
    "lost, lower": Row("three in ten lost, true limit 3 % lower", {"truth": SOFT, "limit": 0.97}, PLAIN),
    "t3": Row("t distributions of freedom 3", {"kind": "t3"}, PLAIN),
    "t3, t fitted": Row("t distributions of freedom 3, t fitted", {"kind": "t3"}, STUDENT),
    "contaminated": Row("one in ten from a population four times as wide", {"kind": "contaminated"}, PLAIN),
    "contaminated, t fitted": Row(
        "one in ten from a population four times as wide, t fitted", {"kind": "contaminated"}, STUDENT
    ),
}


@cache
def model() -> Surrogate:
    return Surrogate.open("square-neo-hookean")


def session(name: str, seed: int) -> dict[str, int]:
    """Return the counts of one session: ones and zeros, and the capsules drawn and seen."""
    row = ROWS[name]
    population = drawn_population(model(), DRAWN, seed, shared=SHARED, **row.session)
    found = hierarchy(population, seed=seed, **row.fit)
    truth = row.session.get("truth", TRUTH) | spreads(row)
    counts = {
        f"{quantity} {level}": int(found.marginals[quantity].contains(truth[quantity], level=level))
        for quantity in QUANTITIES
        for level in LEVELS
    }
    further = {"passed": int(found.passed), "objections": int(bool(found.odd_tails))}
    return counts | further | {"sessions": 1, "drawn": DRAWN, "seen": len(population)}


def spreads(row: Row) -> dict[str, float]:
    """Return the true spreads: half the width of the central 68.3 % of the population."""
    widths = {
        "normal": 1.0,
        "t3": stats.t.ppf(stats.norm.cdf(1.0), 3),
        "contaminated": half_width_of(np.array([[1.0, 16.0]]), np.array([[0.9, 0.1]]))[0],
    }
    return {name: TRUTH[name] * float(widths[row.session.get("kind", "normal")]) for name in SPREADS}


def with_shared_errors(capsules: int, seed: int) -> dict[str, bool]:
    """Return whether each 95 % interval of one session contains the truth."""
    found = hierarchy(drawn_population(model(), capsules, seed), seed=seed)
    held = {name: found.marginals[name].contains(truth, level=95) for name, truth in TRUTH.items()}
    for name, draws in found.without_shared.items():
        low, high = np.quantile(draws, [0.025, 0.975])
        held[f"{name}, shared errors ignored"] = bool(low <= TRUTH[name] <= high)
    return held | {"gates": found.passed}


def with_a_cut(seed: int) -> dict[str, bool]:
    """Return the same of a session of which the capsules above a cut are kept."""
    whole = drawn_population(model(), LARGER, seed)
    kept = Population(whole.dataset.isel(capsule=np.flatnonzero(kept_rows(whole, CUT))))
    found = {
        "cut ignored": hierarchy(kept, seed=seed),
        "accounted for": hierarchy(whole, seed=seed, least_stretch=CUT, model=model()),
    }
    return {
        f"{name}, {words}": fit.marginals[name].contains(truth, level=95)
        for words, fit in found.items()
        for name, truth in TRUTH.items()
    }


def summed(counted: Callable[[int], dict[str, Any]], sessions: int, workers: int) -> dict[str, int]:
    """Return the sums of the counts of sessions."""
    with ProcessPoolExecutor(workers) as pool:
        found = list(pool.map(counted, range(sessions)))
    return {key: sum(int(counts[key]) for counts in found) for key in found[0]}


def tables(known: dict[str, dict[str, int]]) -> dict[str, str]:
    """Return the table of the counts: per cent of the sessions, with the 95 % interval at the level of 95 %."""
    rows = []
    for name, counts in known.items():
        number = counts["sessions"]
        cells = [covered(counts, quantity, number) for quantity in QUANTITIES]
        seen, objections = counts["seen"] / counts["drawn"], counts["objections"] / number
        rows.append((ROWS[name].title, str(number), percent(seen), *cells, percent(objections)))
    return {"coverage": table(HEAD, rows)}


def print_shares(title: str, counts: dict[str, int], sessions: int) -> None:
    """Print a table of 95 % intervals that hold the truth."""
    rows = []
    for name, held in counts.items():
        low, high = stats.binomtest(held, sessions).proportion_ci()
        rows.append((name, str(held), str(sessions), f"{held / sessions:.1%} [{low:.1%}, {high:.1%}]"))
    print(f"{title}\n\n{table(('', '95 % intervals that hold the truth', 'of', 'share'), rows)}\n")


STORED = Stored("population-coverage.json", "evidence/results/populations.md", tables)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("what", nargs="?", choices=("kinds", "shared", "cut"), default="kinds")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--only", choices=ROWS, nargs="*", default=list(ROWS))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.what == "cut":
        words = f"{given.sessions} sessions of {LARGER} capsules, those above Lambda = {CUT} kept"
        print_shares(words, summed(with_a_cut, given.sessions, given.workers), given.sessions)
    elif given.what == "shared":
        for capsules, sessions in ((LARGER, given.sessions), (LARGEST, max(given.sessions // 5, 10))):
            counts = summed(partial(with_shared_errors, capsules), sessions, given.workers)
            print_shares(f"{sessions} sessions of {capsules} capsules", counts, sessions)
    else:
        known = STORED.read()
        for name in given.only:
            known[name] = summed(partial(session, name), given.sessions, given.workers)
            known = {row: known[row] for row in ROWS if row in known}
            STORED.show(known, write=True)


if __name__ == "__main__":
    main()
