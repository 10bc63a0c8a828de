"""Compare what the commands report under several BLAS kernels and numbers of threads.

Each environment has a process of its own, which runs all `COMMANDS`; ``--quick`` runs the commands of a few seconds
under two kernels. ``--write`` renews the table in ``evidence/results/machine-independence.md``, which says how
differences are measured.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evidence.benchmarks.stored import RESULTS, ROOT, with_write
from evidence.markdown import renew, table

EXAMPLES = ROOT / "examples"
PAGE = RESULTS / "machine-independence.md"
KERNELS = ("Haswell", "Zen", "SkylakeX", "Sandybridge")
LARGEST = 1e-6

_BATCH = ("--experiment", str(EXAMPLES / "batch" / "experiment.toml"), "--json")
_LENGTHS = str(EXAMPLES / "ovalbumin" / "capsule.toml")
_INFLATION = ("--database", "square-pre-inflation")
_QUADRATURE = ("--json", "--engine", "quadrature")
_TABLE, _OUTLINES = str(EXAMPLES / "batch" / "capsules.csv"), str(EXAMPLES / "drifting_modulus" / "capsules")
_OUTLINE = f"{_OUTLINES}/capsule-001.toml"

QUICK = {
    "identify, lengths, quadrature": ("identify", _LENGTHS, *_QUADRATURE),
    "identify, lengths and pre-inflation, quadrature": ("identify", _LENGTHS, *_INFLATION, *_QUADRATURE),
    "identify, outline, quadrature": ("identify", _OUTLINE, *_QUADRATURE),
    "batch of lengths": ("batch", _TABLE, *_BATCH, "--out", "run.nc", "--check", "0", "--workers", "1"),
    "population": ("population", "run.nc", "--json"),
    "population, with a cut in Lambda": (
        *("population", "run.nc", "--json", "--least-stretch", "1.04", "--velocity-error", "0.5 %", "--seed", "2"),
    ),
    "diagnose, lengths": ("diagnose", _TABLE, *_BATCH),
}
COMMANDS = QUICK | {
    "identify, lengths": ("identify", _LENGTHS, "--json"),
    "identify, lengths in metres": ("identify", "metres.toml", "--json"),
    "identify, lengths and pre-inflation": ("identify", _LENGTHS, *_INFLATION, "--json"),
    "identify, outline": ("identify", _OUTLINE, "--json"),
    "batch of lengths, checked": (
        *("batch", _TABLE, *_BATCH, "--out", "checked.nc", "--most-checked", "1", "--workers", "2"),
    ),
    "batch of outlines": ("batch", "outlines", "--json", "--out", "outlines.nc", "--check", "0", "--workers", "1"),
    "diagnose, outlines": ("diagnose", _OUTLINES, "--json", "--candidates", "halo,pre-inflation"),
}

_METRES = """experiment = "experiment.toml"
[measurement]
axial_extent = "53.5 +/- 0.5 um"
axial_length = "45.2 +/- 0.5 um"
capsule_velocity = "6.20 +/- 0.06 mm/s"
"""
_OF_SCALE_ONE = re.compile(
    r"p_value|share|leaning|log_|variance|evidence|Pareto|log_likelihood_ratio|density at an end|agree|sigma$"
)


class Environment(NamedTuple):
    """BLAS kernel, number of threads, and other instructions of the processor that are not used."""

    kernel: str
    threads: int = 1
    old: bool = False

    def __str__(self) -> str:
        """Return the name in the table."""
        return f"{self.kernel}, {self.threads} thread{'s' * (self.threads > 1)}" + ", without AVX-512" * self.old

    @property
    def variables(self) -> dict[str, str]:
        """Variables to set."""
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
        old = {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR", "NUMBA_CPU_NAME": "haswell"}
        old["NUMBA_CPU_FEATURES"] = ""
        known = {"OPENBLAS_CORETYPE": self.kernel, "PYTHONWARNINGS": "ignore"} | dict.fromkeys(names, str(self.threads))
        return known | (old if self.old else {})


ENVIRONMENTS = tuple(Environment(kernel, threads) for threads in (1, 2) for kernel in KERNELS)
ENVIRONMENTS += (Environment("Haswell", old=True),)


class Difference(NamedTuple):
    """Largest difference of a command's numbers from those of the first environment."""

    size: float
    key: str
    environment: str
    numbers: int


def main() -> int:
    """Compare, print the table, and return 1 if a difference is above the limit."""
    parser = with_write(__doc__)
    parser.add_argument("--quick", action="store_true", help="the commands of a few seconds, under two kernels")
    parser.add_argument("--once", type=Path, help="run the commands here and write their numbers into this file")
    parser.add_argument("--keep", type=Path, help="folder for the numbers of each environment, to go on after a stop")
    given = parser.parse_args()
    commands = QUICK if given.quick else COMMANDS
    if given.once:
        given.once.write_text(json.dumps(reported(commands)))
        return 0
    environments = (ENVIRONMENTS[0], Environment("Sandybridge", 2)) if given.quick else ENVIRONMENTS
    if given.keep is not None:
        given.keep.mkdir(parents=True, exist_ok=True)
    differences = compared(commands, environments, given.keep)
    rows = ((n, str(row.numbers), f"{row.size:.1e}", row.key, row.environment) for n, row in differences.items())
    text = table(("command", "numbers", "largest difference", "of", "in"), rows)
    print(text)
    if given.write:
        renew(PAGE, "differences", text)
    return int(any(row.size > LARGEST for row in differences.values()))


def compared(
    commands: Mapping[str, Any], environments: Sequence[Environment], keep: Path | None = None
) -> dict[str, Difference]:
    """Return the largest difference of each command between the first environment and the others."""
    with tempfile.TemporaryDirectory() as folder:
        found = {}
        for environment in environments:
            file = (keep or Path(folder)) / f"{environment}.json"
            if not file.exists():
                quick = ["--quick"] * (commands is QUICK)
                run = [sys.executable, "-m", "evidence.benchmarks.machines", *quick, "--once", str(file)]
                subprocess.run(run, check=True, env=os.environ | environment.variables, cwd=ROOT)
            found[environment] = json.loads(file.read_text())
    first = found[environments[0]]
    return {name: _largest(first[name], {str(one): found[one][name] for one in environments[1:]}) for name in commands}


def reported(commands: Mapping[str, tuple[str, ...]]) -> dict[str, dict[str, Any]]:
    """Run commands, and return what each prints and writes as a flat mapping of numbers and texts."""
    from typer.testing import CliRunner

    from capsbayes.cli import app

    found = {}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        shutil.copy(EXAMPLES / "ovalbumin" / "experiment.toml", "experiment.toml")
        Path("metres.toml").write_text(_METRES)
        Path("outlines").mkdir()
        for file in (
            "experiment.toml",
            *(f"capsule-00{number}{end}" for number in "123" for end in (".toml", ".outline.csv")),
        ):
            shutil.copy(Path(_OUTLINES) / file, "outlines")
        for name, command in commands.items():
            result = CliRunner().invoke(app, command)
            if result.exit_code > 1:
                raise RuntimeError(f"{name}: {result.output}\n{result.exception!r}")
            values = dict(_flat(json.loads(result.stdout[result.stdout.index("{") :]), ""))
            if "--out" in command:
                values |= _rows(Path(command[command.index("--out") + 1]).with_suffix(".csv"))
            found[name] = values
    return found


def _flat(value: Any, key: str, width: float = 0.0) -> Iterator[tuple[str, Any]]:
    """Yield numbers with the width of their interval, and texts, by the path of their keys."""
    if isinstance(value, dict):
        if "lower_95" in value:
            width = value["upper_95"] - value["lower_95"]
        elif isinstance(value.get("error"), float):
            width = 4.0 * value["error"]
        for name, item in value.items():
            yield from _flat(item, f"{key}/{name}" if key else name, width)
    elif isinstance(value, list):
        for place, item in enumerate(value):
            yield from _flat(item, f"{key}/{place}", width)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield key, (value, width)
    else:
        yield key, value


def _rows(path: Path) -> dict[str, Any]:
    """Return the cells of a table by row and column; numbers are those of the NetCDF file, rounded to eight digits."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    found: dict[str, Any] = {}
    for place, row in enumerate(rows):
        for name, cell in row.items():
            try:
                found[f"row {place}/{name}"] = (float(cell), _width(row, name))
            except ValueError:
                found[f"row {place}/{name}"] = cell
    return found


def _width(row: Mapping[str, str], name: str) -> float:
    quantity = re.sub(r"_(mean|sd|median|(lower|upper)_(68|95))( \[.*\])?$", "", name)
    ends = [float(row[other]) for other in row if re.match(rf"{re.escape(quantity)}_(lower|upper)_95", other)]
    return ends[1] - ends[0] if len(ends) == 2 else 0.0


def _largest(first: Mapping[str, Any], others: Mapping[str, Mapping[str, Any]]) -> Difference:
    """Return the largest difference of any number; infinite where a text or a key differs."""
    numbers = sum(isinstance(value, (list, tuple)) for value in first.values())
    worst = Difference(0.0, "", "", numbers)
    for environment, other in others.items():
        for key in first.keys() | other.keys():
            size = _difference(key, first.get(key), other.get(key))
            if size > worst.size:
                worst = Difference(size, key, environment, numbers)
    return worst


def _difference(key: str, first: Any, other: Any) -> float:
    if first == other:
        return 0.0
    if isinstance(first, str) and isinstance(other, str) and _words(first) == _words(other):
        pairs = zip(*(re.findall(_NUMBER, text) for text in (first, other)), strict=True)
        return max(_difference(key, (float(a), 0.0), (float(b), 0.0)) for a, b in pairs)
    if not (isinstance(first, (list, tuple)) and isinstance(other, (list, tuple))):
        return math.inf
    (a, width), (b, _) = first, other
    if math.isnan(a) and math.isnan(b):
        return 0.0
    scale = max(abs(a), abs(b), width, 1.0 if _OF_SCALE_ONE.search(key) else 0.0)
    return abs(a - b) / scale if scale > 0.0 else 0.0


_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def _words(text: str) -> str:
    return _NUMBER.sub("#", text)


if __name__ == "__main__":
    sys.exit(main())
