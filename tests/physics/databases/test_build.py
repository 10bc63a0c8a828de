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


def status_of(database, capillary_number, size_ratio):
    row = (database["capillary_number"] == capillary_number) & (database["size_ratio"] == size_ratio)
    return Status[str(database["status"][row][0])]


def parts(out):
    return sorted(Path(f"{out}.parts").glob("*.part"))


def test_holds_every_case_in_order_with_its_pedigree(tmp_path):
    out = tmp_path / "shapes.nc"
    made = build_database(AnalyticSimulator(), reversed(CASES), out=out, scheduler=HERE)
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


def test_rows_without_a_steady_state_say_so_and_hold_no_shape(tmp_path):
    database = build_database(AnalyticSimulator(), CASES, out=tmp_path / "shapes.nc", scheduler=HERE)
    assert status_of(database, 0.08, 0.9) is Status.DONE
    assert status_of(database, 0.1, 0.9) is Status.NO_STEADY_STATE
    assert status_of(database, 0.12, 0.9) is Status.NO_STEADY_STATE
    failed = database["status"] != "DONE"
    assert np.isnan(database["axial_extent"][failed]).all()
    assert np.isnan(database["profile"][failed]).all()
    assert np.isfinite(database["profile"][~failed]).all()


def test_border_is_the_limit_of_existence(tmp_path):
    cases = [*CASES, (0.05, 0.5), (0.1, 0.5)]
    database = build_database(AnalyticSimulator(), cases, out=tmp_path / "shapes.nc", scheduler=HERE)
    np.testing.assert_array_equal(database["border_size_ratio"], [0.5, 0.8, 0.9, 1.0])
    assert list(database["border_kind"]) == ["limit of the database", *["limit of existence"] * 3]
    assert database["border_capillary_number"][0] == 0.1
    np.testing.assert_allclose(database["border_capillary_number"][1:], [0.095, 0.085, 0.075])


def test_each_case_starts_from_its_converged_neighbour(tmp_path):
    journal = tmp_path / "journal"
    cases = [(ca, 0.9) for ca in (0.01, 0.02, 0.04, 0.055, 0.06, 0.08)]
    build_database(AnalyticSimulator(journal=str(journal)), cases, out=tmp_path / "a.nc", scheduler=HERE)
    steps = [tuple(line.split()[1:]) for line in journal.read_text().splitlines()]
    assert steps == [
        ("0.01", "rest"),
        ("0.02", "0.01"),
        ("0.04", "0.02"),
        ("0.055", "0.04"),
        ("0.06", "0.055"),
        ("0.08", "0.06"),
    ]


def test_where_a_capsule_snaps_through_is_enclosed(tmp_path):
    journal = tmp_path / "journal"
    simulator = AnalyticSimulator(snap=0.033, journal=str(journal))
    database = build_database(simulator, CASES[8:16], out=tmp_path / "a.nc", scheduler=HERE)
    steps = [tuple(line.split()[1:]) for line in journal.read_text().splitlines()]
    assert steps[2:5] == [("0.03", "0.02"), ("0.05", "0.03"), ("0.05", "rest")]  # the second is not there any more
    assert steps[-4:] == [(value, "rest") for value in ("0.03", "0.03873", "0.03409", "0.03198")]
    assert list(database["border_kind"]) == ["snap-through", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"], [0.03302, 0.085])
    assert status_of(database, 0.03198, 0.9) is status_of(database, 0.03409, 0.9) is Status.DONE


def test_where_the_branch_from_rest_is_lost_the_sweep_goes_on_with_parachutes(tmp_path):
    journal = tmp_path / "journal"
    simulator = AnalyticSimulator(snap=0.031, jumps=False, journal=str(journal))
    database = build_database(simulator, CASES[8:16], out=tmp_path / "a.nc", scheduler=HERE)
    steps = [tuple(line.split()[1:]) for line in journal.read_text().splitlines()]
    assert steps[:7] == [
        ("0.01", "rest"),
        ("0.02", "0.01"),
        ("0.03", "0.02"),
        ("0.05", "0.03"),
        ("0.05", "rest"),
        ("0.05", "parachute"),
        ("0.06", "0.05"),
    ]
    assert list(database["border_kind"]) == ["lost from rest", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"], [0.031, 0.085])


def test_where_a_capsule_from_rest_leaves_a_stable_branch_its_cases_are_replaced(tmp_path):
    """Followed from case to case the convex shapes go on to Ca = 0.07, but from rest they are reached up to 0.033."""
    simulator = AnalyticSimulator(snap=0.07, kicked=0.033)
    database = build_database(simulator, CASES[8:16], out=tmp_path / "a.nc", scheduler=HERE)
    assert list(database["border_kind"]) == ["snap-through", "limit of existence"]
    np.testing.assert_allclose(database["border_capillary_number"][0], 0.03302)
    convex = database["capillary_number"][database["parachute_depth"] < 0.1]
    np.testing.assert_array_equal(convex, [0.01, 0.02, 0.03, 0.03198])


def test_downward_failures_end_the_sweep_with_a_reason(tmp_path):
    cases = [(ca, 0.9) for ca in (0.005, 0.01, 0.015, 0.02, 0.03, 0.05)]
    database = build_database(AnalyticSimulator(lowest=0.025), cases, out=tmp_path / "a.nc", scheduler=HERE)
    assert list(database["status"]) == ["NOT_TRIED"] * 2 + ["NOT_CONVERGED"] * 2 + ["DONE"] * 2


def test_another_first_case_is_found_when_the_lowest_fails(tmp_path):
    database = build_database(
        AnalyticSimulator(bad=(0.01, 0.9)), CASES, out=tmp_path / "shapes.nc", scheduler=HERE, progress=False
    )
    assert status_of(database, 0.01, 0.9) is Status.RAISED
    assert status_of(database, 0.06, 0.9) is status_of(database, 0.02, 0.9) is Status.DONE


def test_a_case_that_raises_is_a_row_and_is_told(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        database = build_database(AnalyticSimulator(bad=(0.06, 0.9)), CASES, out=tmp_path / "shapes.nc", scheduler=HERE)
    assert status_of(database, 0.06, 0.9) is Status.RAISED
    assert status_of(database, 0.08, 0.9) is Status.DONE
    assert "1 cases broke off with FloatingPointError: no inverse" in caplog.text


def test_nothing_converges(tmp_path):
    database = build_database(AnalyticSimulator(limit=0.0), CASES, out=tmp_path / "shapes.nc", scheduler=HERE)
    assert set(database["status"]) == {"NO_STEADY_STATE"}
    assert len(database.converged) == 0
    assert database["border_size_ratio"].size == 0
    assert len(Database.read(tmp_path / "shapes.nc")) == len(CASES)


def test_the_same_call_again_computes_nothing(tmp_path):
    out, journal = tmp_path / "shapes.nc", tmp_path / "journal"
    simulator = AnalyticSimulator(journal=str(journal), bad=(0.06, 0.9))
    build_database(simulator, CASES, out=out, scheduler=HERE)
    first = out.read_bytes()
    journal.unlink()
    build_database(simulator, CASES, out=out, scheduler=HERE)
    assert out.read_bytes() == first
    assert not journal.exists()


def test_added_cases_leave_those_with_the_same_neighbour_alone(tmp_path):
    out, journal = tmp_path / "shapes.nc", tmp_path / "journal"
    before = build_database(AnalyticSimulator(), CASES, out=out, scheduler=HERE)
    added = [(0.055, 0.9), (0.07, 0.9), (0.05, 0.95)]
    database = build_database(AnalyticSimulator(journal=str(journal)), CASES + added, out=out, scheduler=HERE)
    computed = {tuple(map(float, line.split()[1::-1])) for line in journal.read_text().splitlines()}
    assert computed == {*added, (0.06, 0.9), (0.08, 0.9)}
    assert len(database) == len(before) + 3


@pytest.mark.parametrize("harm", ["cut", "flip", "empty", "foreign"])
def test_a_damaged_part_is_computed_again(tmp_path, harm):
    out = tmp_path / "shapes.nc"
    build_database(AnalyticSimulator(), CASES, out=out, scheduler=HERE)
    whole = out.read_bytes()
    victim = next(path for path in parts(out) if "size-0.9_ca-0.06_" in path.name)
    content = bytearray(victim.read_bytes())
    content[-9] ^= 1
    victim.write_bytes({"cut": content[:-40], "flip": content, "empty": b"", "foreign": b"other\n"}[harm])
    build_database(AnalyticSimulator(), CASES, out=out, scheduler=HERE)
    assert out.read_bytes() == whole


def test_parts_of_other_settings_are_refused(tmp_path):
    out = tmp_path / "shapes.nc"
    build_database(AnalyticSimulator(), CASES[:2], out=out, scheduler=HERE)
    with pytest.raises(DatabaseError, match=r"made with other settings: refinement 8 there and 12 asked; remove it"):
        build_database(AnalyticSimulator(refinement=12), CASES[:2], out=out, scheduler=HERE)
    (tmp_path / "shapes.nc.parts" / "settings.json").unlink()
    with pytest.raises(DatabaseError, match=r"\.part was made with other settings"):
        build_database(AnalyticSimulator(refinement=12), CASES[:2], out=out, scheduler=HERE)


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
def test_cases_that_are_none_or_not_positive_are_refused(tmp_path, cases):
    with pytest.raises(InputError, match="cases: expected"):
        build_database(AnalyticSimulator(), cases, out=tmp_path / "shapes.nc", scheduler=HERE)


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
