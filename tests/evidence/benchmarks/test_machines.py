"""The same answer under every BLAS kernel and number of threads."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evidence.benchmarks import machines

ROOT = Path(__file__).parents[3]

ROWS = """
import json, sys, tempfile
from pathlib import Path
import capsbayes as cb
folder = Path(sys.argv[1])
model, experiment = cb.Surrogate.open("square-neo-hookean"), cb.Experiment.read(folder / "experiment.toml")
with tempfile.TemporaryDirectory() as place:
    out = Path(place) / "run.nc"
    rows = cb.identify_folder(folder / "capsules.csv", model, experiment, out=out, seed=1, check=0.0, workers=1).dataset
print(json.dumps({name: rows[name].values.tolist() for name in sorted(rows)}, default=str))
"""


def test_the_table_of_the_page_is_within_the_limit():
    rows = [line.strip("| ").split(" | ") for line in machines.PAGE.read_text().splitlines() if line.startswith("| ")]
    table = {name: (int(numbers), float(size)) for name, numbers, size, *_ in rows[2:]}
    assert machines.QUICK.keys() <= table.keys() <= machines.COMMANDS.keys()
    assert all(numbers > 10 and size <= machines.LARGEST for numbers, size in table.values())


def test_digits_of_a_batch_are_those_of_any_kernel_and_number_of_threads():
    environments = machines.Environment("Haswell"), machines.Environment("Sandybridge", 2)
    printed = [
        subprocess.run(
            [sys.executable, "-c", ROWS, str(ROOT / "examples" / "batch")],
            check=True,
            capture_output=True,
            text=True,
            env=os.environ | environment.variables,
        ).stdout
        for environment in environments
    ]
    one, other = (json.loads(text.splitlines()[-1]) for text in printed)
    assert len(one) > 50
    assert one.keys() == other.keys()
    for name, values in one.items():
        if np.asarray(values).dtype.kind == "f":
            np.testing.assert_allclose(other[name], values, rtol=1e-9, atol=1e-12, err_msg=name)
        else:
            assert other[name] == values, name


@pytest.mark.slow
def test_commands_report_the_same_numbers_under_two_kernels():
    found = machines.compared(machines.QUICK, (machines.Environment("Haswell"), machines.Environment("Sandybridge", 2)))
    assert all(row.size <= machines.LARGEST for row in found.values()), found


def test_a_difference_is_relative_to_the_number_or_to_the_width_of_its_interval():
    assert machines._difference("mean", (1.0, 4.0), (3.0, 4.0)) == 0.5
    assert machines._difference("p_value", (0.0, 0.0), (0.1, 0.0)) == pytest.approx(0.1)
    assert machines._difference("status", "DONE", "FAR") == float("inf")
    assert machines._difference("sentence", "G_s = 2.0 mN/m", "G_s = 4.0 mN/m") == 0.5
