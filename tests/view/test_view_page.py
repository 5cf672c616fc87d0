"""The viewer and the page that needs no server, in a real browser; and what lies in that page."""

import base64
import gzip
import io
import json
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from hoi import record
from hoi.data import Plane, Run, State
from hoi.errors import InputError
from hoi.export.page import STEP, page, part_of, write_page
from hoi.gaussians import SH_C0
from hoi.render.cameras import FOV_Y, Camera, look_at, project
from hoi.render.replay import replay
from hoi.render.splats import Splats
from tests.browser import WEBGL, chromium, until
from tests.demo_run import SHIRT, make_run

FRAMES, WIDTH, HEIGHT = 8, 720, 480
EVIL = "</script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\">{{DATA}}"
WALL = Plane(np.array([0.0, 4.0, 0.0]), np.array([0.0, -1.0, 0.0]))


@pytest.fixture(scope="module")
def demo() -> tuple[Run, np.ndarray, np.ndarray]:
    run, points, colours = make_run(frames=FRAMES, points=4000, gaussians=800, particles=900, contact_frame=3.4)
    assert run.scene is not None
    return replace(run, scene=replace(run.scene, planes=(*run.scene.planes, WALL))), points, colours


@pytest.fixture(scope="module")
def file(demo, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "run.html"
    write_page(demo[0], path)
    return path


# --- what lies in the page -------------------------------------------------------------------------------------------


def opened_page(text: str) -> tuple[dict, bytes]:
    facts = re.search(r'id="facts">(.*?)</script>', text, re.S)
    data = re.search(r'id="data">(.*?)</script>', text, re.S)
    assert facts and data
    return json.loads(facts[1]), gzip.decompress(base64.b64decode(data[1]))


def test_the_page_holds_every_gaussian_of_every_frame(demo, file):
    facts, data = opened_page(file.read_text())
    shown, read = replay(demo[0]), io.BytesIO(data)

    def take(kind: str, *shape: int) -> np.ndarray:
        return np.frombuffer(read.read(int(np.prod(shape)) * np.dtype(kind).itemsize), kind).reshape(shape)

    assert facts["frames"] == FRAMES and [part["name"] for part in facts["parts"]] == ["person", "object"]
    for index, part in enumerate(facts["parts"]):
        count = part["count"]
        opacities, radii, origins = take("u1", count), take("<f4", count), take("<f4", FRAMES, 3)
        low, high = (take("u1", FRAMES, 3, count).astype(np.int64) for _ in range(2))
        places = np.cumsum(low + 256 * high, 0) % 65536
        factors = np.cumsum(take("u1", FRAMES, 6, count).astype(np.int64), 0).astype(np.uint8).view(np.int8)
        colours = np.cumsum(take("u1", FRAMES, 3, count).astype(np.int64), 0) % 256
        for frame in range(FRAMES):
            splats = shown.parts(frame)[index]
            means = origins[frame] + part["step"] * places[frame].T
            np.testing.assert_allclose(means, splats.means.numpy(), atol=0.51 * STEP)
            root = np.zeros((count, 3, 3))
            root[:, *np.tril_indices(3)] = factors[frame].T * radii[:, None] / 127
            sigma = splats.covariances.numpy()
            np.testing.assert_allclose(root @ root.transpose(0, 2, 1), sigma, atol=0.03 * sigma.max())
            np.testing.assert_allclose(opacities / 255, splats.opacities.numpy(), atol=1 / 255)
            rgb = (0.5 + SH_C0 * splats.sh[:, 0].numpy()).clip(0, 1)
            np.testing.assert_allclose(colours[frame].T / 255, rgb, atol=1 / 255)
    assert read.read() == b""


def test_rounding_of_far_flat_and_broken_gaussians():
    means = torch.tensor([[0.0, 0, 0], [60, 0, 0], [1, 2, 3], [4, 5, 6]])
    sigma = torch.diag(torch.tensor([1e-4, 1e-4, 0.0])).repeat(4, 1, 1)
    still = Splats(means, sigma, torch.ones(4), torch.zeros(4, 1, 3))
    broken = replace(still, means=means.clone())
    broken.means[3, 0] = float("nan")
    pale = replace(still, opacities=torch.tensor([1.0, float("nan"), 1, 1]))
    assert part_of([pale]).opacities.tolist() == [255, 0, 255, 255]
    part = part_of([still, broken])
    back = part.origins[:, None] + part.step * part.positions
    assert part.step == pytest.approx(60 / 65535) and part.opacities.tolist() == [255, 255, 255, 0]
    np.testing.assert_allclose(back[1, :3], means[:3], atol=0.51 * part.step)
    np.testing.assert_allclose(part.factors[0, 0] / 127 * part.radii[0], [0.01, 0, 0.01, 0, 0, 0], atol=1e-4)


def test_the_same_run_gives_the_same_page(demo, file):
    assert page(demo[0]) == file.read_text()


def test_nothing_is_fetched_and_nothing_of_the_record_is_markup(demo):
    run = demo[0]
    scene = replace(run.scene, name=EVIL, motion_prompt=EVIL)
    text = page(replace(run, scene=scene, plan=replace(run.plan, variant=EVIL), result={"outcome": EVIL}))
    assert "https:" not in text and "http:" not in text and "default-src 'none'" in text
    assert text.count("<script") == 3 and "<img" not in text
    facts, _ = opened_page(text)
    assert facts["prompt"] == facts["outcome"] == EVIL and facts["title"] == f"{EVIL} · {EVIL}"


def test_nothing_to_show(demo, tmp_path):
    with pytest.raises(InputError, match="neither a motion nor a trajectory"):
        write_page(replace(demo[0], scene=None, state=State()), tmp_path / "a.html")
    with pytest.raises(InputError, match="cannot write"):
        write_page(demo[0], tmp_path / "no folder" / "a.html")
    assert list(tmp_path.iterdir()) == []


# --- in the browser --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium(WIDTH, HEIGHT, WEBGL) as opened:
        screen = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
        opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        yield opened


def picture(browser) -> np.ndarray:
    """RGB in [0, 1], (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")) / 255


def reddish(image: np.ndarray) -> int:
    """Pixels of the colour of the person's shirt."""
    return int((abs(image - SHIRT).max(-1) < 0.12).sum())


def patch(image: np.ndarray, camera: Camera, point: np.ndarray) -> np.ndarray:
    """The 5 x 5 pixels around a point of the world, (25, 3)."""
    (x, y), _ = project(camera, point)
    return image[round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3].reshape(-1, 3)


@pytest.fixture
def shown(browser, file) -> Iterator:
    """The page without server, newly loaded; what it logs fails the test."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(file.as_uri())
    until(lambda: browser.execute_script("return document.getElementById('clock').textContent"), "the first frame")
    yield browser
    assert browser.get_log("browser") == []


def seek(browser, frame: int) -> None:
    browser.execute_script("const s = document.getElementById('frame'); s.value = arguments[0]; s.oninput();", frame)
    wanted = f"{frame / 20:.2f} s"
    until(lambda: browser.execute_script("return clock.textContent").startswith(wanted), f"frame {frame}")


def test_the_page_plays(shown):
    seen = set()
    until(lambda: len(seen.add(shown.execute_script("return clock.textContent.slice(0, 6)")) or seen) >= 4, "frames")
    assert shown.execute_script("return document.getElementById('play').textContent") == "Pause"
    shown.execute_script("document.getElementById('play').click()")
    time.sleep(0.1)
    still = shown.execute_script("return clock.textContent")
    time.sleep(0.3)
    assert shown.execute_script("return clock.textContent") == still
    assert shown.title == "kick_ball · full"


def test_the_page_shows_person_and_object(shown, demo, file):
    facts, _ = opened_page(file.read_text())
    trajectory = demo[0].state.trajectory
    assert trajectory is not None
    scale = min(HEIGHT, WIDTH / 1.5) / HEIGHT
    fov = 2 * np.arctan(np.tan(FOV_Y / 2) / scale)
    camera = look_at(facts["eye"], facts["target"], width=WIDTH, height=HEIGHT, fov_y=fov)
    shown.execute_script("document.getElementById('contact').click(); document.getElementById('trail').click()")
    seek(shown, 4)
    with_all = picture(shown)
    assert reddish(with_all) > 400
    ball = patch(with_all, camera, trajectory.com[4])
    assert abs(ball - ball.mean(1, keepdims=True)).max() < 0.08  # black and white
    shown.execute_script("document.getElementById('gaussians').click()")
    until(lambda: reddish(picture(shown)) == 0, "the person to go")
    empty = picture(shown)
    assert abs(patch(empty, camera, trajectory.com[4]) - ball).max() > 0.02
    person = patch(with_all, camera, np.array(facts["joints"][4]).reshape(24, 3)[6])
    assert abs(person - SHIRT).max() < 0.25
    shown.execute_script("document.getElementById('gaussians').click()")
    seek(shown, 7)
    assert abs(picture(shown) - with_all).max(-1).mean() > 0.003  # the kick goes on


@pytest.mark.parametrize("name", ["skeleton", "contact", "trail", "ground"])
def test_switches_of_the_page(shown, name):
    seek(shown, 6)
    before = picture(shown)[:380]
    shown.execute_script("document.getElementById(arguments[0]).click()", name)
    until(lambda: (abs(picture(shown)[:380] - before).max(-1) > 0.05).sum() > 20, "a change")


def test_the_page_can_be_turned_around(shown):
    from selenium.webdriver import ActionChains

    seek(shown, 2)
    before = picture(shown)
    canvas = shown.find_element("id", "view")
    ActionChains(shown).drag_and_drop_by_offset(canvas, 150, 20).perform()
    until(lambda: abs(picture(shown) - before).max(-1).mean() > 0.01, "another view")
    assert reddish(picture(shown)) > 300


def test_the_viewer_plays_in_the_browser(browser, demo, tmp_path):
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.view.viewer import of_records

    run, points, colours = demo
    record.write(run, tmp_path / "run.mcap", points, colours, plan_text="")
    viewer = of_records([tmp_path / "run.mcap"], port=0, playing=False)
    viewer.panel.switches["ground"].value = False  # an endless floor takes long without a GPU
    try:
        browser.get(f"http://localhost:{viewer.port}")
        until(lambda: len(viewer.server.get_clients()) == 1, "the browser")
        until(lambda: reddish(picture(browser)) > 300, "the person")
        viewer.draw(4)
        until(lambda: "0.20 s" in browser.find_element("tag name", "body").text, "frame 4")
        viewer.panel.switches["person"].value = False
        until(lambda: reddish(picture(browser)) == 0, "the person to go")
        viewer.panel.switches["person"].value = True
        until(lambda: reddish(picture(browser)) > 300, "the person")
        with_ball = picture(browser)
        viewer.panel.switches["object"].value = False
        until(lambda: abs(picture(browser) - with_ball).max(-1).sum() > 10, "the object to go")
        viewer.panel.toggle()
        seen = set()
        until(lambda: len(seen.add(viewer.panel.frame) or seen) > 3, "frames")
        text = browser.find_element("tag name", "body").text
        assert all(word in text for word in ("Pause", "speed", "skeleton", "plan", "losses"))
    finally:
        viewer.stop()
