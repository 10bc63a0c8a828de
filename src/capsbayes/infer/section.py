"""A model of capsules in one section says nothing of another."""

from __future__ import annotations

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.model import ForwardModel

__all__ = ["check_section"]


def check_section(model: ForwardModel, experiment: Experiment) -> None:
    """Refuse a model of another cross-section than that of the experiment."""
    section = model.cross_section
    if section is not None and section != experiment.section:
        where = experiment.source or "experiment"
        raise InputError(where, "section", f'"{section}", that of the model', f'"{experiment.section}"')
