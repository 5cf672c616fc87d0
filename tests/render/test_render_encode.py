"""What is encoded is what was drawn: decoded again by PyAV, as an MP4 and as the access units of a record."""

import io
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.frame import PictureType
from PIL import Image

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.render.encode import check_size, encode, write_mp4, write_png

WIDTH, HEIGHT, FPS = 96, 64, 20.0
START = b"\0\0\0\1"


def pictures(count=30, width=WIDTH, height=HEIGHT):
    """A red square that moves by a pixel a picture over a grey that darkens to the right."""
    for index in range(count):
        picture = np.repeat(np.linspace(240, 160, width)[None, :, None], height, 0).repeat(3, 2).astype(np.uint8)
        picture[20:40, index : index + 20] = (200, 40, 30)
        yield picture


@pytest.fixture(scope="module")
def video():
    return encode(pictures(), FPS)


def decoded(source, **options):
    with av.open(source, "r", **options) as container:
        stream = container.streams.video[0]
        return stream, [frame.reformat(format="rgb24").to_ndarray() for frame in container.decode(stream)]


def nal_types(unit):
    return [part[0] & 31 for part in unit.replace(START, b"\0\0\1").split(b"\0\0\1")[1:]]


def test_mp4_shows_the_pictures(video, tmp_path):
    path = tmp_path / "run.mp4"
    write_mp4(video, path)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (WIDTH, HEIGHT, 20)
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        context = stream.codec_context
        assert (context.color_primaries, context.color_trc, context.colorspace, context.color_range) == (1, 1, 1, 1)
        frames = list(container.decode(stream))
        assert [frame.pts * frame.time_base for frame in frames] == [Fraction(i, 20) for i in range(30)]
        assert stream.duration * stream.time_base == Fraction(30, 20)
    for frame, picture in zip(frames, pictures(), strict=True):
        error = np.abs(frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray().astype(int) - picture)
        assert error.mean() < 2.5
        x = int(np.flatnonzero(picture[30, :, 1] == 40)[0])
        assert error[24:36, x + 4 : x + 16].max() < 12  # the square, away from its edges


def test_mp4_starts_with_its_index(video, tmp_path):
    write_mp4(video, tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    assert 0 < data.find(b"moov") < data.find(b"mdat")


def test_units_are_annex_b_one_a_picture(video):
    assert len(video) == 30 and all(unit.startswith((START, START[1:])) for unit in video.units)
    types = [nal_types(unit) for unit in video.units]
    slices = [[kind for kind in unit if kind in (1, 5)] for unit in types]
    assert all(len(unit) == 1 for unit in slices)
    keys = [index for index, unit in enumerate(types) if 5 in unit]
    assert keys[0] == 0
    assert max(np.diff(keys)) <= FPS  # at least one a second
    assert all({7, 8} <= set(types[index]) for index in keys)


def test_every_unit_is_decoded_at_once(video):
    """No picture waits for a later one: there are no B-frames."""
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    decoder.open()
    shown = []
    for unit in video.units:
        shown += decoder.decode(av.Packet(unit))
    assert len(shown) == len(video) and decoder.has_b_frames == 0
    assert all(PictureType(frame.pict_type).name in "IP" for frame in shown)


def test_a_viewer_can_start_at_any_key_frame(video):
    key = next(index for index in range(1, len(video)) if 5 in nal_types(video.units[index]))
    _, whole = decoded(io.BytesIO(b"".join(video.units)), format="h264")
    _, rest = decoded(io.BytesIO(b"".join(video.units[key:])), format="h264")
    assert len(rest) == len(video) - key
    np.testing.assert_array_equal(rest[3], whole[key + 3])


def test_the_same_pictures_give_the_same_bytes(video, tmp_path):
    again = encode(pictures(), FPS)
    assert again == video
    for name in ("a.mp4", "b.mp4"):
        write_mp4(video, tmp_path / name)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_grey_stays_grey(tmp_path):
    write_mp4(encode([np.full((32, 32, 3), 231, np.uint8)] * 3, FPS), tmp_path / "grey.mp4")
    _, frames = decoded(str(tmp_path / "grey.mp4"))
    assert np.ptp(frames[1].reshape(-1, 3), axis=1).max() == 0 and abs(int(frames[1][5, 5, 0]) - 231) <= 2


@pytest.mark.parametrize("fps, rate", [(20, 20), (29.97, Fraction(2997, 100)), (0.5, Fraction(1, 2)), (5.0, 5)])
def test_frame_rates(tmp_path, fps, rate):
    write_mp4(encode(pictures(4), fps), tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].average_rate == rate and container.streams.video[0].frames == 4


@pytest.mark.parametrize("count, size", [(1, (16, 16)), (2, (18, 34)), (3, (720, 480))])
def test_sizes(tmp_path, count, size):
    write_mp4(
        encode(pictures(count, *size) if size[0] > 60 else [np.zeros((*size[::-1], 3), np.uint8)] * count, 20),
        tmp_path / "a.mp4",
    )
    stream, frames = decoded(str(tmp_path / "a.mp4"))
    assert (stream.width, stream.height, len(frames)) == (*size, count)


@pytest.mark.parametrize("size", [(97, 64), (96, 63), (8, 8), (10000, 64)])
def test_sizes_that_cannot_be(size):
    with pytest.raises(InputError, match=f"size {size[0]}x{size[1]}: .* even numbers from 16 to 8192"):
        check_size(*size)
    if max(size) < 100:
        with pytest.raises(InputError, match="even numbers"):
            encode([np.zeros((*size[::-1], 3), np.uint8)], 20)


@pytest.mark.parametrize("fps", [0.0, -20.0, float("nan"), float("inf"), 1e6])
def test_rates_that_cannot_be(fps):
    with pytest.raises(InputError, match=r"0\.1 to 1000 are allowed"):
        encode(pictures(1), fps)


def test_pictures_that_do_not_go_together():
    with pytest.raises(ValueError, match="no pictures"):
        encode([], 20)
    with pytest.raises(ValueError, match="picture 1 is"):
        encode([np.zeros((32, 32, 3), np.uint8), np.zeros((32, 34, 3), np.uint8)], 20)
    with pytest.raises(ValueError, match="float64"):
        encode([np.zeros((32, 32, 3))], 20)


def test_png(tmp_path):
    picture = next(pictures(1))
    write_png(picture, tmp_path / "a.png")
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), picture)
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize(
    "write", [lambda path, video: write_mp4(video, path), lambda path, _: write_png(next(pictures(1)), path)]
)
def test_places_that_cannot_be_written_to(video, tmp_path, write):
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "none" / "a.mp4", tmp_path / "folder.mp4", tmp_path / "file" / "a.mp4"):
        with pytest.raises(InputError) as caught:
            write(path, video)
        assert str(caught.value).startswith(f"cannot write {path}: ") and "\n" not in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.mp4"]


def test_what_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")
    for failure in (KeyboardInterrupt, ZeroDivisionError):
        with pytest.raises(failure), whole_file(path) as part:
            part.write_bytes(b"half")
            raise failure
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["a.mp4"]


def test_a_full_disk_is_a_failed_run(tmp_path):
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from pathlib import Path
import numpy as np
from hoi.errors import RunError
from hoi.render.encode import encode, write_mp4, write_png
noise = [np.random.default_rng(i).integers(0, 256, (64, 96, 3), np.uint8) for i in range(20)]
video = encode(noise, 20)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
for write, thing, name in ((write_mp4, video, "a.mp4"), (write_png, noise[0], "a.png")):
    try:
        write(thing, Path({str(tmp_path)!r}) / name)
    except RunError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert "a.mp4: File too large; free some space" in first and "a.png: File too large" in second
    assert os.listdir(tmp_path) == []
