import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from analytic_simulator import CASES, AnalyticSimulator

from capsbayes.physics.build import CaseOutcome, build_database, chosen_cases, mesh_error
from capsbayes.status import Status


@dataclass(frozen=True)
class MeshedSimulator(AnalyticSimulator):
    """Analytic shapes whose velocity is wrong by 1/n^2."""

    def refined(self, refinement):
        return replace(self, refinement=refinement)

    def run(self, **case):
        state = super().run(**case)
        return replace(state, velocity_ratio=1.3 * (1 + self.refinement**-2))


def outcome(ca, size, status=Status.DONE, **values):
    return CaseOutcome(ca, size, "rest", status, values)


def test_five_converged_cases_of_different_columns_are_chosen():
    columns = [[outcome(ca, size) for ca in (0.01, 0.02, 0.05, 0.1)] for size in np.linspace(0.7, 1.1, 11)]
    columns[5][2] = outcome(0.05, 0.9, Status.NO_STEADY_STATE)
    chosen = chosen_cases(columns)
    assert len({case.size_ratio for case in chosen}) == 5
    assert {case.capillary_number for case in chosen} == {0.02, 0.05}
    assert all(case.done for case in chosen)
    assert chosen_cases([[outcome(0.1, 0.9, Status.NO_STEADY_STATE)]]) == []


def test_error_is_the_rms_of_relative_differences():
    names = ("axial_extent", "axial_length", "velocity_ratio")
    coarse = [outcome(0.05, 0.9, **dict.fromkeys(names, 1.01)), outcome(0.06, 0.9, **dict.fromkeys(names, 2.0))]
    fine = [outcome(0.05, 0.9, **dict.fromkeys(names, 1.0)), outcome(0.06, 0.9, **dict.fromkeys(names, 2.0))]
    error = json.loads(mesh_error(16, coarse, fine))
    assert error["axial_extent"] == pytest.approx(0.01 / np.sqrt(2))
    assert error["refinement"] == 16
    assert [case["velocity_ratio"] for case in error["cases"]] == pytest.approx([0.01, 0.0])


def test_build_keeps_the_error_relative_to_a_finer_mesh_and_does_not_compute_it_twice(tmp_path):
    out, journal = tmp_path / "db.nc", tmp_path / "journal"
    simulator = MeshedSimulator(journal=str(journal))
    first = build_database(simulator, CASES, out=out, scheduler="synchronous", progress=False, compare=16)
    runs = len(journal.read_text().splitlines())
    error = json.loads(first.dataset.attrs["mesh_error"])
    assert error["velocity_ratio"] == pytest.approx((1 + 8**-2) / (1 + 16**-2) - 1)
    assert 3 <= len(error["cases"]) <= 5
    again = build_database(simulator, CASES, out=out, scheduler="synchronous", progress=False, compare=16)
    assert len(journal.read_text().splitlines()) == runs
    assert again.sha256 == first.sha256
