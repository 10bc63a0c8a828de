"""A database does not depend on kills, on the order of its cases or on who computed them."""

from __future__ import annotations

import logging
import signal
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from analytic_simulator import CASES, AnalyticSimulator
from processes import members, python, wait_until

import capsbayes
from capsbayes.database import Database
from capsbayes.errors import DatabaseError, InputError
from capsbayes.physics.build import build_database
from capsbayes.status import Status

HERE = "synchronous"
NEAR_LIMITS = [(0.0912, 0.8), (0.09405, 0.8), (0.0816, 0.9), (0.08415, 0.9), (0.072, 1.0), (0.07425, 1.0)]
"""Cases that the walk adds below the limits of existence 0.095, 0.085 and 0.075."""


@pytest.fixture(autouse=True)
def one_date(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


@pytest.fixture
def out(tmp_path):
    return tmp_path / "shapes.nc"


@pytest.fixture
def build(out, tmp_path):
    """Build a database of the analytic simulator with given settings, whose runs are noted."""

    def build(cases=CASES, **settings):
        simulator = AnalyticSimulator(journal=str(tmp_path / "journal"), **settings)
        return build_database(simulator, cases, out=out, scheduler=HERE)

    return build


@pytest.fixture
def steps(tmp_path):
    """Return the runs: Ca, and where each started."""
    return lambda: [tuple(line.split()[1:]) for line in (tmp_path / "journal").read_text().splitlines()]


def status_of(database, capillary_number, size_ratio):
    row = (database["capillary_number"] == capillary_number) & (database["size_ratio"] == size_ratio)
    return Status[str(database["status"][row][0])]


def parts(out):
    return sorted(Path(f"{out}.parts").glob("*.part"))


def test_holds_every_case_in_order_with_its_pedigree(build, out):
    made = build(reversed(CASES))
    database = Database.read(out)
    assert database.sha256 == made.sha256
    held = list(zip(database["capillary_number"], database["size_ratio"], strict=True))
    assert held == sorted({*CASES, *NEAR_LIMITS}, key=lambda case: case[::-1])
    assert database["profile"].shape == (len(held), 256, 2)
    assert database["nodes"].shape == (len(held), 6, 3)
    assert set(database["refinement"]) == {8}
    assert database.settings == AnalyticSimulator().settings
    assert database.dataset.attrs["version"] == capsbayes.__version__
    assert database.dataset.attrs["created"] == "2023-11-14T22:13:20+00:00"
    done = database.converged
    np.testing.assert_allclose(done["axial_extent"] - done["axial_length"], done["parachute_depth"], atol=1e-14)
    np.testing.assert_allclose(done["perimeter"] / (2 * np.pi * done["size_ratio"]), done["stretch_ratio"])


def test_rows_without_a_steady_state_say_so_and_hold_no_shape(build):
    database = build()
    assert status_of(database, 0.08, 0.9) is Status.DONE
    assert status_of(database, 0.1, 0.9) is Status.NO_STEADY_STATE
    assert status_of(database, 0.12, 0.9) is Status.NO_STEADY_STATE
    failed = database["status"] != "DONE"
    assert np.isnan(database["axial_extent"][failed]).all()
    assert np.isnan(database["profile"][failed]).all()
    assert np.isfinite(database["profile"][~failed]).all()


def test_border_is_the_limit_of_existence(build):
    database = build([*CASES, (0.05, 0.5), (0.1, 0.5)])
    np.testing.assert_array_equal(database["border_size_ratio"], [0.5, 0.8, 0.9, 1.0])
    assert list(database["border_kind"]) == ["limit of the database", *["limit of existence"] * 3]
    assert database["border_capillary_number"][0] == 0.1
    np.testing.assert_allclose(database["border_capillary_number"][1:], [0.095, 0.085, 0.075])


def test_each_case_starts_from_its_converged_neighbour(build, steps):
    values = (0.01, 0.02, 0.04, 0.055, 0.06, 0.08)
    build([(ca, 0.9) for ca in values])
    assert steps() == [(str(ca), str(start)) for ca, start in zip(values, ("rest", *values), strict=False)]


def test_where_a_capsule_snaps_through_is_enclosed(build, steps):
    database = build(CASES[8:16], snap=0.033)
    assert steps()[2:5] == [("0.03", "0.02"), ("0.05", "0.03"), ("0.05", "rest")]  # the second is not there any more
    assert steps()[-4:] == [(value, "rest") for value in ("0.03", "0.03873", "0.03409", "0.03198")]
    assert list(database["border_kind"]) == ["snap-through", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"], [0.03302, 0.085])
    assert status_of(database, 0.03198, 0.9) is status_of(database, 0.03409, 0.9) is Status.DONE


def test_where_the_branch_from_rest_is_lost_the_sweep_goes_on_with_parachutes(build, steps):
    database = build(CASES[8:16], snap=0.031, jumps=False)
    assert steps()[2:7] == [
        ("0.03", "0.02"),
        *(("0.05", start) for start in ("0.03", "rest", "parachute")),
        ("0.06", "0.05"),
    ]
    assert list(database["border_kind"]) == ["lost from rest", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"], [0.031, 0.085])


def test_where_a_capsule_from_rest_leaves_a_stable_branch_its_cases_are_replaced(build):
    """Followed from case to case the convex shapes go on to Ca = 0.07, but from rest they are reached up to 0.033."""
    database = build(CASES[8:16], snap=0.07, kicked=0.033)
    assert list(database["border_kind"]) == ["snap-through", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"][0], 0.03302)
    convex = database["capillary_number"][database["parachute_depth"] < 0.1]
    np.testing.assert_array_equal(convex, [0.01, 0.02, 0.03, 0.03198])


def test_downward_failures_end_the_sweep_with_a_reason(build):
    database = build([(ca, 0.9) for ca in (0.005, 0.01, 0.015, 0.02, 0.03, 0.05)], lowest=0.025)
    assert list(database["status"]) == ["NOT_TRIED"] * 2 + ["NOT_CONVERGED"] * 2 + ["DONE"] * 2


def test_another_first_case_is_found_when_the_lowest_fails(build):
    database = build(bad=(0.01, 0.9))
    assert status_of(database, 0.01, 0.9) is Status.RAISED
    assert status_of(database, 0.06, 0.9) is status_of(database, 0.02, 0.9) is Status.DONE


def test_a_case_that_raises_is_a_row_and_is_told(build, caplog):
    with caplog.at_level(logging.WARNING):
        database = build(bad=(0.06, 0.9))
    assert status_of(database, 0.06, 0.9) is Status.RAISED
    assert status_of(database, 0.08, 0.9) is Status.DONE
    assert "1 cases broke off with FloatingPointError: no inverse" in caplog.text


def test_nothing_converges(build, out):
    database = build(limit=0.0)
    assert set(database["status"]) == {"NO_STEADY_STATE"}
    assert len(database.converged) == 0
    assert database["border_size_ratio"].size == 0
    assert len(Database.read(out)) == len(CASES)


def test_the_same_call_again_computes_nothing(build, out, tmp_path):
    build(bad=(0.06, 0.9))
    first = out.read_bytes()
    (tmp_path / "journal").unlink()
    build(bad=(0.06, 0.9))
    assert out.read_bytes() == first
    assert not (tmp_path / "journal").exists()


def test_added_cases_leave_those_with_the_same_neighbour_alone(build, tmp_path):
    before, journal = build(), tmp_path / "journal"
    journal.unlink()
    added = [(0.055, 0.9), (0.07, 0.9), (0.05, 0.95)]
    database = build(CASES + added)
    computed = {tuple(map(float, line.split()[1::-1])) for line in journal.read_text().splitlines()}
    assert computed == {*added, (0.06, 0.9), (0.08, 0.9)}
    assert len(database) == len(before) + 3


@pytest.mark.parametrize("harm", ["cut", "flip", "empty", "foreign"])
def test_a_damaged_part_is_computed_again(build, out, harm):
    build()
    whole = out.read_bytes()
    victim = next(path for path in parts(out) if "size-0.9_ca-0.06_" in path.name)
    content = bytearray(victim.read_bytes())
    content[-9] ^= 1
    victim.write_bytes({"cut": content[:-40], "flip": content, "empty": b"", "foreign": b"other\n"}[harm])
    build()
    assert out.read_bytes() == whole


def test_parts_of_other_settings_are_refused(build, out):
    build(CASES[:2])
    with pytest.raises(DatabaseError, match=r"made with other settings: refinement 8 there and 12 asked; remove it"):
        build(CASES[:2], refinement=12)
    Path(f"{out}.parts", "settings.json").unlink()
    with pytest.raises(DatabaseError, match=r"\.part was made with other settings"):
        build(CASES[:2], refinement=12)


def test_progress_counts_cases_and_failures_on_a_terminal_only(tmp_path, monkeypatch, capsys):
    build_database(AnalyticSimulator(), CASES, out=tmp_path / "a.nc", scheduler=HERE)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    database = build_database(AnalyticSimulator(), CASES, out=tmp_path / "b.nc", scheduler=HERE)
    shown = capsys.readouterr().err
    assert "24/24" in shown
    assert f"{np.sum(database['status'] != 'DONE')} without a steady state" in shown
    build_database(AnalyticSimulator(), CASES, out=tmp_path / "c.nc", scheduler=HERE, progress=False)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("cases", [[], [(0.05, -0.9)], [(np.nan, 0.9)], [(0.0, 0.9)]])
def test_cases_that_are_none_or_not_positive_are_refused(build, cases):
    with pytest.raises(InputError, match="cases: expected"):
        build(cases)


def test_a_killed_build_goes_on_where_it_was_and_ends_with_the_same_file(tmp_path):
    """SIGKILL in the middle loses the cases under way, one for each worker, and changes no byte of the result."""
    whole, out, journal = tmp_path / "whole.nc", tmp_path / "shapes.nc", tmp_path / "journal"
    build_database(AnalyticSimulator(), CASES, out=whole, scheduler=HERE)
    command = ("-c", "import analytic_simulator as a; a.main()", out, journal)
    with python(*command) as killed:
        wait_until(lambda: len(parts(out)) >= 5, killed)
        killed.send_signal(signal.SIGKILL)
    assert not out.exists()
    wait_until(lambda: not members(killed.pid))
    assert 5 <= len(parts(out)) < len(parts(whole))

    with python(*command) as again:
        assert again.wait() == 0, again.stderr.read()
    assert out.read_bytes() == whole.read_bytes()
    runs = Counter(Path(f"{journal}.whole").read_text().splitlines())
    assert sum(runs.values()) <= len(parts(whole)) + 2
    assert [path.name for path in parts(out)] == [path.name for path in parts(whole)]


def test_a_dask_cluster_gives_the_same_file(tmp_path):
    from distributed import LocalCluster

    build_database(AnalyticSimulator(), CASES, out=tmp_path / "here.nc", scheduler=HERE)
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        build_database(AnalyticSimulator(), CASES, out=tmp_path / "there.nc", scheduler=address)
    assert (tmp_path / "there.nc").read_bytes() == (tmp_path / "here.nc").read_bytes()


def test_an_address_without_a_cluster_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match=r"scheduler: expected address of a running dask scheduler, got 'nowhere://x'"):
        build_database(AnalyticSimulator(), CASES, out=tmp_path / "a.nc", scheduler="nowhere://x")


def test_the_folder_of_the_database_is_made(tmp_path):
    out = tmp_path / "new" / "shapes.nc"
    build_database(AnalyticSimulator(), CASES[:1], out=out, scheduler=HERE)
    assert Database.read(out).converged.dataset.sizes["case"] >= 1
