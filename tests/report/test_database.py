"""Page and atlas of a database: what it holds, where it ends and why, its cases, borders, maps, shapes and changes."""

import re
from html import unescape

import manufactured
import numpy as np
import pytest

from capsbayes.database import VARIABLES, Database
from capsbayes.errors import DatabaseError
from capsbayes.report.database import (
    atlas,
    cases_of_cell,
    changes,
    database_page,
    domain_sentence,
    domain_table,
    table_of_cases,
)
from capsbayes.report.tables import html_table
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate

SNAP_COLUMNS = (1.025, 1.05, 1.1)
NAMES = ("capillary_number", "size_ratio", "velocity_ratio")


def variables_of(database):
    return {name: database[name] for name in VARIABLES.keys() & database.dataset.keys()}


@pytest.fixture(scope="module")
def database():
    """Two branches, all kinds of border in some columns; one case without a steady state, one not resolved."""
    plain, count = manufactured.two_branches(), len(SNAP_COLUMNS)
    more = {
        "border_size_ratio": np.array(SNAP_COLUMNS),
        "border_capillary_number": np.full(count, 0.03),
        "border_effect_value": np.zeros(count),
        "border_kind": np.full(count, "snap-through"),
    }
    joined = {name: np.concatenate([plain[name], values]) for name, values in more.items()}
    made = Database.assemble(variables_of(plain) | joined, plain.dataset.attrs)
    made["status"][[5, 40]] = ["NO_STEADY_STATE", "UNRESOLVED"]
    return made


@pytest.fixture(scope="module")
def figures(database):
    return atlas(database)


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
    (drawn,) = (one for one in ax.lines if one.get_label() == label)
    return np.asarray(drawn.get_xydata())


def as_set(points):
    return {tuple(point) for point in np.round(points, 9)}


def cases_of(database, rows, names=NAMES[:2]):
    return as_set(np.stack([database[name][rows] for name in names], axis=1))


def test_the_page_has_each_part_and_tells_the_domain_column_by_column_and_value_by_value():
    stated = {"mesh_error": manufactured.MESH_ERROR, "settings": '{"walls": {"end": 3.0}}'}
    database = manufactured.database(9, 8, failed=(5, 6), **stated)
    page = database_page(database, source="manufactured.nc")
    text = re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", page)))
    limits = np.asarray(manufactured.limit(np.linspace(0.7, 1.15, 9)))
    parts = (
        "Database manufactured",
        "70 steady shapes, manufactured membrane, square channel",
        f"beyond Ca {limits.min():.3g} to {limits[limits < 0.15].max():.3g}",
        "72, of which 70 with a steady shape",
        "L z 0.2 %, L a 0.1 %",
        "Where steady shapes exist",
        f"{float(manufactured.limit(1.15)):.4g} limit of existence",
        "How its cases ended",
        "2 NO_STEADY_STATE",
        str(Status.NO_STEADY_STATE),
        "Shapes and maps",
        "Origin",
        database.sha256,
        "walls: end 3",
        "How to cite",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert domain_sentence(database) in text.replace("a/ℓ", "a/l")
    assert page.count("<img") == 5
    effect = Database.open("square-unsteadiness")
    rows = re.findall(r"<tr>(.*?)</tr>", html_table(domain_table(effect)))
    assert len(rows) == 1 + sum(len(np.unique(effect.at_value(value)["size_ratio"])) for value in effect.values)
    assert "unsteadiness" in rows[0]


def test_every_case_is_drawn_once_with_the_symbol_of_its_kind(database, figures):
    (ax,) = figures["cases"].axes
    kinds = ("parachute", "convex", "no steady state", "not resolved or not computed")
    drawn = {kind: as_set(line(ax, kind)) for kind in kinds}
    assert drawn["convex"] == cases_of(database, manufactured.is_convex(*(database[name] for name in NAMES[:2])))
    assert (drawn[kinds[2]], drawn[kinds[3]]) == (cases_of(database, [5]), cases_of(database, [40]))
    assert sum(map(len, drawn.values())) == len(database)
    assert {one.get_label() for one in ax.lines if one.get_markerfacecolor() == "none"} == set(kinds[2:])
    entries = [text.get_text() for text in figures["cases"].legends[0].get_texts()]
    assert entries == [*kinds, "limit of the database", "limit of existence", "snap-through"]
    title = figures["cases"].get_suptitle()
    assert "manufactured membrane, square cross-section, mesh n = 8" in title
    assert f"{len(database) - 2} of {len(database)} cases" in title


def test_the_border_curves_pass_through_the_border_rows_and_are_broken_between(database, figures):
    (ax,) = figures["cases"].axes
    size = np.unique(np.round(database["border_size_ratio"], 6))
    limit = manufactured.limit(size)
    existence = line(ax, "limit of existence")
    np.testing.assert_allclose(existence[:, 0], np.where(limit < 0.15, limit, np.nan))
    np.testing.assert_allclose(existence[:, 1], size)
    np.testing.assert_allclose(line(ax, "limit of the database")[:, 0], limit)
    ca, columns = line(ax, "snap-through").T
    np.testing.assert_allclose(columns[np.isfinite(ca)], SNAP_COLUMNS)
    assert np.nanmax(np.abs(ca - 0.03)) == 0.0
    assert np.isnan(ca[(columns > 1.05) & (columns < 1.1)]).tolist() == [True]
    kinds = np.resize(["snap-through", "lost from rest"], database.dataset.sizes["border"])
    (ax, *_) = atlas(Database(database.dataset.assign(border_kind=("border", kinds))))["cases"].axes
    assert {"snap-through", "lost from rest"} <= {line.get_label() for line in ax.lines}


@pytest.mark.parametrize(
    ("figure", "names"),
    [("velocity", ["velocity_ratio"]), ("lengths", ["axial_extent", "axial_length", "parachute_depth"])],
)
def test_maps_show_the_values_of_the_cases_over_the_domain_and_no_more(database, figures, figure, names):
    surrogate = Surrogate(database)
    cases = database.converged
    planes = [ax for ax in figures[figure].axes if ax.get_label() != "<colorbar>"]
    for ax, name in zip(planes, names, strict=True):
        (dots,) = (one for one in ax.collections if one.get_label() == "case")
        np.testing.assert_array_equal(dots.get_array(), cases[name])
        np.testing.assert_array_equal(dots.get_offsets(), np.stack([cases[key] for key in NAMES[:2]], axis=1))
        assert dots.norm.vmin <= cases[name].min() <= cases[name].max() <= dots.norm.vmax
        filled = [one for one in ax.collections if hasattr(one, "levels") and one.filled]
        assert len(filled) == len(surrogate.branches) == 2
        vertices = np.vstack([path.vertices for one in filled for path in one.get_paths() if len(path.vertices)])
        ends = np.transpose(surrogate.domain.bounds)
        np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], ends, rtol=1e-4)
    bars = [ax.get_ylabel() for ax in figures[figure].axes if ax.get_label() == "<colorbar>"]
    assert len(bars) == len(names)
    assert all(label.endswith("[-]") for label in bars)


def test_the_surface_holds_the_cases_of_both_branches(database, figures):
    ax = figures["velocity-surface"].axes[0]
    points = np.hstack([one.get_data_3d() for one in ax.lines])
    assert as_set(points.T) == cases_of(database.converged, slice(None), NAMES)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["parachute", "convex"]
    figures["velocity-surface"].draw_without_rendering()
    assert len(ax.collections) == 2
    for surface in ax.collections:  # faces of unlike numbers of corners are drawn through memory that nothing filled
        corners = np.ma.array([path.vertices for path in surface.get_paths()])
        assert corners.shape == (24 * 24, 5, 2)
        assert np.isfinite(corners).all()


def test_the_table_of_shapes_draws_profiles_between_the_walls(database, figures):
    ca, size = table_of_cases(database)
    assert (len(size), len(ca)) == (5, 6)
    assert ca[0] == database["capillary_number"].min()
    axes = np.array(figures["shapes"].axes).reshape(len(size), len(ca))
    drawn = 0
    for (row, column), ax in np.ndenumerate(axes):
        done = cases_of_cell(database, ca, column, size[-1 - row]) & (database["status"] == "DONE")
        shown = [patch.get_xy()[:-1] for patch in ax.patches]
        np.testing.assert_array_equal(np.reshape(shown, (-1, manufactured.POINTS, 2)), database["profile"][done])
        drawn += len(shown)
        walls = np.vstack([wall.get_paths()[0].vertices[:, 1] for wall in ax.collections])
        assert np.abs(walls).min() == 1.0
    assert drawn >= 20
    (row,) = np.flatnonzero(cases_of_cell(database, ca, 3, size[2]))
    of_size = database["capillary_number"][np.round(database["size_ratio"], 6) == size[2]]
    nearest = of_size[np.argmin(np.abs(np.sqrt(of_size) - np.sqrt(ca[3])))]
    assert database["capillary_number"][row] == nearest
    assert axes[2, 3].texts[0].get_text() == f"Ca = {nearest:.4g}"


def test_a_cell_without_a_shape_says_why(database):
    ca, size = table_of_cases(database)
    row = np.flatnonzero(cases_of_cell(database, ca, 0, size[-1]))
    lost = Database(database.dataset.copy(deep=True))
    lost["status"][row] = "NO_STEADY_STATE"
    lost["capillary_number"][row] = ca[0]
    ax = atlas(lost)["shapes"].axes[0]
    assert not ax.patches
    assert ax.texts[0].get_text() == "no steady state"


def test_changes_of_an_effect_are_those_of_the_cases_that_both_values_have(of_effect):
    first, last = changes(of_effect, 0.1), changes(of_effect, 0.2)
    assert as_set(first[list(NAMES[:2])].to_numpy()) == cases_of(of_effect, slice(None))
    np.testing.assert_allclose(first["axial_extent"], 0.1)
    assert len(last) == len(of_effect) // 3 - 1
    np.testing.assert_array_equal(last["velocity_ratio"], 0.0)
    figures = atlas(of_effect)
    assert set(figures) == {"cases", "shapes", "changes"}
    axes = figures["changes"].axes[:6]
    assert [ax.get_title() for ax in axes[1::3]] == ["pre inflation = 0.1", "pre inflation = 0.2"]
    for ax, percent in zip(axes[::3], (10.0, 20.0), strict=True):
        np.testing.assert_allclose(ax.collections[0].get_array(), percent)
        assert ax.collections[0].norm.vmax == pytest.approx(20.0)
    titles = [ax.get_title() for ax in figures["cases"].axes]
    assert titles == ["pre inflation = 0 (null)", "pre inflation = 0.1", "pre inflation = 0.2"]
    assert [text.get_text() for text in figures["shapes"].legends[0].get_texts()] == titles
    assert max(len(ax.patches) for ax in figures["shapes"].axes) == 3


def test_the_atlas_has_a_figure_for_each_map_that_can_be_drawn():
    assert set(atlas(manufactured.database(2, 3))) == {"cases", "shapes"}
    none = manufactured.database(2, 3, failed=range(6))
    with pytest.raises(DatabaseError, match="expected a database with steady states to draw, got none in 6 cases"):
        atlas(none)
