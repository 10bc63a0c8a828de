import numpy as np

from capsbayes.inference.lattice import CoarseTable, Window


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
    inside = np.isfinite(table.model.extent)
    assert 0.5 < inside.mean() < 1.0
    assert np.all(np.isfinite(table.model.zz[inside]))
    i, j = 24, 36
    across = 0.5 * (table.model.extent[i, j + 1] - table.model.extent[i, j])
    assert table.model.zz[i, j] > across**2
    assert np.isnan(table.model.zz[~inside]).all()
