"""Results of benchmarks: kept in JSON files as they come, and shown as tables between the marks of a page."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from capsbayes.run import Store
from evidence.markdown import renew

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "evidence" / "results"
POOL_FOLDER = ROOT / "data" / "pools"

Task = Callable[[], Any]


class Stored:
    """Results of a benchmark in a JSON file, and their tables on a page, by the names of the marks around them."""

    def __init__(self, file: str, page: str, tables: Callable[[Any], Mapping[str, str]]) -> None:
        self.file, self.page, self.tables = RESULTS / file, ROOT / page, tables

    def read(self) -> Any:
        """Return what is stored, nothing before the first run."""
        return read(self.file)

    def write(self, results: Any) -> None:
        write(self.file, results)

    def completed(self, tasks: Iterable[tuple[str, Task]]) -> dict[str, Any]:
        """Return the results by name, after the tasks of those that are missing; each is stored at once."""
        return completed(self.file, tasks)

    def answered(self, sessions: Iterable[tuple[dict[str, Any], Task]]) -> list[dict[str, Any]]:
        """Return the same of results in a list, each of which begins with the words that identify its session."""
        answers = list(self.read())
        for words, task in sessions:
            if not any(words.items() <= answer.items() for answer in answers):
                with threadpool_limits(limits=1):
                    answers.append(words | task())
                self.write(answers)
                print(*words.values(), flush=True)
        return answers

    def show(self, results: Any, *, write: bool) -> None:
        """Print the tables; if asked, store the results and renew the tables of the page."""
        if write:
            self.write(results)
        for name, text in self.tables(results).items():
            print(f"{text}\n")
            if write:
                renew(self.page, name, text)


def read(file: Path | None) -> Any:
    """Return what a JSON file holds, nothing without one."""
    return json.loads(file.read_text()) if file is not None and file.exists() else {}


def write(file: Path, results: Any) -> None:
    """Write a JSON file."""
    file.write_text(json.dumps(results, indent=1) + "\n")


def completed(file: Path | None, tasks: Iterable[tuple[str, Task]]) -> dict[str, Any]:
    """Return the results of a file by name, after the tasks of those that are missing; each is stored at once."""
    results = read(file)
    for name, task in tasks:
        if name not in results:
            with threadpool_limits(limits=1):
                results[name] = task()
            if file is not None:
                write(file, results)
                print(name, flush=True)
    return results


def complete(store: Store, tasks: Iterable[tuple[str, Task]]) -> None:
    """Compute the parts that a store lacks."""
    for name, task in tasks:
        if not store.holds(name):
            store.save(name, task())
            print(name, flush=True)


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Return the arguments of a benchmark, to be extended."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def with_write(description: str | None) -> argparse.ArgumentParser:
    """Return those of a benchmark whose tables stand on a page."""
    parser = arguments(description)
    parser.add_argument("--write", action="store_true", help="renew the stored results and the tables of the page")
    return parser
