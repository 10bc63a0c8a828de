import json
import re
from pathlib import Path

import manufactured
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from capsbayes.cli.simulating import validate
from capsbayes.database import Database
from capsbayes.surrogate.plane import LeaveOneOut, even_subset, validate_forward_map, validate_inverse

EVIDENCE = Path(__file__).parents[2] / "docs" / "evidence.md"


@pytest.fixture(scope="module")
def small():
    return manufactured.database(columns=10, rows=10)


def test_the_forward_map_beats_the_inverse_and_both_find_the_case(small):
    inverse, forward = validate_inverse(small), validate_forward_map(small)
    assert inverse.summary().mean[0] < 0.1
    assert np.all(forward.summary().mean < 0.2 * inverse.summary().mean)
    assert forward.summary().failed == 0


def test_the_summary_counts_what_was_lost_and_can_look_at_stretched_cases_alone():
    errors = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1], [np.nan, 0.0, 0.0], [0.5, 0.5, 0.5]])
    depth = np.array([0.2, 0.0, 0.1, 0.1])
    study = LeaveOneOut("any", np.ones((4, 3)), np.array([1.05, 1.10, 1.2, 1.0]), depth, errors)
    np.testing.assert_allclose(study.summary().mean, [0.3, 0.3, 0.3])
    assert (study.summary().cases, study.summary().failed) == (4, 1)
    stretched = study.summary("stretched")
    np.testing.assert_allclose(stretched.mean, [0.2, 0.2, 0.2])
    np.testing.assert_allclose(stretched.sd, [0.1, 0.0, 0.1], atol=1e-12)
    assert (stretched.cases, stretched.failed) == (3, 1)
    np.testing.assert_allclose(study.summary("parachute").mean, [0.1, 0.2, 0.3])


def test_the_branch_of_a_left_out_case_is_read_from_its_lengths():
    database = manufactured.two_branches()
    study = validate_forward_map(database)
    assert study.summary().failed == 0
    concave = study.parachute_depth > 0
    assert study.errors[concave, 0].mean() < 1e-3
    assert study.errors[~concave, 1].mean() < 0.02


def test_the_subset_is_even_and_always_the_same(small):
    subset = even_subset(small, 40)
    again = even_subset(small, 40)
    np.testing.assert_array_equal(subset["capillary_number"], again["capillary_number"])
    points = np.stack([subset["capillary_number"] / 0.14, subset["size_ratio"] / 0.45], axis=1)
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(40)
    assert apart.min() > 0.07
    assert len(even_subset(small, 1000)) == len(small)


@pytest.mark.parametrize("cases", [pytest.param("of 137 spread evenly"), pytest.param("with", marks=pytest.mark.slow)])
def test_the_page_of_evidence_shows_these_errors(cases):
    database = Database.open("square-neo-hookean")
    chosen = even_subset(database) if "evenly" in cases else database
    studies = [validate_inverse(chosen), validate_forward_map(chosen)]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in EVIDENCE.read_text().splitlines()]
    for which in ("stretched", "parachute"):
        label = "Λ > 1.04" + (" and L_p > 0" if which == "parachute" else "")
        place = next(
            i for i, row in enumerate(rows) if re.fullmatch(rf"\d+ {cases}(,? with)? {label}", row[0] if row else "")
        )
        for study, row in zip(studies, rows[place:], strict=False):
            summary = study.summary(which)
            assert row[0] == "" or int(row[0].split()[0]) == summary.cases
            assert row[1] == study.method
            shown = np.array([[float(number) for number in cell.split(" ± ")] for cell in row[2:]])
            found = 100.0 * np.stack([summary.mean, summary.sd], axis=1)
            np.testing.assert_allclose(shown, found, rtol=0.01, atol=0.011)


def command() -> typer.Typer:
    app = typer.Typer()
    app.command()(validate)
    return app


def validated(tmp_path, small, *options):
    small.write(tmp_path / "small.nc")
    ran = CliRunner().invoke(command(), [str(tmp_path / "small.nc"), *options])
    assert ran.exit_code == 0, ran.output
    return ran


def test_the_command_prints_figures_and_writes_maps(tmp_path, small):
    ran = validated(tmp_path, small, "--json", "--out", str(tmp_path / "out"))
    figures = json.loads(ran.stdout)
    assert figures["sha256"] == small.sha256
    assert figures["paper"]["mean"]["capillary_number"] == 0.027
    forward = [row for row in figures["relative_errors"] if row["method"] == "forward map"]
    assert [row["count"] for row in forward if row["which"] == "all"] == [100, 100]
    assert all(row["capillary_number"]["mean"] < 0.02 for row in forward)
    assert json.loads((tmp_path / "out" / "validation.json").read_text()) == figures
    assert (tmp_path / "out" / "errors-all.png").stat().st_size > 10_000


def test_the_table_names_both_methods_and_the_paper(tmp_path, small):
    ran = validated(tmp_path, small)
    for words in ("paper's inverse", "forward map", "as published", "2.7 ± 4.1"):
        assert words in ran.stdout
