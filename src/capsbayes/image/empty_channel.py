"""Whether a picture of the empty channel belongs to that of a capsule: its light, its place, and that it is empty."""

from __future__ import annotations

import cv2
import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.image.background import estimate_background, flatten, transmission
from capsbayes.image.blobs import find_blobs
from capsbayes.image.edges.outline import pixel_noise
from capsbayes.image.files.picture import Picture
from capsbayes.image.walls import WallLines, find_walls
from capsbayes.status import Status

_ENDS = 0.05  # of the columns at either border, which a capsule that can be measured does not reach
_GAIN = 1.3  # largest ratio of the lights of picture and background; lengths are right up to it
_WIDER = 0.2  # px: largest difference of the two half widths
_FAINT = 0.1  # of the range of the picture's levels: smaller differences are those of a dark ground
_DEPTHS = (8, 10, 12, 14, 16)  # bits of a camera
_SHIFT = 1.2  # px: largest shift across the channel; 1.5 px leave lengths right, at 2 px a wall becomes a blob
_TURN = 0.2  # px at the distance l from the axis, by which an end of the capsule is shifted
_BETTER = 0.8  # of the difference, left when the background is laid onto the picture
_BY_WALLS = 12.0  # px from a wall, where it counts
_BRIGHTER = 1.05  # light of a pixel that is dark in the background alone
_UNLIKE = 0.1  # of something dark in the background: share that is not in the picture


def check_light(picture: Picture, background: Picture, most: float = _GAIN) -> None:
    """Refuse a background that was taken with another exposure or depth, whose light differs by a factor `most`."""
    seen, empty = picture.grey, background.grey
    columns = max(3, round(_ENDS * seen.shape[1]))
    ends = np.r_[:columns, -columns:0]
    if np.mean(picture.clipped[:, ends]) > 0.5:  # said when its walls are known
        return
    level, ground = float(np.median(seen[:, ends])), float(np.median(empty[:, ends]))
    low, high = np.percentile(seen, (1, 99))
    if abs(level - ground) <= _FAINT * (high - low) or 1.0 / most <= level / max(ground, 1e-9) <= most:
        return
    way = "darker" if ground < level else "brighter"
    got = f"one that is {way}: its median is {ground / max(level, 1e-9):.2g} of the picture's"
    bits = [next((depth for depth in _DEPTHS if grey.max() < 2**depth), 32) for grey in (empty, seen)]
    if bits[0] != bits[1]:
        got += f" ({bits[0]} bits, and the picture {bits[1]})"
    raise _error(background, "a background as bright as the picture", got, "take both with the same exposure and depth")


def check_place(seen: Floats, background: Picture, walls: WallLines | None) -> None:
    """Refuse a background that lies elsewhere or is turned or of another channel, or not empty as the picture is.

    The picture (rows, columns) and the background have dark walls; `walls` are those known, None if not found.
    """
    empty = background.grey
    in_picture, in_background = find_walls(seen), find_walls(empty)
    if in_picture is not None and in_background is None and find_walls(np.ascontiguousarray(empty.T)) is not None:
        got = "one whose channel runs up and down"
        raise _error(background, "a background of the same channel", got, "take both the same way round")
    if walls is None and (in_picture or find_walls(seen.max() + np.median(seen) - seen)):
        raise _error(background, "a background of the same channel", "one without its walls", "take both at one place")
    if in_picture is not None and in_background is not None:
        down = float(in_background.centre_row - in_picture.centre_row)
        turn = float(np.degrees(in_background.tilt - in_picture.tilt))
        askew = np.radians(abs(turn)) * in_picture.half_width > _TURN
        wide = in_background.half_width / in_picture.half_width
        unlike = abs(in_background.half_width - in_picture.half_width) > _WIDER
        lies = f"lies {abs(down):.1f} px {'lower' if down > 0.0 else 'higher'} than it" if abs(down) > _SHIFT else ""
        turned = f"is turned by {abs(turn):.1f} degrees" if askew else ""
        other = f"shows a channel {abs(wide - 1.0):.1%} {'wider' if wide > 1.0 else 'narrower'}" if unlike else ""
        if (lies or turned or other) and _lies_better(seen, empty, in_picture, down, turn, wide):
            got = f"one that {' and '.join(filter(None, (lies, turned, other)))}"
            raise _error(
                background, "a background that fits the picture", got, "take both at one place and magnification"
            )
    if walls is None or not np.any(np.abs(walls.offset((len(empty), empty.shape[1]))) < 0.5 * walls.half_width):
        return
    light = flatten(transmission(empty, estimate_background(empty, walls)), walls)
    over = transmission(seen, empty)
    for blob in find_blobs(light, walls, pixel_noise(light)):
        inside = np.zeros(empty.shape, np.uint8)
        cv2.fillPoly(inside, [blob.polygon.astype(np.int32)], 1)
        fuller = np.mean(over[inside > 0] > _BRIGHTER) > _UNLIKE or np.array_equal(seen, empty)
        if blob.status is not Status.DEBRIS and fuller:
            got = f"one with something dark at column {blob.middle[0]:.0f}, row {blob.middle[1]:.0f}"
            raise _error(background, "the empty channel", got, "take it without a capsule")


def _lies_better(seen: Floats, empty: Floats, walls: WallLines, down: float, turn: float, wide: float) -> bool:
    """Return whether the background differs less from the picture by the walls when it is moved, turned and scaled."""
    move = cv2.getRotationMatrix2D((walls.centre_column, walls.centre_row + down), turn, 1.0 / wide)
    move[1, 2] -= down
    rows, columns = empty.shape
    laid = cv2.warpAffine(empty, move, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
    near = np.abs(np.abs(walls.offset((rows, columns))) - walls.half_width) < _BY_WALLS
    return bool(np.mean(np.abs(seen - laid)[near]) < _BETTER * np.mean(np.abs(seen - empty)[near]))


def _error(background: Picture, expected: str, got: str, advice: str) -> InputError:
    return InputError(background.source or "background", "", expected, got, f"{advice}, or leave the background out")
