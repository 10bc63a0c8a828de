"""The buttons over all capsules: which commands they run in the bench's folder."""

import asyncio

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

from nicegui.testing import user_simulation

from capsbayes.app.desk import Bench, Desk
from capsbayes.app.steps import population

SUMMARY = {"surface_shear_modulus": (0.05, 0.002), "capsule_radius": (23.5e-6, 0.2e-6)}


@pytest.mark.parametrize("place", ["capsule", "film/capsule-1", "cells/event-0"])
def test_the_next_flow_rate_is_computed_for_the_last_capsule_wherever_it_is_kept(place, tmp_path, monkeypatch):
    ran = []

    async def noted(words, folder, watch):
        ran.append((words, folder))
        return 0, "printed"

    monkeypatch.setattr(population, "printed_by", noted)
    kept = tmp_path / place / "measurement.toml"
    kept.parent.mkdir(parents=True)
    kept.touch()

    def page():
        population.PopulationStep(Desk(Bench(tmp_path), folder=kept.parent)).grown(SUMMARY)

    async def pressed():
        async with user_simulation(page) as user:
            await user.open("/")
            user.find("At which flow rate next?").click()
            await user.should_see("printed")

    asyncio.run(pressed())
    ((words, folder),) = ran
    assert words[:2] == ["sensitivity", "flow"]
    assert folder / words[words.index("--like") + 1] == kept
    assert words[words.index("--radius") + 1] == "23.5 +/- 0.2 um"
    assert words[words.index("--shear-modulus") + 1] == "50 +/- 2 mN/m"
