"""An overlay labels its lengths, draws the rear where the length on the axis ends, and says what its colours are."""

import numpy as np
import pytest
from drawn import drawn

from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.overlay import EXTENT, LENGTH, OUTLINE, REAR, WALL, overlay, round_length

PICTURE = Picture.from_array(drawn(0.08, 1.05, half_width=55.0).picture)
ROWS, COLUMNS = (4 * size for size in PICTURE.shape)
LETTER = COLUMNS // 36


@pytest.fixture(scope="module")
def detection():
    found = detect(PICTURE)
    assert found.rear is not None
    return found


def places(canvas, colour):
    """Rows and columns of what has a colour : two arrays."""
    return np.nonzero(np.abs(canvas.astype(int) - colour).max(axis=2) < 40)


def test_lengths_lie_on_the_axis_and_above_and_the_rear_is_drawn_where_the_shorter_one_ends(detection):
    canvas = overlay(PICTURE, detection)[:ROWS]
    nose, rear_end, rear = 4.0 * (detection.ends + 0.5)
    axis = 4.0 * (detection.axis[1] + 0.5)
    for colour, ends, above in ((EXTENT, (rear_end, nose), 24.0), (LENGTH, (rear, nose), 0.0)):
        rows, columns = places(canvas, colour)
        line = np.abs(rows - (axis - above)) < 3.0
        assert (columns[line].min(), columns[line].max()) == pytest.approx(sorted(ends), abs=8.0)
        assert np.count_nonzero(~line) > 100  # its label
    rows, columns = places(canvas, REAR)
    assert np.ptp(rows) == pytest.approx(8.0 * detection.rear.breadth, abs=8.0)
    assert columns[np.abs(rows - axis) < 3.0].mean() == pytest.approx(rear, abs=4.0)


def test_a_legend_names_each_colour_and_a_bar_is_as_long_as_it_says(detection):
    for half_width, length in ((None, 20.0), (25e-6, 10e-6 / 25e-6 * detection.walls.half_width)):
        strip = overlay(PICTURE, detection, half_width)[ROWS:]
        assert strip.shape == (4 * LETTER, COLUMNS, 3)
        for colour in (WALL, OUTLINE, EXTENT, LENGTH, REAR):
            _, columns = places(strip, colour)
            assert np.ptp(columns) == pytest.approx(2 * LETTER, abs=6)
        dark = strip.max(axis=2) < 40
        runs = np.diff(np.flatnonzero(np.diff(np.pad(dark.astype(int), ((0, 0), (1, 1))).ravel())))[::2]
        assert runs.max() == pytest.approx(4.0 * length, abs=6.0)


def test_what_is_not_seen_is_not_in_the_legend():
    empty = Picture.from_array(np.full((60, 80), 120, dtype=np.uint8))
    canvas = overlay(empty, detect(empty))
    assert canvas.shape[1] == 320
    assert all(len(places(canvas, colour)[0]) == 0 for colour in (WALL, OUTLINE, EXTENT, LENGTH, REAR))
    assert np.any(canvas[240:] == 0)  # the bar


@pytest.mark.parametrize(("most", "length"), [(7.0, 5.0), (20.0, 20.0), (0.0199, 0.01), (100.0, 100.0), (49.0, 20.0)])
def test_bars_have_lengths_of_one_digit(most, length):
    assert round_length(most) == pytest.approx(length)
