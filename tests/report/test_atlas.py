"""The atlas draws what the database holds: cases, borders, maps, shapes and changes."""

import manufactured
import numpy as np
import pytest

from capsbayes.database import VARIABLES, Database
from capsbayes.errors import DatabaseError
from capsbayes.report.atlas import (
    atlas,
    border_curve,
    cases_figure,
    cases_of_cell,
    changes,
    changes_figure,
    kinds_of_case,
    lengths_figure,
    shapes_figure,
    table_of_cases,
    velocity_figure,
    velocity_surface_figure,
)
from capsbayes.surrogate import Surrogate

SNAP_COLUMNS = (1.025, 1.05, 1.1)


def with_snap_through(database):
    """The same with a snap-through at Ca = 0.03 in some of its columns."""
    count = len(SNAP_COLUMNS)
    more = {
        "border_size_ratio": np.array(SNAP_COLUMNS),
        "border_capillary_number": np.full(count, 0.03),
        "border_effect_value": np.zeros(count),
        "border_kind": np.full(count, "snap-through"),
    }
    joined = {name: np.concatenate([database[name], values]) for name, values in more.items()}
    return Database.assemble(variables_of(database) | joined, database.dataset.attrs)


def variables_of(database):
    return {name: database[name] for name in VARIABLES if name not in ("axis", "plane")}


@pytest.fixture(scope="module")
def database():
    """Two branches, two kinds of upper end and a snap-through; one case without a steady state, one not resolved."""
    made = with_snap_through(manufactured.two_branches())
    made["status"][[5, 40]] = ["NO_STEADY_STATE", "UNRESOLVED"]
    return made


@pytest.fixture(scope="module")
def surrogate(database):
    return Surrogate(database)


@pytest.fixture(scope="module")
def of_effect():
    """Three values of an effect; L_z grows by the value, and the last value has one case less."""
    plain = manufactured.database(5, 6)
    parts = []
    for value in (0.0, 0.1, 0.2):
        part = variables_of(plain) | {"axial_extent": plain["axial_extent"] * (1.0 + value)}
        for name in ("effect_value", "border_effect_value"):
            part[name] = np.full(len(part[name]), value)
        parts.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    joined["status"][-1] = "NOT_CONVERGED"
    return Database.assemble(joined, manufactured.ATTRIBUTES | {"effect": "pre_inflation"})


def line(ax, label):
    (found,) = (one for one in ax.lines if one.get_label() == label)
    return np.asarray(found.get_xydata())


def as_set(points):
    return {tuple(point) for point in np.round(points, 9)}


def cases_of(database, rows):
    return as_set(np.stack([database["capillary_number"][rows], database["size_ratio"][rows]], axis=1))


def test_every_case_is_drawn_once_with_the_symbol_of_its_kind(database):
    figure = cases_figure(database)
    (ax,) = figure.axes
    drawn = {kind: as_set(line(ax, kind)) for kind in kinds_of_case(database)}
    convex = manufactured.is_convex(database["capillary_number"], database["size_ratio"])
    assert drawn["convex"] == cases_of(database, convex)
    assert drawn["no steady state"] == cases_of(database, [5])
    assert drawn["not resolved or not computed"] == cases_of(database, [40])
    assert sum(map(len, drawn.values())) == len(database)
    open_symbols = {one.get_label() for one in ax.lines if one.get_markerfacecolor() == "none"}
    assert open_symbols == {"no steady state", "not resolved or not computed"}
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == [
        "parachute", "convex", "no steady state", "not resolved or not computed",
        "limit of the database", "limit of existence", "snap-through",
    ]  # fmt: skip
    title = figure.get_suptitle()
    assert "manufactured membrane, square cross-section, mesh n = 8" in title
    assert f"{len(database) - 2} of {len(database)} cases" in title


def test_the_border_curves_pass_through_the_border_rows_and_are_broken_between(database):
    (ax,) = cases_figure(database).axes
    size = np.unique(np.round(database["border_size_ratio"], 6))
    limit = manufactured.limit(size)
    existence = line(ax, "limit of existence")
    np.testing.assert_allclose(existence[:, 0], np.where(limit < 0.15, limit, np.nan))
    np.testing.assert_allclose(existence[:, 1], size)
    np.testing.assert_allclose(line(ax, "limit of the database")[:, 0], limit)
    snap = line(ax, "snap-through")
    np.testing.assert_allclose(snap[np.isfinite(snap[:, 0]), 1], SNAP_COLUMNS)
    assert np.nanmax(np.abs(snap[:, 0] - 0.03)) == 0.0
    ca, size = border_curve(database, "snap-through")
    between = (size > 1.05) & (size < 1.1)
    assert between.any()
    assert np.isnan(ca[between]).all()
    kinds = np.resize(["snap-through", "lost from rest"], database.dataset.sizes["border"])
    marked = Database(database.dataset.assign(border_kind=("border", kinds)))
    (axes, *_) = cases_figure(marked).axes
    assert {"snap-through", "lost from rest"} <= {line.get_label() for line in axes.lines}


@pytest.mark.parametrize(
    ("draw", "names"),
    [(velocity_figure, ["velocity_ratio"]), (lengths_figure, ["axial_extent", "axial_length", "parachute_depth"])],
)
def test_maps_show_the_values_of_the_cases(surrogate, draw, names):
    cases = surrogate.database.converged
    figure = draw(surrogate)
    planes = [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]
    for ax, name in zip(planes, names, strict=True):
        (dots,) = (one for one in ax.collections if one.get_label() == "case")
        np.testing.assert_array_equal(dots.get_array(), cases[name])
        np.testing.assert_array_equal(dots.get_offsets()[:, 0], cases["capillary_number"])
        np.testing.assert_array_equal(dots.get_offsets()[:, 1], cases["size_ratio"])
        assert dots.norm.vmin <= cases[name].min()
        assert dots.norm.vmax >= cases[name].max()
    bars = [ax.get_ylabel() for ax in figure.axes if ax.get_label() == "<colorbar>"]
    assert len(bars) == len(names)
    assert all(label.endswith("[-]") for label in bars)


def test_the_filled_contours_cover_the_domain_and_no_more(surrogate):
    ax = velocity_figure(surrogate).axes[0]
    filled = [one for one in ax.collections if hasattr(one, "levels") and one.filled]
    assert len(filled) == len(surrogate.branches) == 2
    vertices = np.vstack([path.vertices for one in filled for path in one.get_paths() if len(path.vertices)])
    (low, high), (first, last) = surrogate.domain.bounds
    np.testing.assert_allclose(vertices.min(axis=0), [low, first], rtol=1e-4)
    np.testing.assert_allclose(vertices.max(axis=0), [high, last], rtol=1e-4)


def test_the_surface_holds_the_cases_of_both_branches(surrogate):
    ax = velocity_surface_figure(surrogate).axes[0]
    cases = surrogate.database.converged
    points = np.hstack([one.get_data_3d() for one in ax.lines])
    wanted = np.stack([cases[name] for name in ("capillary_number", "size_ratio", "velocity_ratio")])
    assert as_set(points.T) == as_set(wanted.T)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["parachute", "convex"]


def test_the_table_of_shapes_draws_profiles_between_the_walls(database):
    figure = shapes_figure(database)
    ca, size = table_of_cases(database)
    assert (len(size), len(ca)) == (5, 6)
    assert ca[0] == database["capillary_number"].min()
    axes = np.array(figure.axes).reshape(len(size), len(ca))
    drawn = 0
    for one_size, row in zip(size[::-1], axes, strict=True):
        for k, ax in enumerate(row):
            done = cases_of_cell(database, ca, k, one_size) & (database["status"] == "DONE")
            shown = [patch.get_xy()[:-1] for patch in ax.patches]
            np.testing.assert_array_equal(np.reshape(shown, (-1, manufactured.POINTS, 2)), database["profile"][done])
            drawn += len(shown)
            walls = np.vstack([wall.get_paths()[0].vertices[:, 1] for wall in ax.collections])
            assert np.abs(walls).min() == 1.0
    assert drawn >= 20


def test_a_cell_shows_the_nearest_case_of_its_size_or_says_why_none(database):
    ca, size = table_of_cases(database)
    (row,) = np.flatnonzero(cases_of_cell(database, ca, 3, size[2]))
    column = np.round(database["size_ratio"], 6) == size[2]
    distance = np.abs(np.sqrt(database["capillary_number"][column]) - np.sqrt(ca[3]))
    assert database["capillary_number"][row] == database["capillary_number"][column][np.argmin(distance)]
    ax = np.array(shapes_figure(database).axes).reshape(len(size), len(ca))[2, 3]
    assert ax.texts[0].get_text() == f"Ca = {database['capillary_number'][row]:.4g}"
    row = np.flatnonzero(cases_of_cell(database, ca, 0, size[-1]))
    lost = Database(database.dataset.copy(deep=True))
    lost["status"][row] = "NO_STEADY_STATE"
    lost["capillary_number"][row] = ca[0]
    ax = shapes_figure(lost).axes[0]
    assert not ax.patches
    assert ax.texts[0].get_text() == "no steady state"


def test_changes_of_an_effect_are_those_of_the_cases_that_both_values_have(of_effect):
    ca, size, change = changes(of_effect, 0.1, "axial_extent")
    assert as_set(np.stack([ca, size], axis=1)) == cases_of(of_effect, slice(None))
    np.testing.assert_allclose(change, 0.1)
    ca, _, change = changes(of_effect, 0.2, "velocity_ratio")
    assert len(ca) == len(of_effect) // 3 - 1
    np.testing.assert_array_equal(change, 0.0)
    axes = changes_figure(of_effect).axes[:6]
    assert [ax.get_title() for ax in axes[1::3]] == ["pre inflation = 0.1", "pre inflation = 0.2"]
    for ax, percent in zip(axes[::3], (10.0, 20.0), strict=True):
        np.testing.assert_allclose(ax.collections[0].get_array(), percent)
        assert ax.collections[0].norm.vmax == pytest.approx(20.0)
    titles = [ax.get_title() for ax in cases_figure(of_effect).axes]
    assert titles == ["pre inflation = 0 (null)", "pre inflation = 0.1", "pre inflation = 0.2"]
    figure = shapes_figure(of_effect)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == titles
    assert max(len(ax.patches) for ax in figure.axes) == 3


def test_the_atlas_has_a_figure_for_each_map_that_can_be_drawn(of_effect):
    assert set(atlas(of_effect)) == {"cases", "shapes", "changes"}
    assert set(atlas(manufactured.database(2, 3))) == {"cases", "shapes"}
    none = manufactured.database(2, 3, failed=range(6))
    with pytest.raises(DatabaseError, match="expected a database with steady states to draw, got none in 6 cases"):
        atlas(none)
