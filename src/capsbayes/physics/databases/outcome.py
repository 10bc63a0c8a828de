"""The outcome of a simulated case: its row of the database, its steady state, and both as a part of a store."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from capsbayes.status import Status
from capsbayes.work import Store

OUTLINE_POINTS = 256

_VARIABLE, _STATE = "variable ", "state "


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one case."""

    capillary_number: float
    size_ratio: float
    start: float | str  # Ca of the state it started from, "rest", or "parachute" for the first one found
    status: Status
    variables: dict[str, Any] = field(default_factory=dict)  # the row of the database; without NaN only if DONE
    state: Any = None  # the steady state if DONE
    message: str = ""  # the error that was raised

    @property
    def done(self) -> bool:
        """True when the case converged."""
        return self.status is Status.DONE

    def save(self, store: Store) -> None:
        """Keep the outcome."""
        values: dict[str, Any] = {"message": self.message}
        values |= {_VARIABLE + name: value for name, value in self.variables.items()}
        if self.state is not None:  # its status is DONE
            stored = {item.name: getattr(self.state, item.name) for item in fields(self.state)}
            values |= {_STATE + name: value for name, value in stored.items() if name != "status"}
        name = f"{name_of(self.capillary_number, self.size_ratio, self.start)}.{self.status.name}"
        store.save(name, values)

    @classmethod
    def find(
        cls,
        store: Store,
        capillary_number: float,
        size_ratio: float,
        start: float | str,
        rebuild: Callable[[Mapping[str, Any]], Any],
    ) -> Outcome | None:
        """Return the outcome of a case that has ended before from this start, else None; refuse other settings."""
        # `rebuild` makes a steady state from the values of its fields.
        for name in sorted(store.names(f"{name_of(capillary_number, size_ratio, start)}.*")):
            values = store.load(name)
            if values is not None:
                status = Status[name.rpartition(".")[2]]
                variables, of_state = _with_prefix(values, _VARIABLE), _with_prefix(values, _STATE)
                state = rebuild(of_state | {"status": status}) if of_state else None
                return cls(capillary_number, size_ratio, start, status, variables, state, values["message"])
        return None


def variables_of(state: Any) -> dict[str, Any]:
    """Return the variables of a steady state in its row of the database, without a shape if it did not converge."""
    row: dict[str, Any] = {
        "residual": float(state.residual),
        "slack": float(state.slack),
        "iterations": int(state.iterations),
        "limit": float(state.limit),
    }
    if state.status is not Status.DONE:
        return row
    profile = state.profile
    return row | {
        "axial_extent": profile.axial_extent,
        "axial_length": profile.axial_length,
        "parachute_depth": profile.parachute_depth,
        "perimeter": profile.perimeter,
        "stretch_ratio": profile.stretch_ratio(state.size_ratio),
        "velocity_ratio": float(state.velocity_ratio),
        "inner_pressure": float(state.inner_pressure),
        "extra_pressure_drop": float(state.extra_pressure_drop),
        "wrinkling_rate": float(state.wrinkling_rate),
        "minimum_tension": float(np.min(state.principal_tensions)),
        "nodes": np.array(state.nodes, dtype=float),
        "profile": np.array(profile.resampled(OUTLINE_POINTS).points),
        "silhouette": np.array(state.silhouette.resampled(OUTLINE_POINTS).points),
    }


def count_ended(store: Store, cases: Iterable[tuple[float, float]]) -> tuple[int, int]:
    """Count the cases (Ca, a/l) that have ended, and those of them that have not converged."""
    statuses: dict[str, set[str]] = {}
    for name in store.names():
        case, _, rest = name.partition("_from-")
        statuses.setdefault(case, set()).add(rest.rpartition(".")[2])
    ended = [known for case in cases if (known := statuses.get(_case_name(*case)))]
    return len(ended), sum(Status.DONE.name not in known for known in ended)


def _with_prefix(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {key.removeprefix(prefix): value for key, value in values.items() if key.startswith(prefix)}


def _case_name(capillary_number: float, size_ratio: float) -> str:
    return f"size-{size_ratio!r}_ca-{capillary_number!r}"


def name_of(capillary_number: float, size_ratio: float, start: float | str) -> str:
    """Return the name of a case that is started from another."""
    return f"{_case_name(capillary_number, size_ratio)}_from-{start if isinstance(start, str) else repr(start)}"
