import struct

import cv2
import numpy as np
import pytest
from drawn_film import exposed, written
from png_header import png_of_size

from capsbayes.errors import InputError
from capsbayes.files.recording import is_film
from capsbayes.image.files.film import Film

FRAMES = [exposed(np.full((40, 64), 20.0 + 10.0 * number), number) for number in range(12)]


@pytest.fixture(params=["folder", "film.tif", "film.avi"])
def path(request, tmp_path):
    made = tmp_path / request.param
    match request.param:
        case "folder":
            return written(made, FRAMES)
        case "film.tif":
            cv2.imwritemulti(str(made), FRAMES)
        case _:
            writer = cv2.VideoWriter(str(made), cv2.VideoWriter_fourcc(*"FFV1"), 25.0, (64, 40), False)
            for frame in FRAMES:
                writer.write(frame)
            writer.release()
    return made


def test_every_kind_of_film_gives_its_frames_in_order(path):
    """The names in the folder are counted, not spelled: frame10 comes after frame9."""
    opened = Film.open(path)
    assert is_film(path)
    assert opened.count == len(FRAMES)
    for picture, frame in zip(opened.frames(), FRAMES, strict=True):
        np.testing.assert_allclose(picture.grey, frame, atol=1.0)
    assert [round(one.grey.mean()) for one in opened.spread(3)] == [round(FRAMES[i].mean()) for i in (0, 6, 11)]
    assert next(opened.frames(slice(3, 30))).shape == (27, 64)
    assert len(opened.sha256) == 64


def test_a_bad_frame_is_nothing_and_the_next_one_is_there(tmp_path):
    folder = written(tmp_path / "film", FRAMES)
    (folder / "frame3.png").write_bytes(b"no picture")
    (folder / "frame4.png").write_bytes(b"")
    cv2.imwrite(str(folder / "frame5.png"), FRAMES[5][:, :50])
    read = [picture is not None for picture in Film.open(folder).frames()]
    assert read == [number not in (3, 4, 5) for number in range(12)]


def test_a_file_that_is_no_film_is_refused_in_one_line(tmp_path):
    (tmp_path / "film.avi").write_bytes(b"no film")
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("film.avi", "a file that cannot be read as one"),
        ("empty", "a folder without any"),
        ("missing.avi", "nothing there"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            Film.open(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_sizes_that_a_film_declares_are_checked_before_it_is_read(tmp_path):
    folder = written(tmp_path / "film", FRAMES)
    (folder / "frame7.png").write_bytes(png_of_size(20_000, 20_000))
    for name, size in (("long.avi", (64, 40)), ("large.avi", (2100, 2100))):
        writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, size, False)
        for _ in range(3):
            writer.write(np.zeros(size[::-1], np.uint8))
        writer.release()
    video = (tmp_path / "long.avi").read_bytes()
    count = video.index(b"strh") + 8 + 32
    (tmp_path / "long.avi").write_bytes(video[:count] + struct.pack("<I", 10**6) + video[count + 4 :])
    pages = [np.zeros(shape, np.uint8) for shape in ((40, 64), (2100, 2100), (40, 64))]
    cv2.imwritemulti(str(tmp_path / "large.tif"), pages)
    for name, message in (
        ("film", r"frame7\.png: expected at most 4 million pixels, got far more; crop it to the channel"),
        ("long.avi", "expected as many frames as the file says, got room for fewer than its 1000000"),
        ("large.avi", "expected at most 4 million pixels, got 2100 x 2100; crop it to the channel"),
        ("large.tif", "expected at most 4 million pixels, got 2100 x 2100; crop it to the channel"),
    ):
        with pytest.raises(InputError, match=message):
            Film.open(tmp_path / name)


def test_one_picture_is_no_film(tmp_path):
    cv2.imwrite(str(tmp_path / "one.tif"), FRAMES[0])
    cv2.imwrite(str(tmp_path / "one.png"), FRAMES[0])
    assert not is_film(tmp_path / "one.tif")
    assert not is_film(tmp_path / "one.png")
