"""Pictures and films as files."""

import struct

import cv2
import numpy as np
import PIL.Image
import pytest
from drawn_film import exposed, written
from png_header import png_of_size
from tiff import tiff_behind_one_directory

from capsbayes.errors import InputError
from capsbayes.files.recording import is_film, pixel_size_of
from capsbayes.image.files import Film, Picture, evenly_spaced

GREY = np.tile(np.arange(20, 220, 2, dtype=np.uint8), (40, 1))


@pytest.mark.parametrize("ending", ["png", "tif", "jpg"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("colour", [False, True])
def test_every_kind_of_file_gives_the_grey_levels(tmp_path, ending, bits, colour):
    if ending == "jpg" and bits == 16:
        pytest.skip("JPEG has 8 bits")
    pixels = GREY if bits == 8 else GREY.astype(np.uint16) * 257
    path = tmp_path / f"capsule.{ending}"
    cv2.imwrite(str(path), np.repeat(pixels[:, :, None], 3, axis=2) if colour else pixels)
    picture = Picture.read(path)
    np.testing.assert_allclose(picture.grey / (1 if bits == 8 else 257), GREY, atol=3 if ending == "jpg" else 1e-9)
    assert picture.shape == (40, 100)
    assert picture.source == str(path)
    assert len(picture.sha256) == 64
    assert not picture.clipped.any()


def test_colours_are_weighted_as_the_eye_does(tmp_path):
    colours = np.zeros((20, 20, 3), dtype=np.uint8)
    colours[:, :, 2] = 100  # red, as OpenCV writes it
    cv2.imwrite(str(tmp_path / "red.png"), colours)
    np.testing.assert_allclose(Picture.read(tmp_path / "red.png").grey, 29.9)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65535)])
def test_pixels_at_the_end_of_the_scale_are_known_as_clipped(dtype, full):
    pixels = np.tile(full // 2 + np.arange(20), (20, 1)).astype(dtype)
    pixels[:5], pixels[5:7] = full, 0
    assert np.array_equal(Picture.from_array(pixels).clipped.sum(axis=1), [20] * 7 + [0] * 13)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "nothing there"), (b"", "an empty file"), (b"no picture", "a file that cannot be read as one")],
)
def test_a_file_that_is_no_picture_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "capsule.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        Picture.read(path)
    assert str(caught.value).startswith(f"{path}: expected a picture")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.zeros((20, 20, 3, 2)), "picture: expected"),
        (np.zeros((20, 8)), "picture: expected"),
        (np.full((20, 20), np.nan), "picture: expected"),
        (
            np.ones((16, 40_000), np.uint8),
            "expected sides of at most 32766 pixels, got 40000 x 16",
        ),  # which OpenCV turns
    ],
)
def test_an_array_that_is_no_picture_is_refused(pixels, message):
    with pytest.raises(InputError, match=message):
        Picture.from_array(pixels)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_read_as_a_viewer_turns_it(tmp_path, ending, orientation):
    """The tag says where the first row and the first column of the file belong in the upright picture."""
    path, upright = tmp_path / f"turned.{ending}", GREY + np.linspace(0, 20, 40).astype(np.uint8)[:, None]
    stored = upright[:: -1 if orientation in (3, 4, 7, 8) else 1, :: -1 if orientation in (2, 3, 6, 7) else 1]
    stored = stored.T if orientation > 4 else stored
    image = PIL.Image.fromarray(np.ascontiguousarray(stored))
    tags = PIL.Image.Exif()
    tags[274] = orientation
    image.save(path, **({"tiffinfo": {274: orientation}} if ending == "tif" else {"exif": tags, "quality": 98}))
    read = Picture.read(path)
    assert read.shape == upright.shape
    np.testing.assert_allclose(read.grey, upright, atol=3.0)


@pytest.mark.parametrize("ending", ["png", "jpg", "bmp", "tif"])
def test_a_picture_that_is_cut_off_or_named_for_another_kind_is_refused(tmp_path, ending):
    path = tmp_path / f"capsule.{ending}"
    cv2.imwrite(str(path), GREY)
    whole = path.read_bytes()
    (tmp_path / "capsule.dat").write_bytes(whole)
    assert Picture.read(tmp_path / "capsule.dat").shape == (40, 100)
    other = tmp_path / ("other.tiff" if ending != "tif" else "other.bmp")
    other.write_bytes(whole)
    with pytest.raises(InputError, match="expected a file of the kind that its name says"):
        Picture.read(other)
    path.write_bytes(whole[: int(0.7 * len(whole))])
    with pytest.raises(InputError, match=r"expected a whole [A-Z]+ file"):
        Picture.read(path)


FRAMES = [exposed(np.full((40, 64), 20.0 + 10.0 * number), number) for number in range(12)]


def video(path, frames=FRAMES, code="FFV1"):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25.0, frames[0].shape[::-1], False)
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def pages(path, frames=FRAMES):
    cv2.imwritemulti(str(path), frames)
    return path


@pytest.mark.parametrize(("name", "made"), [("folder", written), ("film.tif", pages), ("film.avi", video)])
def test_every_kind_of_film_gives_its_frames_in_order(tmp_path, name, made):
    """The names in the folder are counted, not spelled: frame10 comes after frame9."""
    path = made(tmp_path / name, FRAMES)
    opened = Film.open(path)
    assert is_film(path)
    assert opened.count == len(FRAMES)
    for picture, frame in zip(opened.frames(), FRAMES, strict=True):
        np.testing.assert_allclose(picture.grey, frame, atol=1.0)
    spread = filter(None, opened.frames(only=evenly_spaced(opened.count, 3)))
    assert [round(frame.grey.mean()) for frame in spread] == [round(FRAMES[i].mean()) for i in (0, 6, 11)]
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
    for name, shape in (("long.avi", (40, 64)), ("large.avi", (2100, 2100))):
        video(tmp_path / name, [np.zeros(shape, np.uint8)] * 3, "MJPG")
    whole = (tmp_path / "long.avi").read_bytes()
    count = whole.index(b"strh") + 8 + 32
    (tmp_path / "long.avi").write_bytes(whole[:count] + struct.pack("<I", 10**6) + whole[count + 4 :])
    pages(tmp_path / "large.tif", [np.zeros(shape, np.uint8) for shape in ((40, 64), (2100, 2100), (40, 64))])
    for name, message in (
        ("film", r"frame7\.png: expected at most 4 million pixels, got far more; crop it to the channel"),
        ("long.avi", "expected as many frames as the file says, got room for fewer than its 1000000"),
        ("large.avi", "expected at most 4 million pixels, got 2100 x 2100; crop it to the channel"),
        ("large.tif", "expected at most 4 million pixels, got 2100 x 2100; crop it to the channel"),
    ):
        with pytest.raises(InputError, match=message):
            Film.open(tmp_path / name)


_OME = '<OME><Image><Pixels SizeX="100" PhysicalSizeX="{}"{}></Pixels></Image></OME>'


@pytest.mark.parametrize(
    ("text", "per_unit", "size"),
    [
        ("ImageJ=1.53t\nimages=1\nunit=micron\n", 2.0, 0.5e-6),
        ("ImageJ=1.53t\nunit=\\u00B5m\nmin=0\n", 4.0, 0.25e-6),
        ("ImageJ=1.53t\nunit=um\n", 0.0, None),
        ("ImageJ=1.53t\nunit=inch\n", 72.0, None),
        ("ImageJ=1.53t\nimages=1\n", 72.0, None),
        ("A camera", 72.0, None),
        (_OME.format("0.45", ""), 72.0, 0.45e-6),
        (_OME.format("0.45", ' PhysicalSizeXUnit="um"'), 72.0, 0.45e-6),
        (_OME.format("450", ' PhysicalSizeXUnit="nm"'), 72.0, None),
    ],
)
def test_the_size_of_a_pixel_is_that_of_imagej_or_ome(tmp_path, text, per_unit, size):
    path = tmp_path / "capsule.tif"
    PIL.Image.fromarray(GREY).save(path, tiffinfo={270: text, 282: per_unit, 296: 1})
    assert pixel_size_of(path) == (None if size is None else pytest.approx(size))


def test_other_files_state_no_size_of_a_pixel(tmp_path):
    cv2.imwrite(str(tmp_path / "capsule.png"), GREY)
    (tmp_path / "broken.tif").write_bytes(b"II*\0 and nothing else")
    assert [pixel_size_of(tmp_path / name) for name in ("capsule.png", "broken.tif", "missing.tif")] == [None] * 3


@pytest.mark.parametrize(("order", "dtype", "numbers"), [("<", "u1", 1), (">", "u2", 1), (">", "f4", 3)])
def test_a_stack_behind_one_directory_is_a_film_of_all_its_images(tmp_path, order, dtype, numbers):
    path, stack = tmp_path / "stack.tif", np.stack(FRAMES)
    text = f"ImageJ=1.53t\nimages={len(stack)}\nslices={len(stack)}\n"
    path.write_bytes(tiff_behind_one_directory(stack.astype(order + dtype), text, numbers))
    film = Film.open(path)
    assert is_film(path)
    assert film.count == len(stack)
    np.testing.assert_array_equal([picture.grey for picture in film.frames()], stack)
    with pytest.raises(InputError, match="expected one picture, got a file of 12 images"):
        Picture.read(path)
    whole = path.read_bytes()
    for cut, message in ((len(whole) // 2, "a whole TIFF file, got 5 of its 12 images"), (200, "a whole TIFF file")):
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError, match=message):
            is_film(path)
    path.write_bytes(tiff_behind_one_directory(np.repeat(stack, 8, axis=0).astype(order + dtype), "a note", numbers))
    with pytest.raises(InputError, match="expected a TIFF file that lists all of its images"):
        Film.open(path)


def test_a_tiff_film_that_is_cut_off_or_says_it_is_longer_is_refused(tmp_path):
    path = pages(tmp_path / "film.tif")
    whole = path.read_bytes()
    for share in (0.3, 0.6, 0.99):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"film\.tif: expected a whole TIFF file, got one that ends after \d+ of"):
            is_film(path)
    ome = '<OME><Pixels SizeX="64" SizeY="40" SizeZ="1" SizeC="1" SizeT="{}"/></OME>'
    for planes in (1, 12):
        path.write_bytes(tiff_behind_one_directory(FRAMES[0][None], ome.format(planes), 1))
        if planes == 1:
            assert Picture.read(path).shape == (40, 64)
        else:
            with pytest.raises(InputError, match="expected a whole TIFF file, got 1 of its 12 images"):
                Picture.read(path)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("ImageJ=1.53t\nimages=12\nchannels=2\nframes=6\nhyperstack=true\n", "2 x 1 x 6"),
        ("ImageJ=1.53t\nimages=12\nchannels=3\nslices=4\n", "3 x 4 x 1"),
        ("ImageJ=1.53t\nimages=12\nslices=2\nframes=6\n", "1 x 2 x 6"),
        ('<OME><Pixels SizeX="64" SizeY="40" SizeZ="1" SizeC="2" SizeT="6"/></OME>', "2 x 1 x 6"),
    ],
)
def test_a_stack_of_several_channels_or_planes_is_refused_though_they_look_alike(tmp_path, text, found):
    path = tmp_path / "stack.tif"
    path.write_bytes(tiff_behind_one_directory(np.stack(FRAMES), text, 1))
    for read in (is_film, Film.open, Picture.read):
        with pytest.raises(InputError, match=f"one channel and one plane, got channels x planes x frames = {found}"):
            read(path)


@pytest.mark.parametrize(("ending", "code"), [("avi", "FFV1"), ("mp4", "mp4v")])
def test_a_video_that_is_cut_off_is_refused(tmp_path, ending, code):
    """Its last frame may be decoded in part, and its number of frames is then what the header says."""
    path = video(tmp_path / f"film.{ending}", code=code)
    assert Film.open(path).count == len(FRAMES)
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    with pytest.raises(InputError, match=r"expected a whole (AVI|MP4 or MOV) file, got \d+ of its \d+ bytes"):
        Film.open(path)


def test_a_file_of_several_images_is_no_frame_of_a_folder(tmp_path):
    folder = tmp_path / "film"
    folder.mkdir()
    pages(folder / "frame1.tif")
    with pytest.raises(InputError, match="expected one picture, got a file of 12 images"):
        Film.open(folder)
    cut = (folder / "frame1.tif").read_bytes()[:600]
    (folder / "frame1.tif").write_bytes(cut)
    cv2.imwrite(str(folder / "frame2.tif"), FRAMES[0])
    assert [picture is None for picture in Film.open(folder).frames()] == [True, False]


def test_the_first_bytes_tell_the_kind_of_a_film_and_one_picture_is_none(tmp_path):
    content = pages(tmp_path / "film.tif").read_bytes()
    for name in ("film.dat", "film.png"):
        (tmp_path / name).write_bytes(content)
    assert is_film(tmp_path / "film.dat")
    with pytest.raises(InputError, match=r"film\.png: expected a file of the kind that its name says, PNG, got .*TIFF"):
        is_film(tmp_path / "film.png")
    for name in ("one.tif", "one.png"):
        cv2.imwrite(str(tmp_path / name), FRAMES[0])
        assert not is_film(tmp_path / name)
