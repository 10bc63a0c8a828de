"""Coverage of the intervals of populations.

Run ``python -m evidence.benchmarks.population_coverage [--sessions 200] [--only t3]``. Sessions of drawn capsules:
normal populations, soft ones of which three in ten have no steady shape, ones with heavy tails, and ones with odd
capsules. The lengths are perturbed by the surrogate's own error as well as by that of the measurement, and in one row
the true limit of steady shapes lies 3 % below that of the model. Of each fit it counts how often the 68 % and 95 %
intervals contain the truth, and how often the check of the tails objects.

The counts are written to ``evidence/results/population-coverage.json``, row by row, the table into
``evidence/results/populations.md``.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from evidence.markdown import renew

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
from drawn_populations import TRUTH, drawn_population

from capsbayes.infer.hierarchy import hierarchy
from capsbayes.infer.selection import half_width_of
from capsbayes.surrogate import Surrogate

ROOT = Path(__file__).parents[2]
STORED, PAGE = (
    ROOT / "evidence" / "results" / "population-coverage.json",
    ROOT / "evidence" / "results" / "populations.md",
)
MARKS = "<!-- coverage -->\n", "<!-- end of coverage -->\n"
DRAWN = 80  # capsules of a session, of which some are lost
SHARED = 0.2  # of the errors of the drawn sessions: a viscosity known to 1 %, a half width to 0.2 %
SOFT = TRUTH | {"surface_shear_modulus": 0.029}
SPREADS = ("modulus_spread_at_given_size", "radius_spread")
QUANTITIES = ("surface_shear_modulus", "modulus_spread_at_given_size", "capsule_radius", "radius_spread")
LEVELS = (68, 95)

PLAIN: dict[str, Any] = {}
STUDENT: dict[str, Any] = {"tails": "student"}


@dataclass(frozen=True)
class Row:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--only", choices=ROWS, nargs="*", default=list(ROWS))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    known = json.loads(STORED.read_text()) if STORED.exists() else {}
    known = {row: known[row] for row in ROWS if row in known}
    with ProcessPoolExecutor(given.workers) as pool:
        for name in given.only:
            sessions = list(pool.map(partial(session, name), range(given.sessions)))
            known[name] = {key: sum(counts[key] for counts in sessions) for key in sessions[0]}
            known = {row: known[row] for row in ROWS if row in known}
            STORED.write_text(json.dumps(known, indent=1) + "\n")
            print(table({name: known[name]}), flush=True)
    renew(PAGE, *MARKS, table(known))


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


def table(known: dict[str, dict[str, int]]) -> str:
    """Return the counts as a Markdown table: per cent of the sessions, with the 95 % interval at the level of 95 %."""
    head = "| population | sessions | seen | G_s | its spread at given size | a | its spread | objections |\n"
    lines = [head, "|---|---|---|---|---|---|---|---|\n"]
    for name, counts in known.items():
        number = counts["sessions"]
        cells = [
            f"{counts[f'{quantity} 68'] / number:.0%}, {share(counts[f'{quantity} 95'], number)}"
            for quantity in QUANTITIES
        ]
        seen = f"{counts['seen'] / counts['drawn']:.0%}"
        objections = f"{counts['objections'] / number:.0%}"
        lines.append(f"| {ROWS[name].title} | {number} | {seen} | {' | '.join(cells)} | {objections} |\n")
    return re.sub(" ?%", " %", "".join(lines))


def share(count: int, number: int) -> str:
    """Return a share with its binomial 95 % interval."""
    low, high = stats.binomtest(count, number).proportion_ci()
    return f"**{count / number:.1%}** ({100 * low:.0f} to {100 * high:.0f})"


if __name__ == "__main__":
    main()
