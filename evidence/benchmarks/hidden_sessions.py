"""Hide effects in sessions that look alike or cannot be seen, and count what the diagnosis says of them.

    python -m evidence.benchmarks.hidden_sessions --sessions 2 --write

Diagnoses the sessions of each row that have no answer in ``evidence/results/hidden-sessions.json`` yet, half a minute
each, or several minutes where two effects are hidden, and prints the table of all answers. ``--write`` renews the table
in ``evidence/results/diagnosis.md``.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

from capsbayes import Surrogate, diagnose
from capsbayes.database import Database
from capsbayes.diagnosis import UNKNOWN, Study, Verdict
from capsbayes.diagnosis.blind import TRUE_EFFECTS, Lab, TrueEffect, draw_session
from capsbayes.diagnosis.search import AT_MOST
from evidence.benchmarks.stored import POOL_FOLDER, Stored, with_write
from evidence.markdown import table

PAGE = "evidence/results/diagnosis.md"
HEAD = ("hidden", "capsules", "sessions", "answers", "95 % intervals of G_s that hold the truth")


class Row(NamedTuple):
    """What is hidden: an effect of a size, in shapes of a pool; `truth` are the names that the catalogue has for it."""

    hidden: str
    effect: TrueEffect
    size: float
    pool: str
    truth: tuple[str, ...]
    capsules: int = 40
    lab: Lab = Lab()


_OBLONG = TRUE_EFFECTS["pixel_aspect"]
ROWS = (
    Row("G_s scatters by 30 %", TRUE_EFFECTS["none"], 0.0, "none-0", (), lab=Lab(spread=0.3)),
    Row("pixels 2 % oblong", _OBLONG, 1.02, "none-0", ("pixel_aspect",)),
    Row("barrel, 1 %", TRUE_EFFECTS["distortion"], -0.01, "none-0", ("distortion",)),
    Row("tilt of 2 degrees", TRUE_EFFECTS["taper"], 0.00175, "none-0", ("taper",)),
    Row("hardening of 0.8", TRUE_EFFECTS["strain_hardening"], 0.8, "strain-hardening-0.8", ("strain_hardening",), 14),
    Row("inflation of 3.5 %", TRUE_EFFECTS["pre_inflation"], 0.035, "pre-inflation-0.035", ("pre_inflation",)),
    Row(
        "inflation of 3.5 %, pixels 2 % oblong",
        TRUE_EFFECTS["pre_inflation"].combined(_OBLONG, 1.02),
        0.035,
        "pre-inflation-0.035",
        ("pre_inflation", "pixel_aspect"),
    ),
)


def answered(row: Row, seed: int, model: Surrogate) -> dict[str, Any]:
    """Draw a session, diagnose it, and return the answer next to the truth."""
    shapes = Database.read(POOL_FOLDER / f"{row.pool}.nc")
    blind = draw_session(shapes, row.effect, row.size, lab=row.lab, capsules=row.capsules, seed=seed)
    begin = time.process_time()
    study = diagnose(blind.session, model, seed=seed)
    return answer_of(study, row.lab.surface_shear_modulus, begin) | {"capsules": row.capsules}


def answer_of(study: Study, true_modulus: float, begin: float) -> dict[str, Any]:
    """Return what a diagnosis begun at a processor time [s] says, next to the true G_s [N/m]."""
    modulus = study.surface_shear_modulus
    return {
        "verdict": study.verdict.name,
        "names": [list(names) for names in study.in_question],
        "intervals_95": {name: study.scores[name].interval(1.92) for names in study.in_question for name in names},
        "sizes": {name: study.scores[name].size for name in study.names},
        "something_else": study.probabilities.get(UNKNOWN),
        "true_modulus": true_modulus,
        "modulus": [modulus.low, modulus.median, modulus.high],
        "seconds": time.process_time() - begin,
    }


def outcome(row: Any, answer: dict[str, Any]) -> str:
    """Return the outcome of a verdict: a name is wrong if it is not the truth, a set if it lacks it and all else."""
    verdict = Verdict[answer["verdict"]]
    if verdict in (Verdict.NONE, Verdict.NOT_TESTABLE):
        return "nothing found"
    if verdict is Verdict.UNKNOWN:
        return "something else"
    found = [set(names) for names in answer["names"]]
    if verdict is Verdict.NAMED:
        part = "one of two named" if found[0] < set(row.truth) else "**wrong name**"
        return "named" if found[0] == set(row.truth) else part
    beside = "others or something else" if answer["something_else"] > math.exp(-AT_MOST) else "**wrong set**"
    return "ambiguous" if set(row.truth) in found else beside


def outcomes(rows: Sequence[Any], answers: list[dict[str, Any]]) -> str:
    """Return the table of outcomes, and how often the intervals of G_s hold the truth."""
    return table(HEAD, (_cells(row, [answer for answer in answers if answer["hidden"] == row.hidden]) for row in rows))


def _cells(row: Any, answers: list[dict[str, Any]]) -> tuple[str, ...]:
    if not answers:
        return row.hidden, "", "0", "none was finished", ""
    counts = Counter(outcome(row, answer) for answer in answers)
    words = ", ".join(f"{words} {count}" for words, count in sorted(counts.items()))
    held = sum(answer["modulus"][0] <= answer["true_modulus"] <= answer["modulus"][2] for answer in answers)
    return row.hidden, _capsules(answers), str(len(answers)), words, f"{held} of {len(answers)}"


def _capsules(answers: list[dict[str, Any]]) -> str:
    """Return the numbers of capsules in words, and of those that were measured if not all were."""
    drawn = [answer["capsules"] for answer in answers]
    words = f"{min(drawn)} to {max(drawn)}" if len({*drawn}) > 1 else str(drawn[0])
    measured = sum(answer.get("measured", answer["capsules"]) for answer in answers)
    return words if measured == sum(drawn) else f"{words}, {measured / sum(drawn):.0%} of them measured"


def diagnosed(
    description: str | None,
    rows: Sequence[Any],
    stored: Stored,
    answered: Callable[[Any, int, Surrogate], dict[str, Any]],
    view: Literal["mid-plane", "silhouette"] = "mid-plane",
) -> None:
    """Diagnose further sessions of some rows, and print the table of all."""
    parser = with_write(description)
    parser.add_argument("--sessions", type=int, default=0, help="of each row: those with seeds 1 to this")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    given = parser.parse_args()
    model = Surrogate.open("square-neo-hookean", view=view)
    assert isinstance(model, Surrogate)
    answers = stored.answered(
        ({"hidden": row.hidden, "seed": seed}, partial(answered, row, seed, model))
        for seed in range(1, given.sessions + 1)
        for row in rows
        if given.only in row.hidden
    )
    stored.show(answers, write=given.write)


STORED = Stored("hidden-sessions.json", PAGE, lambda answers: {"hidden sessions": outcomes(ROWS, answers)})

if __name__ == "__main__":
    diagnosed(__doc__, ROWS, STORED, answered)
