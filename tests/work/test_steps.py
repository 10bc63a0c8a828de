"""A part that is stopped goes on at the step where it was, with the same numbers."""

import contextlib
import time
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest

from capsbayes import run as steps
from capsbayes.quantity import Quantity
from capsbayes.run import Store, digest_of, remembered, run_tasks, step_task, steps_kept

calls = []


@dataclass(frozen=True)
class Place:
    values: np.ndarray
    number: float


class Found(NamedTuple):
    place: Place
    rest: tuple[np.ndarray, ...]
    good: bool


@remembered
def found(start: Place, *, times: int = 2) -> Found | None:
    calls.append(times)
    if times == 0:
        return None
    rest = tuple(start.values[:k] for k in range(times))
    return Found(Place(times * start.values, np.float64(1.0 / 3.0)), rest, True)


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setattr(steps, "_SHORT", -1.0)
    calls.clear()
    return Store.open(tmp_path, {})


def test_steps_come_back_to_the_last_bit_until_the_part_is_finished(store):
    start = Place(np.linspace(0.0, 1.0, 4), 0.5)
    with contextlib.suppress(KeyboardInterrupt), steps_kept(store, "case"):
        first = found(start), found(start, times=3), found(start, times=0)
        raise KeyboardInterrupt
    with steps_kept(store, "case"):
        again = found(start), found(start, times=3), found(start, times=0)
        other = found(Place(start.values, np.nextafter(0.5, 1.0)))
    assert calls == [2, 3, 0, 2]
    assert other is not None
    for one, two in zip(first[:2], again[:2], strict=True):
        np.testing.assert_array_equal(one.place.values, two.place.values)
        assert [len(values) for values in one.rest] == [len(values) for values in two.rest]
        assert (one.place.number, one.good) == (two.place.number, two.good)
    assert first[2] is again[2] is None
    assert [path.name for path in store.folder.iterdir()] == ["settings.json"]


def test_nothing_is_kept_elsewhere(store):
    found(Place(np.zeros(2), 0.0))
    found(Place(np.zeros(2), 0.0))
    assert len(calls) == 2


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Quantity(0.85, 0.02), Quantity(0.85, np.nextafter(0.02, 1.0))),
        (Quantity(0.85, 0.02, "m"), Quantity(0.85, 0.02, "Pa s")),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        ({"a": Place(np.zeros(1), 0.0)}, {"a": Place(-np.zeros(1), 0.0)}),
        (("ab", "c"), ("a", "bc")),
    ],
)
def test_every_digit_counts(one, other):
    assert digest_of(one) == digest_of(one) != digest_of(other)


def computed(factor, shared):
    time.sleep(0.05)  # long enough to be worth a file
    return Place(factor * shared.values, shared.number)


def test_a_step_that_runs_elsewhere_is_kept_here(store):
    shared = Place(np.arange(3.0), 0.5)
    with contextlib.suppress(KeyboardInterrupt), steps_kept(store, "case"):
        task = step_task(Place, ("place", 2.0), partial(computed, 2.0))
        (first,) = run_tasks([task], None, 1, shared)
        kept = list((store.folder / "case.steps").glob("*.part"))
        raise KeyboardInterrupt
    np.testing.assert_array_equal(first.values, [0.0, 2.0, 4.0])
    with steps_kept(store, "case"):
        (again,) = run_tasks([step_task(Place, ("place", 2.0), partial(computed, np.nan))], "synchronous", None, shared)
    assert len(kept) == 1
    np.testing.assert_array_equal(again.values, first.values)
