import numpy as np
import pytest

from capsbayes.infer.grid import CoarseTable, Window


def test_nodes_are_the_centres_of_the_cells():
    window = Window((0.0, 1.0), (1.0, 3.0), (2, 4))
    np.testing.assert_allclose(window.axes[0], [0.25, 0.75])
    np.testing.assert_allclose(window.axes[1], [1.25, 1.75, 2.25, 2.75])


def test_a_window_shrinks_to_the_likely_cells_and_grows_where_they_reach_its_edge():
    bounds = Window((-10.0, -10.0), (10.0, 10.0), (1, 1))
    window = Window((0.0, 0.0), (8.0, 8.0), (8, 8))
    likely = np.zeros((8, 8), dtype=bool)
    likely[3:5, 0:2] = True
    around = window.around(likely, (16, 16), bounds)
    assert around == Window((2.0, -2.0), (6.0, 3.0), (16, 16))


def test_the_coarse_table_widens_by_the_change_across_a_cell(model):
    table = CoarseTable.of(model)
    extent, zz = (one.reshape(table.window.shape) for one in (table.nodes.model.extent, table.nodes.model.zz))
    inside = np.isfinite(extent)
    assert 0.5 < inside.mean() < 1.0
    assert np.all(np.isfinite(zz[inside]))
    assert zz[24, 36] > (0.5 * (extent[24, 37] - extent[24, 36])) ** 2
    assert np.isnan(zz[~inside]).all()


def test_cells_cut_by_the_border_are_split_into_the_pieces_inside(model):
    window = Window((np.log(0.10), 0.9), (np.log(0.15), 1.1), (10, 10))
    nodes = window.nodes(model)
    inside = np.isfinite(nodes.model.extent)
    split = window.split(nodes, np.ones((10, 10), dtype=bool), 8, model)
    assert np.all(np.isfinite(split.model.extent))
    area = np.sum(split.side**2) / 100.0
    sizes = np.linspace(0.9, 1.1, 2001)
    exact = np.mean((np.log(model.domain.limit(sizes)) - np.log(0.10)) / np.log(1.5))
    assert area == pytest.approx(exact, abs=2e-3)
    assert abs(inside.mean() - exact) > 2e-3
    untouched = window.split(nodes, np.zeros((10, 10), dtype=bool), 8, model)
    np.testing.assert_array_equal(untouched.log_ca, nodes.log_ca)
