"""Long commands killed at random moments, and run again, end with the results of an undisturbed run."""

import contextlib
import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from processes import capsbayes, members, wait_until

from evidence.exam.sessions import pool_name

pytestmark = pytest.mark.slow

LENGTHS = """name,axial_extent_over_l,axial_extent_error_over_l,axial_length_over_l,axial_length_error_over_l,\
capsule_velocity_mm_per_s,capsule_velocity_error_mm_per_s
"""
EXPERIMENT = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
CASES = "capillary_number,size_ratio\n" + "".join(f"{ca},{size}\n" for size in (0.8, 0.85) for ca in (0.01, 0.04, 0.06))


def finished(*command, where, **how):
    """Run a command to its end; return how long it takes."""
    begin = time.monotonic()
    with capsbayes(*command, cwd=where, **how) as process:
        _, said = process.communicate()
    assert process.returncode in (0, 1), said
    return time.monotonic() - begin


def killed_again_and_again(*command, where, longest, rng, kills=3, **how):
    """Run a command some times, each time for a random while until it is killed without notice, and then to its end."""
    for _ in range(kills):
        with capsbayes(*command, cwd=where, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **how) as process:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(rng.uniform(0.1, 1.0) * longest)
            process.kill()
        wait_until(lambda group=process.pid: not members(group))
    finished(*command, where=where, **how)


def content(file, without=("created", "sha256")):
    """Return the variables and the attributes of a NetCDF file with all its groups."""
    found = {}

    def taken(group, path):
        found.update({f"{path}/{name}": np.array(variable[...]) for name, variable in group.variables.items()})
        found.update({f"{path}@{name}": value for name, value in group.attrs.items() if name not in without})
        for name, inner in group.groups.items():
            taken(inner, f"{path}/{name}")

    with h5netcdf.File(file, "r") as opened:
        taken(opened, "")
    return found


def assert_same(one, other, scatter=0.0):
    """Compare two files to the last bit; what is simulated in two processes scatters by rounding."""
    first, second = content(one), content(other)
    assert first.keys() == second.keys()
    for name, value in first.items():
        if scatter and name == "@mesh_error":  # numbers as JSON
            one_error, other_error = (
                re.findall(r"-?\d+\.\d+(?:e-\d+)?", str(found[name])) for found in (first, second)
            )
            np.testing.assert_allclose(np.float64(one_error), np.float64(other_error), rtol=scatter, atol=scatter)
        elif scatter and isinstance(value, np.ndarray) and value.dtype.kind == "f":
            np.testing.assert_allclose(value, second[name], rtol=scatter, atol=scatter, err_msg=name)
        else:
            np.testing.assert_array_equal(value, second[name], err_msg=name)


def write_table(folder, count):
    rng = np.random.default_rng(7)
    extent, speed = rng.uniform(2.0, 2.2, count), rng.uniform(5.5, 7.0, count)
    rows = (
        f"c{k},{z:.4f},0.01,{z - 0.3:.4f},0.02,{v:.4f},0.06\n"
        for k, (z, v) in enumerate(zip(extent, speed, strict=True))
    )
    (folder / "capsules.csv").write_text(LENGTHS + "".join(rows))
    (folder / "experiment.toml").write_text(EXPERIMENT)
    return "batch", "capsules.csv", "--experiment", "experiment.toml"


@pytest.mark.parametrize(
    ("count", "options"),
    [
        (3000, ("--check", "0.001")),
        (12, ("--check", "0", "--database", "square-pre-inflation")),
        (6, ("--check", "0", "--chains")),
    ],
)
def test_a_batch(tmp_path, count, options):
    command = (*write_table(tmp_path, count), "--workers", "2", *options)
    chains = options[-1] == "--chains"
    rng = np.random.default_rng(1)
    of_whole, of_killed = (("--out", f"{name}.nc") for name in ("whole", "killed"))
    if chains:
        of_whole, of_killed = ("whole-chains", *of_whole), ("killed-chains", *of_killed)
    longest = finished(*command, *of_whole, where=tmp_path)
    killed_again_and_again(*command, *of_killed, where=tmp_path, longest=longest, rng=rng)
    assert_same(tmp_path / "whole.nc", tmp_path / "killed.nc")
    assert not (tmp_path / "killed.nc.parts").exists()
    if chains:
        files = sorted((tmp_path / "whole-chains").glob("*.nc"))
        assert len(files) == count
        for file in files:
            assert_same(file, tmp_path / "killed-chains" / file.name)


def test_an_identification(tmp_path):
    write_table(tmp_path, 1)
    (tmp_path / "capsule.toml").write_text(
        'experiment = "experiment.toml"\n[measurement]\naxial_extent = "2.14 +/- 0.01"\n'
        'axial_length = "1.81 +/- 0.02"\ncapsule_velocity = "6.20 +/- 0.06 mm/s"\n'
    )
    command = ("identify", "capsule.toml", "--out")
    longest = finished(*command, "whole", where=tmp_path)
    killed_again_and_again(*command, "killed", where=tmp_path, longest=longest, rng=np.random.default_rng(2))
    assert_same(tmp_path / "whole" / "posterior.nc", tmp_path / "killed" / "posterior.nc")
    assert {file.name for file in (tmp_path / "killed").iterdir()} == {
        file.name for file in (tmp_path / "whole").iterdir()
    }


@pytest.mark.parametrize("compare", [(), ("--compare", "6")])
def test_a_build(tmp_path, compare):
    (tmp_path / "cases.csv").write_text(CASES)
    command = ("build", "--cases", "cases.csv", "--refinement", "5", "--workers", "2", *compare, "--out")
    longest = finished(*command, "whole.nc", where=tmp_path)
    killed_again_and_again(*command, "killed.nc", where=tmp_path, longest=longest, rng=np.random.default_rng(3))
    assert_same(tmp_path / "whole.nc", tmp_path / "killed.nc", scatter=1e-6)


def test_a_rebuild(tmp_path):
    """Of a shipped database whose recipe is made small; the parts of both runs are those of the same recipe."""
    small = (
        "from dataclasses import replace; from evidence import rebuild as r; "
        "s = r.Simulator(refinement=4); c = [(ca, size) for size in (0.8, 0.9) for ca in (0.02, 0.05, 0.07)]; "
        "r.RECIPES['square-rest-aspect'] = r.Recipe(s, c, 'rest_aspect', (0.95, 1.0, 1.05)); "
        "r.main()"
    )
    command = ("square-rest-aspect", "--workers", "2", "--out")
    longest = finished(*command, "whole.nc", where=tmp_path, program=small)
    rng = np.random.default_rng(4)
    killed_again_and_again(*command, "killed.nc", where=tmp_path, longest=longest, rng=rng, program=small)
    assert_same(tmp_path / "whole.nc", tmp_path / "killed.nc", scatter=1e-6)


def test_an_exam(tmp_path):
    """The processor time of an answer differs; all else is the same, whatever was done twice."""
    (tmp_path / "pools").mkdir()
    pool = f"{pool_name('none', 0.0)}.nc"
    shutil.copy(Path(__file__).parents[2] / "data" / "pools" / pool, tmp_path / "pools" / pool)
    program = "from evidence.exam.__main__ import main; main()"
    command = ("--pools", "pools", "--only", "swelling 0.01", "--sessions", "2", "--workers", "2", "--out")
    longest = finished(*command, "whole", where=tmp_path, program=program)
    rng = np.random.default_rng(5)
    killed_again_and_again(*command, "killed", where=tmp_path, longest=longest, rng=rng, program=program)

    def answers(folder):
        records = [json.loads(line) for file in folder.rglob("*.jsonl") for line in file.read_text().splitlines()]
        return {(record["work"], record["seed"]): record | {"seconds": 0} for record in records}

    assert answers(tmp_path / "whole") == answers(tmp_path / "killed")
    assert not list((tmp_path / "killed").glob("*.steps"))
