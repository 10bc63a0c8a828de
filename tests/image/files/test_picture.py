import cv2
import numpy as np
import PIL.Image
import pytest

from capsbayes.errors import InputError
from capsbayes.image.files import Picture

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


@pytest.mark.parametrize("pixels", [np.zeros((20, 20, 3, 2)), np.zeros((20, 8)), np.full((20, 20), np.nan)])
def test_an_array_that_is_no_picture_is_refused(pixels):
    with pytest.raises(InputError, match=r"picture: expected"):
        Picture.from_array(pixels)


def test_a_side_that_opencv_cannot_turn_is_refused():
    with pytest.raises(InputError, match="expected sides of at most 32766 pixels, got 40000 x 16"):
        Picture.from_array(np.ones((16, 40_000), np.uint8))


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
