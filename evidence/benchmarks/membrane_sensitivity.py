"""What a batch is expected to tell of its membrane, and what it tells: ``membrane_sensitivity.py FOLDER``.

The batches are those of ``data/pools/membrane-batches.npz``, simulated one by one and measured as in
``membrane_batches.py``, several times with other noise (``--noises``). Each is identified with the membrane unknown.
The standard deviations that the answers state are compared with those that the flow design expects of a batch with
the same membrane, population and flow rates, before anything is measured. The same design says what one capsule would
tell at the best one to four flow rates.

Each finished batch is kept in FOLDER, so that an interrupted run resumes. ``--write`` renews
``evidence/results/membrane-sensitivity.json`` and the tables in ``evidence/results/membrane.md``, also that of the map,
which is ``evidence/results/membrane-map.json``, a ``map.json`` of ``capsbayes sensitivity map --membrane unknown``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes import LabErrors, Membrane, Quantity, membrane_flow_design
from capsbayes.arrays import Floats
from capsbayes.membrane_database import FREE_PARAMETERS
from capsbayes.plan.widths import LOGARITHMIC
from capsbayes.run import Store
from evidence.benchmarks import membrane_batches, membrane_coverage, membrane_pools
from evidence.benchmarks.membrane_batches import PUMP, Session
from evidence.benchmarks.membrane_coverage import HALF_WIDTH, LENGTH_ERROR, NOISE, VELOCITY, VISCOSITY
from evidence.markdown import renew

ROOT = Path(__file__).parents[2]
STORED, PAGE = (
    ROOT / "evidence" / "results" / "membrane-sensitivity.json",
    ROOT / "evidence" / "results" / "membrane.md",
)
MARKS = "<!-- expected and found -->\n", "<!-- end of expected and found -->\n"
SAME = ROOT / "evidence" / "results" / "membrane-same-capsule.json"
SAME_MARKS = "<!-- same capsule -->\n", "<!-- end of same capsule -->\n"
MAP, MAP_MARKS = ROOT / "evidence" / "results" / "membrane-map.json", ("<!-- map -->\n", "<!-- end of map -->\n")
QUANTITIES = {
    "surface_shear_modulus": "ln mean G_s",
    "pre_inflation": "alpha",
    "area_dilation_modulus": "ln K",
    "strain_hardening": "h",
    "bending": "ln B",
}
USABLE = "DONE", "LEANS_ON_BORDER"


def found(pool: dict[str, Floats], number: int, kind: str, noise: int) -> dict[str, Any]:
    """Return the standard deviations that the answer to one batch states, and its status."""
    session = Session(pool, number, kind, noise)
    answer = session.found("unknown", np.ones(len(session.flow), dtype=bool))
    logarithmic = "surface_shear_modulus", *LOGARITHMIC
    draws = {name: answer.draws[name] for name in QUANTITIES}
    sds = {name: float(np.std(np.log(values) if name in logarithmic else values)) for name, values in draws.items()}
    return {"status": answer.status.name, **sds}


def expected(pool: dict[str, Floats], number: int, kind: str) -> dict[str, Any]:
    """Return the standard deviations that are expected of a batch of which membrane and population are known."""
    rows = np.flatnonzero(pool["batch"] == number)
    one = {key: pool[key][rows[0]] for key in membrane_pools.OF_SOME if key in pool}
    values, speeds = pool["values"][rows[0]], VELOCITY[0] * pool["flow_factor"][rows]
    modulus = float(VISCOSITY[0] * speeds[0] / values[0] / one["relative_modulus"])
    radius = float(HALF_WIDTH[0] * values[1] / one["relative_radius"])
    design = membrane_flow_design(
        Quantity(modulus, modulus * float(one["modulus_spread"]), "N/m"),
        Quantity(radius, radius * float(one["radius_spread"]), "m"),
        membrane_coverage.experiment(),
        _errors(kind),
        seed=1,
        guess=Membrane(**dict(zip(FREE_PARAMETERS[2:], values[2:].tolist(), strict=True))),
        capsules=len(rows),
        velocities=sorted(set(speeds.tolist())),
    )
    return {name: design.sets[0].sds[name] for name in QUANTITIES}


def _errors(kind: str) -> LabErrors:
    outline = NOISE if kind == "outline" else None
    return LabErrors(LENGTH_ERROR, VELOCITY[1], LENGTH_ERROR, outline=outline, flow_rate=PUMP)


def of_same_capsule(kind: str) -> dict[str, Any]:
    """Return what is expected of one capsule of a membrane in the middle of the priors, at one to four flow rates."""
    design = membrane_flow_design(
        "50 mN/m",
        Quantity(0.96 * HALF_WIDTH[0], 0.0, "m"),
        membrane_coverage.experiment(),
        _errors(kind),
        seed=1,
        same_capsule=True,
        flows=4,
    )
    return {
        str(len(planned.mean_velocities)): {
            "known": planned.sd_if_known,
            **{name: planned.sds[name] for name in QUANTITIES},
        }
        for planned in design.sets
    }


def run(folder: Path, noises: int) -> None:
    """Compute what the folder lacks."""
    pool, store = membrane_pools.stored("batches"), membrane_batches.store_of(folder)
    for kind in membrane_coverage.KINDS:
        _kept(store, f"same-capsule-{kind}", lambda k=kind: of_same_capsule(k))
    for noise in range(noises):
        for number in np.unique(pool["batch"]).astype(int).tolist():
            for kind in membrane_coverage.KINDS:
                _kept(store, f"expected-{kind}-{number:02d}", lambda n=number, k=kind: expected(pool, n, k))
                name = f"found-{kind}-{number:02d}-{noise}"
                _kept(store, name, lambda n=number, k=kind, other=noise: found(pool, n, k, other))


def _kept(store: Store, name: str, compute: Callable[[], dict[str, Any]]) -> None:
    if not store.holds(name):
        store.save(name, compute())
        print(name, flush=True)


def compared(folder: Path) -> dict[str, dict[str, Any]]:
    """Return of each kind how many answers there are, and of each quantity what is expected and found, rms.

    And how far the answers to single batches lie from what was expected of each: the smallest and the largest ratio.
    """
    store, kinds = membrane_batches.store_of(folder), {}
    for kind in membrane_coverage.KINDS:
        pairs, refused = [], 0
        for name in sorted(store.names(f"found-{kind}-*")):
            answer, wanted = store.load(name), store.load(name.replace("found", "expected", 1)[: -len("-0")])
            usable = answer is not None and wanted is not None and answer["status"] in USABLE
            refused += not usable
            if usable:
                pairs.append([[one[key] for key in QUANTITIES] for one in (wanted, answer)])
        if pairs:
            both = np.array(pairs)
            ratios = both[:, 1] / both[:, 0]
            rms = np.sqrt(np.mean(both**2, axis=0))
            columns = zip(rms[0], rms[1], rms[1] / rms[0], ratios.min(axis=0), ratios.max(axis=0), strict=True)
            rounded = [[float(f"{value:.3g}") for value in column] for column in columns]
            kinds[kind] = {
                "answers": len(pairs),
                "not to be used": refused,
                **dict(zip(QUANTITIES, rounded, strict=True)),
            }
    return kinds


def table(kinds: dict[str, dict[str, Any]]) -> str:
    """Return what is expected and found as a Markdown table."""
    head = [
        "measured",
        "answers",
        "not to be used",
        "standard deviation of",
        "expected",
        "found",
        "found over expected",
    ]
    lines = [f"| {' | '.join(head)} |\n", "|---" * len(head) + "|\n"]
    for kind, row in kinds.items():
        for number, (key, name) in enumerate(QUANTITIES.items()):
            wanted, answered, whole, low, high = row[key]
            first = [kind, str(row["answers"]), str(row["not to be used"])] if not number else ["", "", ""]
            ratio = f"{whole:.2f} ({low:.2f} to {high:.2f})"
            lines.append(f"| {' | '.join([*first, name, f'{wanted:.2g}', f'{answered:.2g}', ratio])} |\n")
    return "".join(lines)


def same_capsule_table(stored: dict[str, Any]) -> str:
    """Return what one capsule tells at its best flow rates as a Markdown table."""
    head = ["measured", "flow rates", "ln G_s", "were the membrane known", *list(QUANTITIES.values())[1:]]
    lines = [f"| {' | '.join(head)} |\n", "|---" * len(head) + "|\n"]
    for kind, sets in stored.items():
        for number, sds in sets.items():
            shown = [sds["surface_shear_modulus"], sds["known"], *(sds[key] for key in list(QUANTITIES)[1:])]
            lines.append(f"| {' | '.join([kind, number, *(f'{value:.2g}' for value in shown)])} |\n")
    return "".join(lines)


def map_table(stored: dict[str, Any]) -> str:
    """Return quantiles over the map of one capsule as a Markdown table."""
    levels = "least", "lower", "median", "upper", "most"
    head = ["measured", "membrane", "least", "quarter", "median", "three quarters", "most"]
    lines = [f"| {' | '.join(head)} |\n", "|---" * len(head) + "|\n"]
    for name, values in stored["quantiles"].items():
        known, kind = name.split("_")
        lines.append(f"| {' | '.join([kind, known, *(f'{values[level]:.2g}' for level in levels)])} |\n")
    return "".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where finished batches are kept")
    parser.add_argument("--noises", type=int, default=3)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    run(options.folder, options.noises)
    kinds = compared(options.folder)
    print(table(kinds))
    if options.write:
        store = membrane_batches.store_of(options.folder)
        same = {kind: store.load(f"same-capsule-{kind}") for kind in membrane_coverage.KINDS}
        STORED.write_text(json.dumps(kinds, indent=1) + "\n")
        SAME.write_text(json.dumps(same, indent=1) + "\n")
        for marks, shown in (
            (MARKS, table(kinds)),
            (SAME_MARKS, same_capsule_table(same)),
            (MAP_MARKS, map_table(json.loads(MAP.read_text()))),
        ):
            renew(PAGE, *marks, shown)


if __name__ == "__main__":
    main()
