"""The file of finished results: whole at any time, so that a run that was stopped is taken up where it ended."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from capsbayes.errors import InputError
from capsbayes.evidence.verification.section import Outcome, Results
from capsbayes.output_file import replaced

__all__ = ["Store"]


@dataclass(frozen=True)
class Store:
    """Finished items of every section, in a JSON file."""

    path: Path

    def results(self, section: str) -> Results:
        """What is known of a section.

        Raises
        ------
        InputError
            If the file is not one of finished results.
        """
        try:
            return Results({item: Outcome(**outcome) for item, outcome in self._read().get(section, {}).items()})
        except (AttributeError, TypeError, ValueError) as error:
            advice = "remove it to compute everything anew"
            raise InputError(str(self.path), section, "results as written by verify", str(error), advice) from error

    def keep(self, section: str, item: str, outcome: Outcome) -> None:
        """Add an item to what the file holds."""
        known = self._read()
        known.setdefault(section, {})[item] = asdict(outcome)
        replaced(self.path, json.dumps(known, indent=1) + "\n")

    def _read(self) -> dict[str, dict[str, Any]]:
        if not self.path.exists():
            return {}
        known: dict[str, dict[str, Any]] = json.loads(self.path.read_text(encoding="utf-8"))
        return known
