"""Speed of the inference: both engines, and whole commands.

Run ``python benchmarks/inference.py [DATABASE]``. Every figure is a median;
commands are whole processes, started warm (files read and kernels compiled
once before). Wall time is printed next to processor time: on a
busy machine only the latter is meaningful.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from capsbayes.experiment import Experiment
from capsbayes.infer import Quadrature, identify
from capsbayes.infer.posterior import REPORTED
from capsbayes.measurement import Measurement
from capsbayes.surrogate import Surrogate

CAPSULE = Path(__file__).parents[1] / "examples" / "ovalbumin" / "capsule.toml"
CAPSULES = 200
RUNS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "database", nargs="?", default="square-neo-hookean", help="name of a shipped database, or .nc file"
    )
    database = parser.parse_args().database
    table = Table("what", "seconds", "processor", "wanted", "remark")
    with threadpool_limits(limits=1):
        for row in (*engines(database), *commands(database)):
            table.add_row(*row)
    Console().print(table)


def engines(database: str) -> list[tuple[str, str, str, str]]:
    """Return the seconds of each engine, inside a running process."""
    measurement = Measurement.read(CAPSULE)
    experiment = Experiment.read(measurement.experiment_file or CAPSULE)
    model = Surrogate.open(database)
    capsules = simulated(measurement, model)
    engine = Quadrature(model, experiment)
    grid = [clocked(lambda capsule=capsule: engine(capsule)) for capsule in capsules]
    intervals = [
        clocked(lambda capsule=capsule: list(map(engine(capsule).marginal, REPORTED[:2]))) for capsule in capsules
    ]
    identify(measurement, model, experiment, seed=0)
    posteriors = []
    sampling = [
        clocked(lambda seed=seed: posteriors.append(identify(measurement, model, experiment, seed=seed)))
        for seed in range(1, RUNS + 1)
    ]
    passed = sum(all(gate.passed for gate in posterior.gates) for posterior in posteriors)
    agreed = sum(posterior.agreement is not None and posterior.agreement.passed for posterior in posteriors)
    return [
        ("quadrature, one capsule", *medians(grid), "0.002", f"{len(capsules)} capsules all over the domain"),
        ("the same with intervals of G_s and a", *medians(intervals), "", ""),
        (
            "emcee and its checks, one capsule",
            *medians(sampling),
            "3",
            f"{passed} of {RUNS} runs passed all gates, {agreed} agreed with quadrature",
        ),
    ]


def commands(database: str) -> list[tuple[str, str, str, str]]:
    """Return the seconds of whole processes."""
    script = Path(sys.executable).with_name("capsbayes")
    with tempfile.TemporaryDirectory() as folder:
        asked = {
            "import capsbayes": ([sys.executable, "-c", "import capsbayes"], "0.3"),
            "capsbayes --help": ([str(script), "--help"], "0.6"),
            "capsbayes identify": (
                [str(script), "identify", str(CAPSULE), "--database", database, "--out", folder], "5"
            ),
        }  # fmt: skip
        return [
            (name, *medians([clocked(lambda c=command: run(c)) for _ in range(RUNS + 1)][1:]), wanted, "")
            for name, (command, wanted) in asked.items()
        ]


def run(command: list[str]) -> None:
    subprocess.run(command, check=True, capture_output=True)


def clocked(work: Callable[[], object]) -> tuple[float, float]:
    """Return the wall time and the processor time of a call, in this process or in those it starts."""
    start, processor = time.perf_counter(), time.process_time() + sum(os.times()[2:4])
    work()
    return time.perf_counter() - start, time.process_time() + sum(os.times()[2:4]) - processor


def medians(seconds: list[tuple[float, float]]) -> list[str]:
    return [f"{statistics.median(column):.4g}" for column in zip(*seconds, strict=True)]


def simulated(like: Measurement, model: Surrogate) -> list[Measurement]:
    """Return noisy measurements of capsules all over the domain of the model, with the errors of a given one."""
    from dataclasses import replace

    rng, made = np.random.default_rng(1), []
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    while len(made) < CAPSULES:
        ca, size = np.exp(rng.uniform(np.log(ca_low), np.log(ca_high))), rng.uniform(size_low, size_high)
        prediction = model({"capillary_number": np.array([ca]), "size_ratio": np.array([size])})
        extent = prediction.axial_extent[0] + like.axial_extent_error * rng.standard_normal()
        length = prediction.axial_length[0] + (like.axial_length_error or 0.0) * rng.standard_normal()
        if length < extent:  # neither outside the domain (NaN) nor an impossible shape
            made.append(replace(like, axial_extent=extent, axial_length=length))
    return made


if __name__ == "__main__":
    main()
