"""The topics themselves: quick ones from end to end, and what holds for all of them."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from evidence.verification import TOPICS, verify
from evidence.verification.closed_forms import membrane_laws, rigid_spheres, single_layer, undisturbed_flow
from evidence.verification.topic import Results


def test_rows_of_nothing_are_not_computed():
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    for topic in TOPICS:
        rows = list(topic.rows(Results({})))
        assert rows
        assert all(math.isnan(row.ours) for row in rows), topic.name


@pytest.mark.parametrize("topic", [undisturbed_flow(), membrane_laws()], ids=lambda topic: topic.name)
def test_quick_topics_meet_every_target(topic, tmp_path):
    rows = verify([topic], tmp_path)[topic.name]
    assert {row.verdict for row in rows} == {"met"}


def test_single_layer_on_coarse_meshes(tmp_path):
    rows = verify([single_layer((4, 6))], tmp_path)["single-layer"]
    orders = [row for row in rows if row.quantity.endswith("order")]
    assert [row.verdict for row in orders] == ["met", "met"]
    assert "![Single layer](single-layer.png)" in (tmp_path / "verification.md").read_text()


def test_rigid_sphere_on_a_coarse_mesh():
    topic = rigid_spheres(4)
    values = topic.items["square, a/l = 0.5"]()
    assert values["velocity_ratio"] == pytest.approx(1.808701, rel=5e-3)
    assert values["extra_pressure_drop"] == pytest.approx(0.320879, rel=5e-2)


class Made(Results):
    """Every item has any number and any series, all different."""

    def value(self, item, name):
        return 1.0 + 1.0 / (1 + sum(map(ord, item + name)) % 97)

    def series(self, item, name):
        return self.value(item, name) * np.array([1.0, 1.2, 1.3])


@pytest.mark.parametrize("results", [Made({}), Results({})], ids=["full", "failed"])
def test_pictures_name_their_axes(results):
    for topic in (topic for topic in TOPICS if topic.picture):
        figure = Figure()
        topic.picture(results, figure)
        figure.canvas.draw()
        assert figure.axes
        assert all(axes.lines and axes.get_xlabel() and axes.get_ylabel() for axes in figure.axes), topic.name
