"""``python -m evidence.exam``: diagnose blind sessions and write the page of the answers."""

from __future__ import annotations

import argparse
from dataclasses import replace

from capsbayes.cli.effects_file import own_effects
from capsbayes.effects import catalogue
from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable, write_file
from capsbayes.surrogate import Surrogate
from evidence.command import Arguments, count, path, run, tell
from evidence.exam.answers import check_frozen, examine, freeze, stored
from evidence.exam.page import exam_page
from evidence.exam.sessions import HALVES, build_pools, cells_with


def exam(given: argparse.Namespace) -> int:
    """Diagnose what has no answer yet, and write the page."""
    page = given.out / "exam.md"
    check_replaceable(page)
    own = own_effects(given.effects, catalogue(), Surrogate.open("square-neo-hookean"))
    cells = cells_with(own.effects, own.sha256)
    chosen = [cell for cell in cells if given.only is None or given.only in cell.name]
    if not chosen:
        names = ", ".join(cell.name for cell in cells)
        raise InputError("exam", "--only", f"part of one of {names}", repr(given.only))
    if given.sessions is not None:
        chosen = [replace(cell, sessions=min(given.sessions, cell.sessions)) for cell in chosen]
    if given.freeze:
        freeze(given.out)
    if given.half == "locked":
        check_frozen(given.out)
    shapes = dict.fromkeys(cell.shapes for cell in chosen)
    build_pools(shapes, given.pools, given.half, workers=given.workers, further=given.further_shapes)
    examine(chosen, given.pools, given.out, half=given.half, workers=given.workers, tell=tell)
    answers = {half: stored(cells, given.pools, given.out, half=half) for half in HALVES}
    write_file(page, exam_page(cells, answers))
    print(page)
    return 0


def main() -> None:
    """Read the arguments and run."""
    arguments = Arguments(
        "exam",
        "Draw blind sessions with hidden faults in laboratories drawn at random, diagnose each, and write the page. "
        "Finished sessions are kept, so that the command can be stopped and run again. The locked half has other "
        "seeds, and is opened only with the diagnosis that was recorded by --freeze. Exit status: 0 done, 2 bad input.",
    )
    add = arguments.add_argument
    add("--out", type=path, required=True, help="folder for the answers and the page exam.md")
    add("--pools", type=path, required=True, help="folder of the simulated shapes; missing ones are built")
    add("--effects", type=path, help="Python file with effects of your own, hidden and tried as well; its code is run")
    add("--half", choices=HALVES, default="development", help="half of the sessions (default: development)")
    add("--freeze", action="store_true", help="record the diagnosis as it is, which the locked half asks for")
    add("--further-shapes", action="store_true", help="build all 600 plain shapes first: an hour on one core")
    add("--only", help="only cells whose name contains this text")
    add("--sessions", type=count, help="of each cell, at most (default: all)")
    add("--workers", type=count, help="worker processes on this machine (default: one per core)")
    run(arguments, exam)


if __name__ == "__main__":
    main()
