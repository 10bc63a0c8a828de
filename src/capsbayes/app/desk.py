"""A bench, which all tabs share, and the desk of one tab: its capsule and what is stated of it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fastapi import APIRouter, HTTPException
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask

from capsbayes.app.archive import PACKED
from capsbayes.app.stated import EXPERIMENT, STATED, Stated, page_words
from capsbayes.app.worker import Worker, WorkFailedError
from capsbayes.errors import CapsbayesError
from capsbayes.experiment import Camera, Experiment
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import guarded, write_file

MOST_MB = 512
MOST_BYTES = MOST_MB << 20
"""Size of the largest file that is taken."""


LONGEST = 1200.0
"""Seconds of one identification."""


class Computed:
    """The result of one capsule and its corner plot, which are computed also where the page is closed meanwhile."""

    def __init__(self, worker: Worker, folder: Path, stated: Stated) -> None:
        self.folder, self.asked, self._worker = folder, stated.asked(folder), worker
        self.answer, self.corner = asyncio.create_task(self._identified()), asyncio.create_task(self._drawn())

    async def run(self, task: str) -> Any:
        """Compute a task that may take longer, for which no picture of another tab has to wait."""
        return await self._worker.run(task, folder=str(self.folder), seconds=LONGEST, stated=self.asked[0])

    async def _identified(self) -> dict[str, Any]:
        found: dict[str, Any] = await self.run("identified")
        if found["asked"] != self.asked:
            raise WorkFailedError("Something else was stated before the computation began: identify again.")
        return found

    async def _drawn(self) -> str:
        with contextlib.suppress(WorkFailedError):
            await self.answer
            return str(await self.run("corner"))
        return ""


class Bench:
    """The folder of all capsules, the processes that compute, and the files that pages may show."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.measuring, self.identifying = Worker("capsbayes.app.measuring"), Worker("capsbayes.app.identifying")
        self.computed: dict[Path | None, Computed] = {}  # the last of each folder, for a page that shows it
        self._offered: dict[str, Path] = {}

    def identified(self) -> dict[Path, tuple[Any, ...]]:
        """Return what `Stated.asked` returned of the capsules that were identified, by their folders."""
        done = (computed for computed in self.computed.values() if computed.answer.done())
        return {computed.folder: computed.asked for computed in done if not computed.answer.exception()}

    def stop(self) -> None:
        """End both processes."""
        self.measuring.stop()
        self.identifying.stop()

    def offer(self, path: Path) -> str:
        """Return the address under which a page shows a file: a number drawn at random, never a path."""
        key = next((key for key, known in self._offered.items() if known == path), None) or secrets.token_urlsafe(16)
        self._offered[key] = path
        return f"/kept/{key}/{path.name}"

    def router(self) -> APIRouter:
        """Return what answers the addresses of `offer`."""
        router = APIRouter()

        @router.get("/kept/{key}/{name}")
        def kept(key: str, name: str) -> FileResponse:
            path = self._offered.get(key)
            if path is None or not path.is_file():
                raise HTTPException(404)
            sent = BackgroundTask(path.unlink, missing_ok=True) if path.name == PACKED else None
            apart = {"content-security-policy": "sandbox allow-scripts allow-popups"}  # it may be another person's
            return FileResponse(path, headers=apart, background=sent)

        return router


@dataclass
class Desk:
    """What one tab of the browser works on: the folder of its capsule, once there is one, and what is stated."""

    bench: Bench
    stated: Stated = field(default_factory=Stated)
    folder: Path | None = None
    experiment: dict[str, Any] = field(default_factory=dict)  # texts by their keys, of the camera under ``"camera"``

    async def measured(self, task: str, **how: Any) -> Any:
        """Compute a task that takes less than a second, see `Worker.run`."""
        return await self.bench.measuring.run(task, folder=str(self.folder), **how)

    def identify(self) -> None:
        """Begin to identify the capsule, which goes on when the page is closed."""
        assert self.folder is not None, "of a capsule"
        self.keep()
        self.bench.computed.pop(self.folder, None)  # the last one comes last
        self.bench.computed[self.folder] = Computed(self.bench.identifying, self.folder, self.stated)

    def take_up(self, folder: Path) -> None:
        """Go on with a capsule whose statements were kept."""
        with parsing(str(folder / STATED), "what was stated of a picture", "give the picture again"):
            stated, experiment = json.loads((folder / STATED).read_text(encoding="utf-8"))
            self.folder, self.stated, self.experiment = folder, Stated(**stated), dict(experiment)

    def keep(self, folder: Path | None = None) -> str:
        """Write what is stated into the capsule's folder, or the experiment into another; return what is missing."""
        if folder is None and self.folder is not None and self.stated.picture:
            with guarded():
                write_file(self.folder / STATED, json.dumps([asdict(self.stated), self.experiment]))
        if not self.stated.measured:  # else the experiment is that of the measurement
            folder = folder or self.folder
        stated = {key: text for key, text in self.experiment.items() if text}
        camera = {key: text for key, text in stated.pop("camera", {}).items() if text}
        if "half_width" not in stated:
            return "The half width is missing."
        if not stated.keys() & {"viscosity", "viscous_tension"}:
            return "The viscosity is missing."
        try:
            known = Experiment(**stated, camera=Camera(**camera) if camera else None)
            if folder is not None:
                with guarded():
                    known.write(folder / EXPERIMENT)
        except CapsbayesError as error:
            return page_words(error)
        return ""
