"""Speed that a person feels: our commands and engines, each beside what else is in use, in one table.

Run ``python -m evidence.benchmarks.speed [NAME ...]``; without names every row that is not in
``evidence/results/speed.json`` yet is measured, ``--again`` measures all. ``--write`` renews the table in
``docs/evidence.md``. Each row is measured in a process of its own, one after the other, with one thread of BLAS:
compiled and read once, then the median of five times (of commands: after one that is not counted; silhouettes of films:
of two; batches and the diagnosis: one time). Wall time depends on what else the machine does; processor time of all
processes together does so less. ``dclab`` is `pip install dclab`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import emcee
import numpy as np
import pandas as pd
import psutil
from scipy.interpolate import RBFInterpolator

from capsbayes import Database, Experiment, Measurement, Surrogate, identify, identify_folder, identify_membrane
from capsbayes.arrays import Floats
from capsbayes.image.film import measure_film
from capsbayes.infer import Posterior, Prior, Quadrature
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.prior import Inputs
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase
from capsbayes.physics.scattered import membrane_continuation, nearest_numbers, state_of
from capsbayes.surrogate import MembraneSurrogate
from capsbayes.surrogate.diffuse import PlaneScaling
from evidence.benchmarks import membrane_coverage as coverage
from evidence.benchmarks.stored import ROOT, Stored, with_write
from evidence.markdown import table

sys.path.insert(0, str(ROOT / "tests" / "support"))
import drawn_populations
from density_of_all_inputs import DensityOfAllInputs

CAPSULE = ROOT / "examples" / "ovalbumin" / "capsule.toml"
BATCH = ROOT / "examples" / "shared_membrane"
MEMBRANE = ("membrane", BATCH / "outlines.nc", "--experiment", BATCH / "experiment.toml")
ALONE = (*MEMBRANE, "--no-laws")
FLOW = ("sensitivity", "flow", "--shear-modulus", "50 +/- 10 mN/m", "--radius", "24 um", "--like", CAPSULE)
FILM = ROOT / "examples" / "pictures" / "film.avi"
SESSION = ROOT / "examples" / "drifting_modulus" / "capsules"
SCRIPT = Path(sys.executable).with_name("capsbayes")
RUNS, FEW, MANY = 5, 2, 200
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
Row = dict[str, Any]


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("names", nargs="*", help="rows to be measured again")
    parser.add_argument("--again", action="store_true", help="measure every row again")
    parser.add_argument("--one", choices=ROWS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(ROWS[given.one].measured()))
        return
    stored = STORED.read()
    for name in ROWS:
        if given.again or name in given.names or name not in stored:
            command = [sys.executable, "-m", "evidence.benchmarks.speed", "--one", name]
            how = {"stdout": subprocess.PIPE, "text": True, "env": os.environ | ONE_THREAD, "cwd": ROOT}
            done = subprocess.run(command, check=True, **how)
            stored[name] = json.loads(done.stdout.splitlines()[-1])
            STORED.write({name: stored[name] for name in ROWS if name in stored})
    STORED.show(stored, write=given.write)


def tables(stored: dict[str, Row]) -> dict[str, str]:
    """Return the table of the stored times."""
    rows = []
    for name, row in stored.items():
        wanted = shown(ROWS[name].wanted) if ROWS[name].wanted else ""
        rows.append((ROWS[name].words, shown(row["wall"]), shown(row["processor"]), wanted, row.get("remark", "")))
    return {"speed": table(("what", "wall time", "processor", "wanted", ""), rows)}


STORED = Stored("speed.json", "docs/evidence.md", tables)


def shown(seconds: float) -> str:
    """Return a time in words.

    Examples
    --------
    >>> shown(0.00123), shown(0.5), shown(12.3), shown(335.0), shown(1.2e-6)
    ('1.2 ms', '0.50 s', '12 s', '340 s', '1.2 µs')
    """
    factor, unit = next(
        (f, u) for least, f, u in ((0.1, 1.0, "s"), (1e-4, 1e3, "ms"), (0.0, 1e6, "µs")) if seconds >= least
    )
    number = factor * seconds
    return f"{number:.2f} {unit}" if number < 1.0 else f"{float(f'{number:.2g}'):g} {unit}"


def clocked(work: Callable[[], object], runs: int = RUNS) -> Row:
    """Return the medians of wall and processor time, after a run that compiles and reads if there are several."""
    taken = []
    for _ in range(runs + (runs > 1)):
        start, processor = time.perf_counter(), spent()
        work()
        taken.append((time.perf_counter() - start, spent() - processor))
    wall, processor = zip(*(taken[1:] if runs > 1 else taken), strict=True)
    return {"wall": statistics.median(wall), "processor": statistics.median(processor)}


def through_gates(make: Callable[[int], Posterior], runs: int = RUNS, of: str = "runs") -> Row:
    """Return what posteriors take, made by their number, and how many pass all gates."""
    posteriors: list[Posterior] = []
    found = clocked(lambda: posteriors.append(make(len(posteriors))), runs)
    passed = sum(all(gate.passed for gate in posterior.gates) for posterior in posteriors[1:])
    return found | {"remark": f"{passed} of {runs} {of} passed all gates"}


def spent() -> float:
    """Seconds of processor time of this process and of those that it started and that have ended."""
    return time.process_time() + sum(os.times()[2:4])


def command(*words: str | Path, runs: int = RUNS) -> Row:
    """Time a command as a person runs it; Python keeps what it compiled, as it does unless told otherwise."""
    known = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return clocked(lambda: subprocess.run(list(map(str, words)), check=True, capture_output=True, env=known), runs)


def writing(*words: str | Path, runs: int = RUNS) -> Callable[[], Row]:
    """Return what times a command of the package that writes its result."""

    def run() -> Row:
        with tempfile.TemporaryDirectory() as folder:
            return command(SCRIPT, *words, "--out", Path(folder) / "out", runs=runs)

    return run


def answered(membrane: str) -> Callable[[], Row]:
    """Return what times the answer of the bench to its example, in a process that has answered before."""

    def run() -> Row:
        from capsbayes.app.identifying import identified
        from capsbayes.app.stated import EXAMPLE, EXAMPLE_PICTURE, EXPERIMENT, Stated

        stated = Stated(picture=EXAMPLE_PICTURE.name, velocity=EXAMPLE["velocity"], membrane=membrane)

        def work() -> None:
            with tempfile.TemporaryDirectory() as folder:
                shutil.copy(EXAMPLE_PICTURE, folder)
                Experiment("square", EXAMPLE["half_width"], EXAMPLE["viscosity"]).write(Path(folder) / EXPERIMENT)
                identified(folder, stated)

        return clocked(work)

    return run


def many_shared(number: int) -> Callable[[], Row]:
    """Return what times a batch whose outlines are drawn from the model itself: only its time counts."""

    def run() -> Row:
        model, rng = coverage.model("unknown"), np.random.default_rng(1)
        ca, size = 0.07 * np.exp(0.15 * rng.standard_normal(number)), rng.uniform(0.82, 0.98, number)
        values = np.column_stack([ca, size, np.broadcast_to([0.03, 2.0, 0.3, 2e-4], (number, 4))])
        seen = model(dict(zip(FREE_PARAMETERS, values.T, strict=True)), outline=True)
        numbers = np.column_stack([seen.axial_extent, seen.axial_length, seen.velocity_ratio])
        drawn = zip(values, numbers, seen.outline, strict=True)
        batch = [coverage.measured("outline", *capsule, rng)[0] for capsule in drawn]
        answers: list[Any] = []
        found = clocked(lambda: answers.append(identify_membrane(batch, coverage.experiment(), seed=1, laws=False)), 1)
        return found | {"remark": f"without the odds of laws; {answers[0].status.name}"}

    return run


def simulated_from_the_nearest(refinement: int) -> Callable[[], Row]:
    """Return what times five states of the square database, each simulated from the one next to it."""

    def run() -> Row:
        database, continuation = MembraneDatabase.open("square"), membrane_continuation("square", refinement)
        places = continuation.places(database["values"])
        some = np.linspace(0, len(places) - 1, 7, dtype=int)[1:-1].tolist()
        next_to = [nearest_numbers(database, continuation, places[number])[1] for number in some]
        starts = [state_of(database, continuation, number) for number in next_to]
        pairs = list(zip(starts, places[some], strict=True))
        ends: list[Any] = []
        found = clocked(lambda: ends.extend(continuation.reached(*pair, derivatives=False) for pair in pairs), FEW)
        times = {name: seconds / len(pairs) for name, seconds in found.items()}
        return times | {"remark": f"mean of {len(pairs)}; {len(pairs) - ends[: len(pairs)].count(None)} reached"}

    return run


def opened() -> tuple[Measurement, Experiment, Surrogate]:
    """Return the capsule of the example, its experiment and the model."""
    measurement = Measurement.read(CAPSULE)
    return measurement, Experiment.read(measurement.experiment_file or CAPSULE), Surrogate.open("square-neo-hookean")


def simulated(like: Measurement, model: Surrogate) -> list[Measurement]:
    """Return noisy measurements of capsules all over the domain of the model, with the errors of a given one."""
    rng, made = np.random.default_rng(1), []
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    while len(made) < MANY:
        ca, size = np.exp(rng.uniform(np.log(ca_low), np.log(ca_high))), rng.uniform(size_low, size_high)
        prediction = model({"capillary_number": np.array([ca]), "size_ratio": np.array([size])})
        extent = prediction.axial_extent[0] + like.axial_extent_error * rng.standard_normal()
        length = prediction.axial_length[0] + (like.axial_length_error or 0.0) * rng.standard_normal()
        if length < extent:  # neither outside the domain (NaN) nor an impossible shape
            made.append(replace(like, axial_extent=extent, axial_length=length))
    return made


def on_grid() -> Row:
    measurement, experiment, model = opened()
    capsules, engine = simulated(measurement, model), Quadrature(model, experiment)
    found = clocked(lambda: [engine(capsule) for capsule in capsules])
    return {name: seconds / len(capsules) for name, seconds in found.items()} | {
        "remark": f"mean of {len(capsules)} capsules all over the domain"
    }


def sampled() -> Row:
    measurement, experiment, model = opened()
    found = through_gates(lambda number: identify(measurement, model, experiment, seed=number))
    return found | {"remark": f"{found['remark']}; checked on a grid"}


def membrane_unknown(kind: str) -> Callable[[], Row]:
    """Return what times the identification of simulated capsules by lengths or outline, with the membrane unknown."""

    def run() -> Row:
        model, capsules = coverage.model("unknown"), list(coverage.capsules().values())

        def identified(number: int) -> Posterior:
            seen = coverage.measured(kind, *capsules[number], np.random.default_rng(number))[0]
            return identify(seen, model, coverage.experiment(), seed=1)

        return through_gates(identified, of="capsules")

    return run


def seen_in_film(database: str) -> Callable[[], Row]:
    """Return what times the identification of a capsule by the silhouette that the frames of a film show together."""

    def run() -> Row:
        experiment = Experiment.read(FILM.with_name("experiment.toml"))
        (capsule,) = measure_film(FILM, experiment, frame_rate="400 Hz").capsules
        model = Surrogate.open(database, view="silhouette")
        return through_gates(lambda number: identify(capsule.measurement, model, experiment, seed=number), FEW)

    return run


def plainly_sampled() -> Row:
    """Sample all inputs by emcee with its own default moves until the chain has 50 autocorrelation times."""
    measurement, experiment, model = opened()
    inputs_of = Inputs.of(measurement, experiment)
    density = DensityOfAllInputs(model, PosteriorDensity.of(measurement, inputs_of, Prior()))
    inputs = [getattr(density.density.inputs, name) for name in density.sampled]
    center = np.array([np.log(0.08), 0.96, *(known.value for known in inputs)])
    widths = np.array([0.05, 0.005, *(0.5 * known.error for known in inputs)])
    steps: list[int] = []

    def run() -> None:
        rng = np.random.default_rng(len(steps))
        sampler = emcee.EnsembleSampler(64, len(center), density, vectorize=True)
        state, done, time_ = center + widths * rng.standard_normal((64, len(center))), 0, np.inf
        while done < 50 * time_:
            state = sampler.run_mcmc(state, 500)
            done, time_ = done + 500, float(np.max(sampler.get_autocorr_time(tol=0)))
        steps.append(done)

    return clocked(run) | {"remark": f"64 walkers, {int(statistics.median(steps))} steps: 50 autocorrelation times"}


# A point of a batch, by the surrogate and by general interpolators. All learn (L_z, L_a, v_o/U) from the same
# parachutes in the same coordinates: no smooth method represents the jump to the convex branch, which the surrogate
# treats apart.

Predict = Callable[[Floats], Floats]
QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


def held_out(cases: Database, rows: Floats) -> tuple[Database, Database]:
    """Return chosen cases to learn from, and every fifth of those between others of its column of a/l."""
    members = Database(cases.dataset.isel(case=rows))
    ca, size = members["capillary_number"], np.round(members["size_ratio"], 6)
    inside = (size > size.min()) & (size < size.max())
    for column in np.unique(size):  # whose ends bound the region of the branch
        ends = ca[size == column].min(), ca[size == column].max()
        inside &= (size != column) | ((ca > ends[0]) & (ca < ends[1]))
    chosen = np.flatnonzero(inside)[::5]
    rest = np.setdiff1d(np.arange(len(ca)), chosen)
    return Database(members.dataset.isel(case=rest)), Database(members.dataset.isel(case=chosen))


def of_surrogate(known: Database, scaling: PlaneScaling) -> Predict:
    """Return the surrogate as users call it, with table, mask and covariance."""
    learnt = Surrogate(known)

    def predict(points: Floats) -> Floats:
        ca, size = scaling.from_plane(points).T
        return learnt({"capillary_number": ca, "size_ratio": size}).values

    return predict


def of_thin_plates(known: Database, scaling: PlaneScaling) -> Predict:
    return RBFInterpolator(nodes_of(known, scaling), values_of(known), kernel="thin_plate_spline")


def of_gaussian_process(known: Database, scaling: PlaneScaling) -> Predict:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    nodes, values = nodes_of(known, scaling), values_of(known)
    mean, spread = values.mean(axis=0), values.std(axis=0)
    kernel = ConstantKernel(10.0, (1e-2, 1e6)) * Matern([10.0, 10.0], (1.0, 1e4), nu=2.5)
    process = GaussianProcessRegressor(kernel, alpha=1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the length scales of smooth data run to their bounds
        process.fit(nodes, (values - mean) / spread)
    return lambda points: mean + spread * process.predict(points)


def nodes_of(cases: Database, scaling: PlaneScaling) -> Floats:
    return scaling.to_plane(cases["capillary_number"], cases["size_ratio"])


def values_of(cases: Database) -> Floats:
    return np.stack([cases[name] for name in QUANTITIES], axis=1)


def accuracy(predict: Predict, cases: Database, scaling: PlaneScaling) -> Floats:
    """Return the relative root mean square errors (3,) of the three quantities."""
    error = predict(nodes_of(cases, scaling)) / values_of(cases) - 1.0
    return np.sqrt(np.mean(error**2, axis=0))


def predicted(learn: Callable[[Database, PlaneScaling], Predict]) -> Callable[[], Row]:
    """Return what times the prediction of one point in a batch."""

    def run() -> Row:
        database = Database.open("square-neo-hookean")
        ours, is_ours = Surrogate(database), learn is of_surrogate
        part, count = ours.branches[0], 100_000 if is_ours else 10_000
        known, others = held_out(database.converged, part.branch.rows)
        (ca_low, ca_high), (size_low, size_high) = ours.domain.bounds
        points = np.random.default_rng(0).uniform([ca_low, size_low], [ca_high, size_high], (4 * count, 2))
        ca, size = points[ours.domain.contains(*points.T)][:count].T
        predict, places = learn(known, part.scaling), part.scaling.to_plane(ca, size)
        rms = accuracy(predict, others, part.scaling)
        theta = {"capillary_number": ca, "size_ratio": size}
        found = clocked(lambda: ours(theta) if is_ours else predict(places))
        return {name: seconds / count for name, seconds in found.items()} | {
            "remark": f"rms error of L_a at {len(others)} held-out shapes: {rms[1]:.1e}"
        }

    return run


def scattered(outline: bool) -> Callable[[], Row]:
    """Return what times the prediction of one point with its covariance, all six parameters unknown."""

    def run() -> Row:
        model, count = MembraneSurrogate.open("square"), 5_000 if outline else 100_000
        values = model.membrane_database["values"]
        chosen = values[np.random.default_rng(1).integers(0, len(values), count)]
        theta = dict(zip(FREE_PARAMETERS, chosen.T, strict=True))
        found = clocked(lambda: model(theta, outline=outline))
        return {name: seconds / count for name, seconds in found.items()}

    return run


def batch(number: int) -> Callable[[], Row]:
    """Return what times a table of lengths of drawn capsules, in two processes."""

    def run() -> Row:
        model, experiment = Surrogate.open("square-neo-hookean"), drawn_populations.EXPERIMENT
        lengths, velocities = drawn_populations.measured(model, number, seed=1)
        columns = {
            "axial_extent_over_l": lengths[:, 0],
            "axial_extent_error_over_l": np.sqrt(lengths[:, 2]),
            "axial_length_over_l": np.minimum(lengths[:, 1], lengths[:, 0]),
            "axial_length_error_over_l": np.sqrt(lengths[:, 4]),
            "capsule_velocity_m_per_s": velocities[:, 0],
            "capsule_velocity_error_m_per_s": velocities[:, 1],
        }
        rows = []
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "capsules.csv"
            pd.DataFrame(columns).to_csv(source, index=False)
            del columns, lengths, velocities
            how = {"out": Path(folder) / "r.nc", "seed": 1, "check": 0.0, "workers": 2}
            with PeakMemory() as memory:
                found = clocked(lambda: rows.append(identify_folder(source, model, experiment, **how)), runs=1)
        done = float(rows[0].usable.mean())
        return found | {"remark": f"two processes, {memory.peak / 2**30:.1f} GiB; {done:.1%} of the rows done"}

    return run


class PeakMemory:
    """Largest resident memory of this process and its children together, seen every tenth of a second.

    What getrusage tells of a child begins with the memory of the process that started it.
    """

    def __init__(self) -> None:
        self.peak = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> PeakMemory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        this = psutil.Process()
        while not self._ended.wait(0.1):
            total = 0
            for process in (this, *this.children(recursive=True)):
                with contextlib.suppress(psutil.NoSuchProcess):
                    total += process.memory_info().rss
            self.peak = max(self.peak, total)


def peer() -> Row:
    import dclab
    from dclab.features.emodulus import get_emodulus

    rng, count = np.random.default_rng(1), 100_000
    area, deformation = rng.uniform(40.0, 120.0, count), rng.uniform(0.01, 0.1, count)
    known: dict[str, Any] = {"medium": "0.49% MC-PBS", "channel_width": 20.0, "flow_rate": 0.16, "px_um": 0.34}
    how = known | {"temperature": 23.0, "visc_model": "herold-2017", "lut_data": "LE-2D-FEM-19"}
    found = clocked(lambda: get_emodulus(area_um=area, deform=deformation, **how))
    return found | {"remark": f"dclab {dclab.__version__}, for cells, without uncertainty"}


class Timed(NamedTuple):
    """A row: what is timed, in how many seconds it is wanted (none of others), and the function that times it."""

    words: str
    wanted: float | None
    measured: Callable[[], Row]


ROWS = {
    "import": Timed("`import capsbayes`", 0.3, lambda: command(sys.executable, "-c", "import capsbayes")),
    "identify": Timed("`capsbayes identify`, the whole command", 4.0, writing("identify", CAPSULE)),
    "bench": Timed("the answer of the bench to its example", 4.0, answered("")),
    "bench, unknown": Timed("the same, the membrane unknown", 20.0, answered("unknown")),
    "flow": Timed("`capsbayes sensitivity flow`, with its figure", 30.0, writing(*FLOW)),
    "quadrature": Timed("one capsule on a grid", 1e-3, on_grid),
    "emcee": Timed("one capsule by emcee with its gates", 0.8, sampled),
    "film": Timed("one capsule by its silhouette in a film", 2.0, seen_in_film("square-neo-hookean")),
    "film, inflated": Timed("the same with its pre-inflation unknown", 10.0, seen_in_film("square-pre-inflation")),
    "unknown, lengths": Timed("one capsule by lengths, its membrane unknown", 2.0, membrane_unknown("lengths")),
    "unknown, outline": Timed("one capsule by its outline, its membrane unknown", 10.0, membrane_unknown("outline")),
    "plain emcee": Timed("the same posterior by plain emcee, all five unknowns sampled", None, plainly_sampled),
    "surrogate": Timed("the model, a point of a batch", None, predicted(of_surrogate)),
    "scattered": Timed("the model with the membrane unknown, a point of a batch", 5e-6, scattered(outline=False)),
    "scattered, outline": Timed("the same with its outline", None, scattered(outline=True)),
    "radial": Timed("scipy's RBFInterpolator, thin plates, a point", None, predicted(of_thin_plates)),
    "process": Timed("scikit-learn's Gaussian process, Matérn 5/2, a point", None, predicted(of_gaussian_process)),
    "100000": Timed("a batch of 100 000 capsules", 30.0, batch(100_000)),
    "1000000": Timed("a batch of 1 000 000 capsules", 300.0, batch(1_000_000)),
    "dclab": Timed("100 000 point estimates of dclab", None, peer),
    "membrane": Timed("`capsbayes membrane`, 40 capsules with outlines", 300.0, writing(*MEMBRANE, runs=1)),
    "membrane alone": Timed("the same without the odds of laws (`--no-laws`)", None, writing(*ALONE, runs=1)),
    "membrane 1000": Timed("the membrane of 1,000 capsules with outlines", 3600.0, many_shared(1000)),
    "simulated, 8": Timed(
        "a steady shape, simulated from the nearest stored state, refinement 8", 0.5, simulated_from_the_nearest(8)
    ),
    "simulated, 12": Timed("the same at refinement 12", 1.2, simulated_from_the_nearest(12)),
    "diagnose": Timed("`capsbayes diagnose`, 40 capsules with outlines", 45.0, writing("diagnose", SESSION, runs=1)),
}

if __name__ == "__main__":
    main()
