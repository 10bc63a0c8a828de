"""Hide wrong velocities, flow rates and widths, and see what the diagnosis says.

Run ``python -m evidence.benchmarks.flow_rates --sessions 1``. The faults are put in by the code of the blind sessions,
which shares nothing with the operators of the effects. Each session takes five seconds of processor time with lengths
alone and a minute with outlines; finished ones are kept in ``evidence/results/flow-rates.json``. ``--write`` renews the
table in ``evidence/results/diagnosis.md``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from capsbayes import Surrogate
from capsbayes.database import Database
from capsbayes.diagnosis import Study, Verdict, diagnose
from capsbayes.diagnosis.blind import TRUE_EFFECTS, Lab, draw_session
from capsbayes.diagnosis.finding import FLOW
from evidence.benchmarks.stored import POOL_FOLDER, Stored, with_write
from evidence.markdown import table

WELL = Lab(flow_rate_error=0.005, half_width_error=0.1e-6)
LOOSE = Lab(flow_rate_error=0.01, half_width_error=0.25e-6)
MEASURED = {"outlines": (True, 24), "lengths": (False, 40)}
"""Whether outlines are measured, and the number of capsules."""


class Row(NamedTuple):
    """Sessions with one fault: the name of the true effect and its size, none for nothing."""

    hidden: str
    effect: str
    size: float
    lab: Lab = WELL


ROWS = (
    Row("nothing", "none", 0.0),
    Row("velocities 5 % too large", "velocity_scale", 0.05),
    Row("flow rates 5 % too large", "flow_rate_error", 0.05),
    Row("half width 3 % too large, walls in the picture", "half_width_error", 0.03),
    Row("half width 3 % too large, stated apart", "half_width_apart", 0.03),
    Row("velocities 5 % too large, no flow rates", "velocity_scale", 0.05, replace(WELL, flow_rate_error=None)),
    Row("velocities 5 % too large, flow rates and half width to 1 %", "velocity_scale", 0.05, LOOSE),
)


def answer(row: Row, kind: str, seed: int, shapes: Database, model: Surrogate) -> dict[str, Any]:
    """Diagnose one session, and return what was said of it."""
    outline, capsules = MEASURED[kind]
    effect = TRUE_EFFECTS[row.effect]
    blind = draw_session(shapes, effect, row.size, lab=row.lab, capsules=capsules, seed=seed, outline=outline)
    study = diagnose(blind.session, model, seed=seed)
    offset = next((each for each in study.finding.deviations if each.name == FLOW), None)
    return {
        "said": said(row, study),
        "names": list(study.names),
        "offset": None if offset is None else [offset.size, offset.error],
        "not_testable": list(study.not_testable),
    }


def said(row: Row, study: Study) -> str:
    """Return what was said of a session: nothing found, right, with others, unknown or wrong."""
    if study.verdict in (Verdict.NONE, Verdict.NOT_TESTABLE):
        return "nothing found"
    if study.verdict is Verdict.UNKNOWN:
        return "unknown"
    if row.effect == "none" or row.effect not in study.names:
        return "wrong"
    return "named" if study.verdict is Verdict.NAMED else "in a set"


def tables(answers: list[dict[str, Any]]) -> dict[str, str]:
    """Return the table of the answers."""
    rows = []
    for kind in MEASURED:
        for row in ROWS:
            mine = [answer for answer in answers if (answer["row"], answer["kind"]) == (row.hidden, kind)]
            if mine:
                counts = Counter(map(in_words, mine))
                words = "; ".join(f"{text} in {count}" for text, count in counts.most_common())
                rows.append((row.hidden, kind, str(len(mine)), mean_offset(mine), words))
    head = ("hidden", "measured", "sessions", "v_o over that of the flow rate", "answer")
    return {"flow rates": table(head, rows)}


def in_words(answer: dict[str, Any]) -> str:
    """Return the answer to a session in words."""
    if answer["said"] == "in a set":
        return f"in a set of {len(answer['names'])}"
    if answer["said"] == "nothing found" and any("velocity" in name for name in answer["not_testable"]):
        return "nothing found, not testable"
    return answer["said"]


def mean_offset(answers: list[dict[str, Any]]) -> str:
    """Return the mean of the offsets and of their stated errors, in per cent."""
    known = [answer["offset"] for answer in answers if answer["offset"] is not None]
    if not known:
        return "not known"
    size, error = (sum(values) / len(known) for values in zip(*known, strict=True))
    return f"{size:+.1f} ± {error:.1f} %"


STORED = Stored("flow-rates.json", "evidence/results/diagnosis.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument(
        "--sessions", type=int, default=0, help="Of each row with outlines; three times as many without."
    )
    given = parser.parse_args()
    model, shapes = Surrogate.open("square-neo-hookean"), Database.read(POOL_FOLDER / "none-0.nc")
    wanted = [("lengths", seed) for seed in range(1, 3 * given.sessions + 1)]
    wanted = [*wanted[:3], *(("outlines", seed) for seed in range(1, given.sessions + 1)), *wanted[3:]]
    answers = STORED.answered(
        ({"row": row.hidden, "kind": kind, "seed": seed}, partial(answer, row, kind, seed, shapes, model))
        for kind, seed in wanted
        for row in ROWS
    )
    STORED.show(answers, write=given.write)


if __name__ == "__main__":
    main()
