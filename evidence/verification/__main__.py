"""``python -m evidence.verification``: the simulator against theory, other codes and its own limits."""

from __future__ import annotations

import argparse
from collections import Counter

from capsbayes.files.output_file import check_replaceable
from evidence.command import Arguments, path, run, tell
from evidence.verification import TOPICS, verify


def verification(given: argparse.Namespace) -> int:
    """Compute what is missing, write the page, and return 1 if a target is missed."""
    page = given.out / "verification.md"
    check_replaceable(page)
    missed = False
    for name, rows in verify(TOPICS, given.out, only=given.only, tell=tell).items():
        verdicts = Counter(row.verdict for row in rows if row.verdict)
        print(f"{name:20s} {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}")
        missed |= "missed" in verdicts
    print(page)
    return int(missed)


def main() -> None:
    """Read the arguments and run."""
    arguments = Arguments(
        "verification",
        "Compute every comparison that is not in the folder yet, and write the page. All of them take 22 minutes "
        "of one core; finished items are kept, so that the command can be stopped and run again. Exit status: 0 "
        "no target missed, 1 a target missed, 2 bad input.",
    )
    arguments.add_argument(
        "--out", type=path, required=True, help="folder for results.jsonl, verification.md and its pictures"
    )
    arguments.add_argument("--only", help="name of the only topic to compute")
    run(arguments, verification)


if __name__ == "__main__":
    main()
