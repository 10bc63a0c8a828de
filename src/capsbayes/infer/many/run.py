"""Settings that all capsules of a run share; each worker process gets them once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from capsbayes import __version__
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import read_bytes
from capsbayes.infer.exact import ExactEngine, exact_engine
from capsbayes.infer.prior import Prior
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.quantity import Quantity
from capsbayes.work import digest_of


@dataclass(frozen=True, eq=False)
class Run:
    """Model, experiment and prior of a run.

    Parameters
    ----------
    model : ForwardModel
    experiment : Experiment or None
        None if each measurement names its own.
    prior : Prior
    seed : int
    capsule_velocity, flow_rate : Quantity, optional [m/s], [m^3/s]
        Of capsules of which there are pictures: a velocity that they share, the flow rate in their channel.
    background : Path, optional
        Picture of the empty channel.
    flow : str, optional
        ``"right"`` or ``"left"``, in pictures.
    by_hand : ByHand, optional
        What is stated of the pictures.
    """

    model: ForwardModel
    experiment: Experiment | None
    prior: Prior
    seed: int
    capsule_velocity: Quantity | None = None
    flow_rate: Quantity | None = None
    background: Path | None = None
    flow: str | None = None
    by_hand: Any = None

    @cached_property
    def _engines(self) -> dict[bool, ExactEngine]:
        return {}

    def engine(self, experiment: Experiment, *, outline: bool) -> ExactEngine:
        """Return the engine for measurements with or without an outline; that of the experiment of the run is kept."""
        if self.experiment is None:
            return exact_engine(self.model, experiment, self.prior, outline=outline)
        if outline not in self._engines:
            self._engines[outline] = exact_engine(self.model, self.experiment, self.prior, outline=outline)
        return self._engines[outline]

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything that decides the results, the capsules themselves excepted."""
        background = None if self.background is None else read_bytes(self.background, "picture of the empty channel")
        speeds = self.capsule_velocity, self.flow_rate
        how = self.experiment, self.prior, speeds, self.flow, background, self.by_hand
        return digest_of(__version__, self.model, self.seed, *how)

    def experiment_of(self, measurement: Measurement) -> Experiment:
        """Return the experiment of the run, or that which the measurement names, with the conditions of the capsule.

        Raises
        ------
        InputError
            If there is neither.
        """
        known = self.experiment
        if known is None:
            if measurement.experiment_file is None:
                advice = "name it there, or give one for all"
                raise InputError(measurement.source, "experiment", "the name of a file", "nothing", advice)
            known = Experiment.read(measurement.experiment_file)
        own: dict[str, Any] = {}
        for name, value in measurement.conditions.items():
            usual = getattr(known, name)
            own[name] = Quantity(value, usual.sd * value / usual.mean)
        return replace(known, **own) if own else known
