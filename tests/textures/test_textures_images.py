"""Reading images: expected values of every mode, and reasons for refusing broken files."""

import pickle
import struct
import tracemalloc
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, ImageFile

from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.textures.image_files import find_files, find_images
from semisynth_gl.textures.images import MAX_PIXELS, ImageError, image_extensions, read_image, stored_size


def levels(*shape):
    return np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)


def as_rgb(grey):
    return np.repeat(grey[..., np.newaxis], 3, axis=2).astype(np.uint8)


def save(image, path, **options):
    image.save(path, **options)
    return path


def test_rgb_grey_palette_and_one_bit_are_read_bit_for_bit_contiguous_and_with_their_own_memory(tmp_path):
    pixels, grey = levels(13, 17, 3), levels(9, 11)
    for name in ("a.png", "a.bmp", "a.tif", "a.ppm", "a.tga"):
        read = read_image(save(Image.fromarray(pixels), tmp_path / name))
        np.testing.assert_array_equal(read, pixels)
        assert read.dtype == np.uint8
        assert read.flags.c_contiguous
        assert read.flags.writeable
    np.testing.assert_array_equal(read_image(save(Image.fromarray(grey), tmp_path / "l.png")), as_rgb(grey))
    palette = Image.fromarray(grey % 4, mode=None)
    palette.putpalette([10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120])
    colours = np.array([[10, 20, 30], [40, 50, 60], [70, 80, 90], [100, 110, 120]], dtype=np.uint8)
    np.testing.assert_array_equal(read_image(save(palette, tmp_path / "p.png")), colours[grey % 4])
    bits = grey > 127
    np.testing.assert_array_equal(read_image(save(Image.fromarray(bits), tmp_path / "1.png")), as_rgb(bits * 255))


def test_transparent_pixels_become_mid_grey_in_every_mode(tmp_path):
    pixels = np.full((4, 6, 4), (100, 50, 10, 255), dtype=np.uint8)
    pixels[0] = (255, 0, 255, 0)  # editors leave arbitrary colours in transparent pixels
    pixels[1, 0, 3] = 128
    read = read_image(save(Image.fromarray(pixels), tmp_path / "rgba.png"))
    assert read.flags.c_contiguous
    np.testing.assert_array_equal(read[0], np.full((6, 3), 128))
    np.testing.assert_array_equal(read[2:], pixels[2:, :, :3])
    np.testing.assert_allclose(read[1, 0], (np.array([100, 50, 10]) * 128 + 128 * 127) / 255, atol=0.51)

    grey, alpha = np.full((4, 6), 90, dtype=np.uint8), np.full((4, 6), 255, dtype=np.uint8)
    grey[0], alpha[0] = 255, 0
    with_alpha = Image.merge("LA", [Image.fromarray(grey), Image.fromarray(alpha)])
    palette = Image.fromarray((grey == 255).astype(np.uint8))
    palette.putpalette([90, 90, 90, 255, 0, 255])
    for path in (
        save(with_alpha, tmp_path / "la.png"),
        # The header has a transparent colour instead of an alpha channel.
        save(Image.fromarray(grey), tmp_path / "key.png", transparency=255),
        save(palette, tmp_path / "p.png", transparency=1),
        save(palette, tmp_path / "p.gif", transparency=1),
    ):
        np.testing.assert_array_equal(read_image(path), as_rgb(np.where(alpha == 0, 128, 90)))


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_white_is_that_of_the_sensor_whose_values_the_folder_holds(tmp_path, bits):
    white = 2**bits - 1
    bright, dark = (np.rint(np.array([[0, 0.1, 0.123, share]]) * white).astype(np.uint16) for share in (0.9, 0.2))
    paths = [save(Image.fromarray(values), tmp_path / name) for values, name in ((dark, "a.png"), (bright, "b.png"))]
    save(Image.new("RGB", (9, 9), (255, 0, 0)), tmp_path / "c.png")
    for path, values in zip(paths, (dark, bright), strict=True):
        np.testing.assert_array_equal(read_image(path), as_rgb(np.floor(values * (255 / white) + 0.5)))


def test_32_bit_integers_are_16_bit_levels_and_floats_are_refused(tmp_path):
    values = np.array([[0, 65535, 25700]], dtype=np.int32)
    path = save(Image.fromarray(values), tmp_path / "i.tif")
    for beyond in (65536, -1):
        values[0, 0] = beyond
        with pytest.raises(ImageError, match="expected 0 to 65535"):
            read_image(save(Image.fromarray(values), tmp_path / "beyond.tif"))
    np.testing.assert_array_equal(read_image(path), as_rgb(np.array([[0, 255, 100]])))
    with pytest.raises(ImageError, match="floating-point"):
        read_image(save(Image.fromarray(np.ones((4, 4), np.float32)), tmp_path / "f.tif"))


def test_colours_that_are_not_rgb(tmp_path):
    cmyk = Image.new("CMYK", (32, 32), (0, 255, 255, 0))
    np.testing.assert_array_equal(read_image(save(cmyk, tmp_path / "a.tif"))[0, 0], (255, 0, 0))
    # Adobe's CMYK JPEG stores inverted levels.
    np.testing.assert_allclose(read_image(save(cmyk, tmp_path / "a.jpg", quality=95))[16, 16], (255, 0, 0), atol=3)
    red = Image.new("RGB", (16, 16), (200, 30, 60))
    np.testing.assert_allclose(read_image(save(red.convert("YCbCr"), tmp_path / "y.tif"))[8, 8], (200, 30, 60), atol=2)


UPRIGHT_FROM_STORED = {
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a.swapaxes(0, 1), 2),
    8: np.rot90,
}


@pytest.mark.parametrize("orientation", UPRIGHT_FROM_STORED)
@pytest.mark.parametrize("name", ["a.png", "grey8.tif", "grey16.tif"])
def test_exif_orientation(tmp_path, orientation, name):
    exif = Image.Exif()
    exif[0x0112] = orientation
    grey = levels(5, 7)  # Pillow would memory-map this one
    values, stored = {
        "a.png": (levels(5, 7, 3), levels(5, 7, 3)),
        "grey8.tif": (grey, as_rgb(grey)),
        "grey16.tif": (grey.astype(np.uint16) * 257, as_rgb(grey)),
    }[name]
    read = read_image(save(Image.fromarray(values), tmp_path / name, exif=exif))
    np.testing.assert_array_equal(read, UPRIGHT_FROM_STORED[orientation](stored))
    assert read.flags.c_contiguous


def png(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("width", "height"), [(int(MAX_PIXELS**0.5) + 1,) * 2, (65536, 65536), (0, 5), (0, 0)])
def test_too_many_pixels_and_none_are_refused_before_decoding(tmp_path, monkeypatch, width, height):
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda _: pytest.fail("was decoded"))
    path = tmp_path / "large.png"
    path.write_bytes(png(width, height))
    tracemalloc.start()
    for read in (read_image, stored_size):
        with pytest.raises(ImageError):
            read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2e6


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_truncated_files_are_refused(tmp_path, name):
    options = {"a.jpg": {"progressive": True}, "a.tif": {"compression": "tiff_deflate"}}.get(name, {})
    path = save(Image.fromarray(levels(64, 64, 3)), tmp_path / name, **options)
    whole = path.read_bytes()
    for part in (0.0, 0.02, 0.3, 0.6, 0.9):
        path.write_bytes(whole[: int(len(whole) * part)])
        with pytest.raises(ImageError):
            read_image(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("no image", "not an image"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:12\nsize 3\n", "is a Git LFS pointer"),
        # Pillow would start Ghostscript for this one.
        ("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n", "not an image"),
        (None, "No such file"),
    ],
)
def test_what_is_no_image_is_refused_with_a_reason(tmp_path, text, reason):
    path = tmp_path / "text.jpg"
    if text is not None:
        path.write_text(text)
    for read in (read_image, stored_size):
        with pytest.raises(ImageError, match=reason) as caught:
            read(path)
        assert caught.value.path == path
        assert isinstance(caught.value, ReadError)
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301  # our own bytes


@settings(max_examples=50, suppress_health_check=list(HealthCheck))
@given(
    name=st.sampled_from(["a.png", "a.jpg", "a.tif", "a.gif", "a.bmp", "a.webp"]),
    edits=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=6),
)
def test_damaged_bytes_give_pixels_or_an_image_error(tmp_path, name, edits):
    path = save(Image.fromarray(levels(24, 24, 3)), tmp_path / name)
    data = bytearray(path.read_bytes())
    for at, value in edits:
        data[int(at * len(data))] = value
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read = read_image(path)
        except ImageError as error:
            assert error.reason  # noqa: PT017  # either outcome is right
        else:
            assert (read.dtype, read.shape[2]) == (np.uint8, 3)


def test_find_images_in_files_folders_and_globs(tmp_path, monkeypatch):
    names = ["b.PNG", "a.jpg", "below/deep/c.tif", "below/d.webp", "notes.txt", "below/disparity.pfm", "x.eps"]
    for name in [*names, "odd [1]/e.png", ".hidden/f.png"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "link.jpg").symlink_to(tmp_path / "a.jpg")
    (tmp_path / "broken.jpg").symlink_to(tmp_path / "nothing")
    (tmp_path / "below" / "loop").symlink_to(tmp_path / "below")

    def relative(*sources):
        return [path.resolve().relative_to(tmp_path).as_posix() for path in find_images(sources)]

    every = ["a.jpg", "b.PNG", "below/d.webp", "below/deep/c.tif", "odd [1]/e.png"]
    assert relative(tmp_path) == [".hidden/f.png", *every]
    assert relative(tmp_path / "**/*.[!x]*", tmp_path / "a.jpg", tmp_path / "odd [1]") == every
    assert relative(str(tmp_path / "**/*.tif"), str(tmp_path / "*.PNG")) == ["b.PNG", "below/deep/c.tif"]
    assert relative(tmp_path / "odd [1]") == ["odd [1]/e.png"]
    assert relative(tmp_path / "notes.txt") == ["notes.txt"]  # users may name any file by its full name
    assert not {".eps", ".h5", ".mpg", ".pfm", ".pdf", ".txt"} & image_extensions()
    monkeypatch.setenv("HOME", str(tmp_path))
    assert relative("~/a.jpg") == ["a.jpg"]
    monkeypatch.chdir(tmp_path)
    assert relative(".") == relative("~") == [".hidden/f.png", *every]
    assert find_files(["below"], (".pfm",)) == [Path("below/disparity.pfm")]
    (tmp_path / "empty").mkdir()
    for source in ("absent.png", "absent/**/*.jpg", "empty", "empty/*"):
        with pytest.raises(InputError, match="expected an image file") as caught:
            find_images([source])
        assert source in str(caught.value)
