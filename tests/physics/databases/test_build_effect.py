"""An effect database holds the same cases at each value, built as safely as a plain one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from analytic_simulator import CASES, AnalyticSimulator

from capsbayes.database import Database
from capsbayes.errors import DatabaseError, InputError
from capsbayes.physics.build import build_database
from capsbayes.physics.membrane import Skalak

HERE = "synchronous"
VALUES = (0.165, 0.175, 0.2)
"""Of the parameter `limit`, which shifts the limit of existence."""


@dataclass(frozen=True)
class WithLaw(AnalyticSimulator):
    """The hardening of the law shifts the limit of existence."""

    law: Skalak = field(default_factory=Skalak)

    @property
    def settings(self):
        return super().settings | {"law": self.law.name}

    def run(self, **case):
        return replace(AnalyticSimulator(), limit=0.165 + 0.01 * self.law.hardening).run(**case)


def build(out, simulator=None, values=VALUES, effect="limit", scheduler=HERE, **options):
    simulator = simulator or AnalyticSimulator()
    return build_database(simulator, CASES, effect=effect, values=values, out=out, scheduler=scheduler, **options)


def test_it_holds_every_case_at_every_value_with_its_pedigree(tmp_path):
    out = tmp_path / "effect.nc"
    made = build(out, values=reversed(VALUES))
    database = Database.read(out)
    assert database.sha256 == made.sha256
    assert (database.effect, database.null_value) == ("limit", 0.175)
    np.testing.assert_array_equal(database.values, VALUES)
    assert database.settings == AnalyticSimulator().settings
    for value in VALUES:
        one = database.at_value(value)
        assert set(zip(one["capillary_number"], one["size_ratio"], strict=True)) > set(CASES)
        np.testing.assert_allclose(one["border_capillary_number"], value - 0.1 * one["border_size_ratio"], rtol=0.01)


def test_each_value_has_the_rows_of_a_plain_database_but_no_nodes(tmp_path):
    effect = build(tmp_path / "effect.nc").at_value(0.2)
    plain = build_database(AnalyticSimulator(limit=0.2), CASES, out=tmp_path / "plain.nc", scheduler=HERE)
    assert plain["nodes"].shape[1] == 6
    assert effect["nodes"].shape == (len(effect), 0, 3)
    for name in ("status", "axial_extent", "axial_length", "velocity_ratio", "stretch_ratio"):
        np.testing.assert_array_equal(effect[name], plain[name])
    for name in ("profile", "silhouette"):
        np.testing.assert_array_equal(effect[name], plain[name].astype(np.float32))


def test_the_hardening_of_the_law_can_vary(tmp_path):
    database = build(tmp_path / "effect.nc", WithLaw(), (0.5, 1.0, 2.0), "hardening")
    assert (database.effect, database.null_value, database.settings["law"]) == ("hardening", 1.0, "Skalak C = 1")
    limits = [database.at_value(value)["border_capillary_number"][0] for value in (0.5, 1.0, 2.0)]
    np.testing.assert_allclose(limits, 0.165 + 0.01 * np.array([0.5, 1.0, 2.0]) - 0.08, rtol=0.01)


def test_the_same_call_again_computes_nothing_and_a_new_value_only_itself(tmp_path):
    out, journal = tmp_path / "effect.nc", tmp_path / "journal"
    simulator = AnalyticSimulator(journal=str(journal))
    first = build(out, simulator)
    once = len(journal.read_text().splitlines())
    assert build(out, simulator).sha256 == first.sha256
    assert len(journal.read_text().splitlines()) == once
    more = build(out, simulator, (*VALUES, 0.19))
    assert len(more) == len(first) + len(more.at_value(0.19))
    assert len(journal.read_text().splitlines()) < 1.5 * once


def test_workers_give_the_same_file(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    build(tmp_path / "here.nc")
    build(tmp_path / "there.nc", scheduler=None, workers=2)
    assert (tmp_path / "there.nc").read_bytes() == (tmp_path / "here.nc").read_bytes()


def test_parts_of_other_settings_are_refused(tmp_path):
    build(tmp_path / "effect.nc")
    with pytest.raises(DatabaseError, match=r"limit-0\.165 holds parts made with other settings: refinement 8 there"):
        build(tmp_path / "effect.nc", AnalyticSimulator(refinement=12))


@pytest.mark.parametrize(
    ("effect", "values", "message"),
    [
        ("colour", VALUES, "build: effect: expected one of limit, lowest, snap, kicked, seconds, got 'colour'"),
        ("refinement", VALUES, "build: effect: expected one of limit"),
        ("limit", (0.165, 0.2, 0.3), r"values: expected at least 3 values of limit, the simulator's own 0.175 among"),
        ("limit", (0.175, 0.2), "values: expected at least 3 values"),
        ("limit", (), "got none"),
    ],
)
def test_a_parameter_or_values_that_will_not_do_are_refused(tmp_path, effect, values, message):
    with pytest.raises(InputError, match=message):
        build(tmp_path / "effect.nc", values=values, effect=effect)
    assert not list(tmp_path.iterdir())
