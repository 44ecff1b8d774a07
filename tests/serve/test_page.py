"""The page of the service in a real browser, against the service itself.

What the page says is compared with what the API answers to a program, and what it draws with what it says: each pixel
of the photo has a colour of its own, so that a picture of the screen tells which pixel lies under the pointer.
"""

import io
import json
import re
from ast import literal_eval
from base64 import b64decode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np
import pytest
import trimesh
import uvicorn
from PIL import ExifTags, Image
from plyfile import PlyData
from tests import browsers
from tests.browsers import LONGEST, needs_browser
from tests.models import random_model

from zoedepth import read_depth, save_model
from zoedepth.colors import colorize
from zoedepth.config import ModelConfig
from zoedepth.serve.app import create_app
from zoedepth.serve.page_files import FOLDER, read_page
from zoedepth.serve.server import bind
from zoedepth.serve.settings import Settings

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Error, Page, Request, Route

WIDTH, HEIGHT = 96, 72


def photo() -> np.ndarray:
    """Return a picture whose pixels tell their own column (red) and row (green)."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([columns * 2, rows * 3, (rows // 9 + columns // 12) % 2 * 200], axis=-1).astype(np.uint8)


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, format="PNG")
    return file.getvalue()


PHOTO = png(photo())


@dataclass
class Service:
    """The service in a thread, and what it answers to a program."""

    url: str
    call: Any
    """Playwright's way to send requests without a browser."""

    def post(self, path: str, **parts: Any) -> Any:
        answer = self.call.post(self.url + path, multipart={"photo": PHOTO_PART, **parts})
        assert answer.ok, answer.text()
        return answer

    def arrays(self, query: str = "", **parts: Any) -> dict[str, np.ndarray]:
        with np.load(io.BytesIO(self.post(f"v1/depth?format=npz{query}", **parts).body())) as arrays:
            return dict(arrays)


PHOTO_PART = {"name": "pixels.png", "mimeType": "image/png", "buffer": PHOTO}


# EXIF orientation -> how a picture that is to be turned by it lies in the file.
STORED = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


def webp(image: np.ndarray, orientation: int, before: bytes, order: str) -> bytes:
    """Return a picture as a WebP that is to be turned by EXIF, whose bytes stand in an order, behind other ones."""
    exif = Image.Exif()
    exif.endian = order
    exif[ExifTags.Base.Make] = "a camera"
    exif[ExifTags.Base.Orientation] = orientation
    file = io.BytesIO()
    stored = Image.fromarray(image).transpose(STORED[orientation])
    stored.save(file, format="WEBP", lossless=True, exif=before + exif.tobytes().removeprefix(b"Exif\0\0"))
    return file.getvalue()


@dataclass
class Visit:
    """A look at the page, and everything that must not happen meanwhile."""

    page: "Page"
    hosts: set[str] = field(default_factory=set)
    complaints: list[str] = field(default_factory=list)

    def upload(self, name: str = "pixels.png", content: bytes = PHOTO) -> None:
        self.page.set_input_files("#choose", {"name": name, "mimeType": "image/png", "buffer": content})
        self.settled()

    def settled(self) -> None:
        """Wait until the page waits for nothing."""
        self.page.wait_for_selector('#work[aria-busy="false"]', state="attached")

    def waits_until(self, holds: Callable[[], bool]) -> None:
        """Wait until something holds that the browser tells, and fail where it never does."""
        end = monotonic() + LONGEST
        while not holds():
            assert monotonic() < end, "it has not come true"
            self.page.wait_for_timeout(10)

    @contextmanager
    def holds_depth(self) -> Iterator[list["Route"]]:
        """Hold back what is asked of depth, and hand out the requests as they come."""
        held: list[Route] = []
        self.page.route("**/v1/depth*", lambda route: held.append(route))
        try:
            yield held
        finally:
            self.page.unroute("**/v1/depth*")

    def text(self, selector: str) -> str:
        return self.page.locator(selector).first.inner_text()

    def stage(self) -> tuple[float, float, float, float]:
        box = self.page.locator("#stage").bounding_box()
        assert box
        return box["x"], box["y"], box["width"], box["height"]

    def places(self, *shares: tuple[float, float]) -> list[tuple[float, float]]:
        """Return places in the window, at shares of the width and the height of the stage."""
        left, top, width, height = self.stage()
        return [(left + x * width, top + y * height) for x, y in shares]

    def picture(self, selector: str = "#stage") -> np.ndarray:
        """Return what is on the screen, with nothing pointed at."""
        self.page.mouse.move(1, 1)
        return np.array(Image.open(io.BytesIO(self.page.locator(selector).screenshot())).convert("RGB"))

    def hover(self, place: tuple[float, float]) -> tuple[int, int]:
        """Point at a place of the window; return the column and the row that the page says."""
        self.page.mouse.move(*place)
        found = re.match(r"column (\d+), row (\d+)", self.text("#place"))
        assert found, self.text("#place")
        return int(found[1]), int(found[2])

    def split(self, share: float) -> None:
        """Show the photo on the left up to this share of the stage, and depth on the right."""
        self.page.fill("#splitter", str(round(1000 * share)))


@pytest.fixture(scope="module")
def service_url(tiny_config: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Serve a random model that knows its focal length, and puts far apart what it sees."""
    domains = tuple(replace(domain, focal_px=70.0) for domain in tiny_config.domains)
    model = random_model(replace(tiny_config, domains=domains))
    file = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    save_model(model, file)
    settings = Settings(models=(str(file),), threads=1)
    listener = bind("127.0.0.1", 0)
    server = uvicorn.Server(uvicorn.Config(create_app(settings), log_config=None))
    thread = Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    waits_until(lambda: server.started)
    yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
    server.should_exit = True
    thread.join(LONGEST)
    listener.close()


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    with browsers.browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def desktop(browser: "Browser") -> Iterator["Page"]:
    """A window that all tests share: a new one takes longer than a test."""
    context = browser.new_context(viewport={"width": 1000, "height": 640})
    yield context.new_page()
    context.close()


@pytest.fixture
def visit(desktop: "Page", service_url: str) -> Iterator[Visit]:
    yield from visited(desktop, service_url)


@pytest.fixture
def phone(browser: "Browser", service_url: str) -> Iterator[Visit]:
    context = browser.new_context(
        viewport={"width": 360, "height": 740}, device_scale_factor=2, is_mobile=True, has_touch=True
    )
    context.add_init_script(REFUSES_AR)
    yield from visited(context.new_page(), service_url)
    context.close()


@pytest.fixture
def in_room(browser: "Browser", service_url: str) -> Iterator[Visit]:
    """A phone that shows the room around by WebXR, as far as a script can be one."""
    context = browser.new_context(viewport={"width": 360, "height": 740})
    context.add_init_script(path=FAKE_ROOM)
    yield from visited(context.new_page(), service_url)
    context.close()


@pytest.fixture
def with_quick_look(browser: "Browser", service_url: str) -> Iterator[Visit]:
    """A browser that says it opens links in AR, as Safari on a phone does."""
    context = browser.new_context(viewport={"width": 360, "height": 740})
    context.add_init_script(KNOWS_AR)
    yield from visited(context.new_page(), service_url)
    context.close()


@pytest.fixture
def service(desktop: "Page", service_url: str) -> Service:
    return Service(service_url, desktop.request)


FAKE_ROOM = Path(__file__).parent / "fake_room.js"
KNOWS_AR = """
  const {supports} = DOMTokenList.prototype;
  DOMTokenList.prototype.supports = function (token) { return token === "ar" || supports.call(this, token); };
"""
REFUSES_AR = """
  window.asked = [];
  Object.defineProperty(navigator, "xr", {value: {
    isSessionSupported: async (mode) => mode === "immersive-ar",
    requestSession: async (mode) => { window.asked.push(mode); throw new Error("there is no room around"); },
  }});
"""


def visited(page: "Page", url: str) -> Iterator[Visit]:
    """Open the page, and see in the end that it asked this host alone and complained of nothing."""
    page.set_default_timeout(1000 * LONGEST)
    visit = Visit(page)

    def asked(request: "Request") -> None:
        if not request.url.startswith(("blob:", "data:")):
            visit.hosts.add(request.url.split("/")[2])

    def said(message: "ConsoleMessage") -> None:
        if message.type == "error":
            visit.complaints.append(message.text)

    def failed(error: "Error") -> None:
        visit.complaints.append(str(error))

    page.on("request", asked)
    page.on("console", said)
    page.on("pageerror", failed)
    page.goto(url)
    page.wait_for_selector("#model option", state="attached")
    yield visit
    page.remove_listener("request", asked)
    page.remove_listener("console", said)
    page.remove_listener("pageerror", failed)
    assert visit.hosts == {url.split("/")[2]}
    assert visit.complaints == []


def waits_until(holds: Callable[[], bool]) -> None:
    """Wait until something holds, and fail where it never does."""
    end = monotonic() + LONGEST
    while not holds():
        assert monotonic() < end, "it has not come true"
        sleep(0.01)


def shows_something(scene: np.ndarray) -> bool:
    """Return True where a good part of a scene is not background, and of several colours."""
    lit = (np.abs(scene.astype(int) - (20, 25, 26)).max(axis=-1) > 20).mean()
    return bool(lit > 0.15 and scene.reshape(-1, 3).std(axis=0).min() > 10)


def room_seen(visit: Visit) -> np.ndarray:
    """Return what is drawn over the room around: RGBA."""
    height, width, pixels = visit.page.evaluate("fakeRoom.look()")
    return np.frombuffer(b64decode(pixels), np.uint8).reshape(height, width, 4)[::-1]


def in_metres(text: str) -> float:
    """Return the first metres in a text."""
    found = re.search(r"([\d.]+) m\b", text)
    assert found, text
    return float(found[1])


def rounded_to(value: float) -> float:
    """Return how far a number may be from the text that the page writes of it: half of its last digit."""
    return 0.501 * (1e-3 if value < 1 else 1e-2 if value < 10 else 1e-1)


def clear(valid: np.ndarray) -> tuple[int, int]:
    """Return the column and row of a usable pixel, away from the borders."""
    rows, columns = np.nonzero(valid[20:-20, 20:-20])
    middle = len(rows) // 2
    return int(columns[middle]) + 20, int(rows[middle]) + 20


def window_place(visit: Visit, column: float, row: float) -> tuple[float, float]:
    """Return the place in the window of the middle of a pixel, while all of the photo is shown."""
    left, top, width, height = visit.stage()
    scale = min(width / WIDTH, height / HEIGHT)
    return (
        left + (width - WIDTH * scale) / 2 + (column + 0.5) * scale,
        top + (height - HEIGHT * scale) / 2 + (row + 0.5) * scale,
    )


def tapped(visit: Visit, place: tuple[float, float]) -> tuple[int, int]:
    """Tap on a place of the window; return the column and the row that the page says."""
    visit.page.touchscreen.tap(*place)
    found = re.match(r"column (\d+), row (\d+)", visit.text("#place"))
    assert found, visit.text("#place")
    return int(found[1]), int(found[2])


def pinch(visit: Visit, middle: tuple[float, float], *, from_apart: float, to_apart: float) -> None:
    """Move two fingers apart, or together, about a place of the window."""
    session = visit.page.context.new_cdp_session(visit.page)

    def touch(kind: str, apart: float | None) -> None:
        fingers = [] if apart is None else [-apart / 2, apart / 2]
        points = [{"x": middle[0] + aside, "y": middle[1], "id": i} for i, aside in enumerate(fingers)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", from_apart)
    for share in (0.25, 0.5, 0.75, 1.0):
        touch("touchMove", from_apart + share * (to_apart - from_apart))
    touch("touchEnd", None)


GIVES = """
  async ([kind, numbers]) => {
    const file = new File([new Uint8Array(numbers)], `${kind}.png`, {type: "image/png"}), data = new DataTransfer();
    data.items.add(file);
    document.body.dispatchEvent(kind === "paste"
      ? new ClipboardEvent("paste", {clipboardData: data, bubbles: true, cancelable: true})
      : new DragEvent("drop", {dataTransfer: data, bubbles: true, cancelable: true}));
  }
"""
"""Drops or pastes a file."""


@needs_browser
class TestPage:
    def test_reads_what_is_under_the_pointer_at_three_zooms(self, visit: Visit, service: Service) -> None:
        visit.upload()
        arrays = service.arrays()
        depth, valid = arrays["depth"], arrays["valid"]
        near, far = (float(round(value, 3)) for value in np.quantile(depth, (0.1, 0.9)))
        visit.page.fill("#near", str(near))
        visit.page.fill("#far", str(far))
        colors = colorize(depth, vmin=near, vmax=far)
        sizes, n_compared = [], 0
        for zoom in (1.0, 2.5, 6.0):
            if zoom > 1:
                [(x, y)] = visit.places((0.45, 0.4))
                visit.page.mouse.move(x, y)
                before = visit.hover((x, y))
                visit.page.mouse.wheel(0, -500 * np.log(zoom / sizes[-1][0]))
                assert visit.hover((x, y)) == before, "what was under the pointer stays there"
            visit.split(1)
            photographed = visit.picture()
            visit.split(0)
            colored = visit.picture()
            places = [(0.31, 0.22), (0.47, 0.83), (0.52, 0.4), (0.66, 0.61)]
            pixels = []
            for share, place in zip(places, visit.places(*places), strict=True):
                column, row = visit.hover(place)
                pixels.append((column, row))
                # The pixel of the screen under the pointer: a screenshot has one for each CSS pixel here.
                left, top, *_ = visit.stage()
                y, x = int(place[1] - round(top)), int(place[0] - round(left))
                assert tuple(photographed[y, x, :2] // (2, 3)) == (column, row), share
                if valid[row, column]:
                    n_compared += 1
                    assert in_metres(visit.text("#value")) == pytest.approx(
                        depth[row, column], abs=rounded_to(depth[row, column])
                    )
                    assert np.abs(colored[y, x].astype(int) - colors[row, column]).max() <= 6
                else:
                    assert "no depth" in visit.text("#value")
                    assert colored[y, x, 0] in (116, 172)
            columns = [column for column, _ in pixels]
            sizes.append((zoom, max(columns) - min(columns)))
            if zoom == 1:  # so long is a metre at the depth of the last pixel
                ruler = re.match(r"(\d+) (m|cm|mm) across", visit.text("#ruler"))
                bar = visit.page.locator("#ruler b").bounding_box()
                assert ruler
                assert bar
                length = int(ruler[1]) * {"m": 1, "cm": 0.01, "mm": 0.001}[ruler[2]]
                _, _, width, height = visit.stage()
                pixels_across = bar["width"] / min(width / WIDTH, height / HEIGHT)
                away = depth[pixels[-1][1], pixels[-1][0]] if valid[pixels[-1][1], pixels[-1][0]] else np.median(depth)
                assert length == pytest.approx(pixels_across * away / arrays["intrinsics"][0, 0], rel=0.03)
        spans = [span for _, span in sizes]
        assert spans[0] > 1.8 * spans[1] > 3 * spans[2] > 0, "it was enlarged"
        assert n_compared > 0, "no place had a depth to rely on"

    def test_pins_tell_distances_and_calibrate(self, visit: Visit, service: Service) -> None:
        visit.upload()
        arrays = service.arrays()
        one = clear(arrays["valid"])
        inner = np.where(arrays["valid"], np.abs(np.log(arrays["depth"] / arrays["depth"][one[1], one[0]])), 0)[
            9:-9, 9:-9
        ]
        row, column = np.unravel_index(inner.argmax(), inner.shape)  # much nearer or farther
        other = (int(column) + 9, int(row) + 9)
        for place in (one, other):
            visit.page.mouse.click(*window_place(visit, *place))
        measured = service.post("v1/measure", points=json.dumps([one, other]), pairs=json.dumps([[one, other]])).json()
        rows = visit.page.locator("#pins li").all_inner_texts()
        told = [measured["points"][0]["depth"], measured["pairs"][0]["distance"], measured["points"][1]["depth"]]
        for row, value in zip(rows, told, strict=True):
            assert in_metres(row) == pytest.approx(value, abs=rounded_to(value))
        assert f"column {one[0]}, row {one[1]}" in rows[0]
        assert "a guess" in rows[1], "the distance says who knows the camera"

        true = 1.7 * told[0]
        visit.page.fill('[data-field="measured-0"]', f"{true:.3f}")
        visit.page.click("#calibrate")
        visit.settled()
        readings = json.dumps([[*one, round(true, 3)]])
        calibration = service.post("v1/calibrate", readings=readings).json()
        part = {"name": "c.json", "mimeType": "application/json", "buffer": json.dumps(calibration).encode()}
        depth = service.arrays(calibration=part)["depth"]
        assert calibration["calibration"]["scale"] > 1.1
        assert in_metres(visit.text("#pins li")) == pytest.approx(
            depth[one[1], one[0]], abs=rounded_to(depth[one[1], one[0]])
        )
        text = visit.text("#calibrated-text")
        assert f"times {calibration['calibration']['scale']:.3f}" in text
        assert f"within {round(100 * calibration['calibration']['expected_error'])} %" in text
        with visit.page.expect_download() as download:
            visit.page.click("#file-calibration")
        saved = json.loads(download.value.path().read_text(encoding="utf-8"))
        assert saved["calibration"]["scale"] == calibration["calibration"]["scale"]
        assert download.value.suggested_filename == "pixels_calibration.json"
        visit.page.click("#uncalibrate")
        visit.settled()
        assert in_metres(visit.text("#pins li")) == pytest.approx(told[0], abs=rounded_to(told[0]))

    def test_another_photo_drops_all_that_was_asked_of_the_one_before(self, visit: Visit, service: Service) -> None:
        other = png(photo()[::-1].copy())
        with visit.holds_depth() as held:
            visit.page.set_input_files("#choose", {"name": "a.png", "mimeType": "image/png", "buffer": PHOTO})
            visit.waits_until(lambda: len(held) == 1)
            visit.page.click("#file-exr")
            visit.waits_until(lambda: len(held) == 2)
            visit.page.set_input_files("#choose", {"name": "b.png", "mimeType": "image/png", "buffer": other})
            visit.waits_until(lambda: len(held) == 3)
            assert [route.request.failure for route in held] == ["net::ERR_ABORTED", "net::ERR_ABORTED", None]
            held[2].continue_()
            visit.settled()
        arrays = service.arrays(photo={**PHOTO_PART, "buffer": other})
        column, row = clear(arrays["valid"])
        visit.page.mouse.click(*window_place(visit, column, row))
        value = arrays["depth"][row, column]
        assert in_metres(visit.text("#pins li")) == pytest.approx(value, abs=rounded_to(value))
        assert visit.text("#about").startswith("b.png")

    def test_new_photo_and_stop_drop_all_that_was_asked(self, visit: Visit) -> None:
        for button in ("#another", "#stop"):
            visit.upload()
            with visit.holds_depth() as held:
                visit.page.fill("#fov", "50")
                visit.waits_until(lambda: len(held) == 1)
                visit.page.click("#file-exr")
                visit.waits_until(lambda: len(held) == 2)
                visit.page.click(button)
                visit.settled()
                assert [route.request.failure for route in held] == ["net::ERR_ABORTED"] * 2

    def test_a_surface_of_an_earlier_camera_is_not_kept(self, visit: Visit) -> None:
        visit.upload()
        visit.page.click("#show-space")
        with visit.holds_depth() as held:
            visit.page.click("#show-surface")
            visit.waits_until(lambda: len(held) == 1)
            visit.page.click("#file-exr")
            visit.waits_until(lambda: len(held) == 2)
            visit.page.fill("#fov", "50")
            visit.waits_until(lambda: len(held) == 3)
            held[2].continue_()
            visit.waits_until(lambda: len(held) == 4)  # the surface again, of the new depth
            held[3].continue_()
            visit.page.wait_for_selector("#extent:has-text('triangles')")
            extent = visit.text("#extent")
            held[0].continue_()  # by now nobody waits for it
            visit.settled()
        visit.page.click("#show-cloud")
        visit.page.wait_for_selector("#extent:has-text('points')")
        visit.page.click("#show-surface")
        visit.page.wait_for_selector("#extent:has-text('triangles')")
        assert visit.text("#extent") == extent

    def test_stop_shows_what_was_answered_last(self, visit: Visit, service: Service, tmp_path: Path) -> None:
        def stops(action: Callable[[], Any]) -> None:
            """Stop what an action asks while depth is computed, and look again at the pins."""
            with visit.holds_depth() as held:
                action()
                visit.waits_until(lambda: len(held) == 1)
                visit.page.click("#stop")
                visit.settled()
            visit.page.mouse.click(*window_place(visit, other[0], other[1]))
            visit.page.click("[aria-label='Remove pin 2']")

        def said() -> tuple[Any, ...]:
            """Return what the page says of its metres, and the file of them."""
            with visit.page.expect_download() as download:
                visit.page.click("#file-exr")
            path = tmp_path / "depth.exr"
            download.value.save_as(path)
            visit.settled()
            shown = [visit.page.is_visible("#calibrated"), visit.page.locator("#calibrated-text").text_content()]
            fields = [visit.page.input_value(f"#{name}") for name in ("model", "domain", "fov", "focal", "fov-slider")]
            chosen = visit.page.evaluate("document.querySelector('[name=camera]:checked').value")
            pin = visit.page.locator("#pins li strong").all_inner_texts()
            return shown, fields, chosen, pin, visit.text("#camera-text"), read_depth(path).tolist()

        visit.upload()
        visit.page.evaluate("document.getElementById('model').append(new Option('another'))")
        one = clear(service.arrays()["valid"])
        other = (one[0] + 8, one[1])
        visit.page.mouse.click(*window_place(visit, *one))
        visit.page.fill('[data-field="measured-0"]', "2")
        plain = said()
        assert plain[0][0] is False
        stops(lambda: visit.page.click("#calibrate"))
        assert said() == plain
        visit.page.click("#calibrate")
        visit.settled()
        calibrated = said()
        assert calibrated[0][0] is True
        assert calibrated[3] != plain[3]
        stops(lambda: visit.page.click("#uncalibrate"))
        assert said() == calibrated
        visit.page.click("#uncalibrate")
        visit.settled()
        assert said()[3:] == plain[3:]
        plain = said()
        stops(lambda: visit.page.fill("#fov", "35"))
        assert said() == plain
        stops(lambda: visit.page.select_option("#model", "another"))
        assert said() == plain
        names = visit.page.locator("#domain option").all_inner_texts()
        assert len(names) > 2
        stops(lambda: visit.page.select_option("#domain", names[-1]))
        assert said() == plain

    def test_a_refusal_leaves_the_calibration_until_it_is_tried_again(self, visit: Visit) -> None:
        visit.upload()
        visit.page.mouse.click(*visit.places((0.5, 0.5))[0])
        visit.page.fill('[data-field="measured-0"]', "2")
        visit.page.click("#calibrate")
        visit.settled()
        before, metres = visit.text("#calibrated-text"), in_metres(visit.text("#pins li"))
        visit.page.fill('[data-field="measured-0"]', "4")
        busy = {"title": "The service is busy", "detail": "Wait.", "status": 429}
        visit.page.route("**/v1/depth*", lambda route: route.fulfill(status=429, json=busy))
        visit.page.click("#calibrate")
        visit.page.wait_for_selector("#retry")
        visit.settled()
        assert visit.text("#calibrated-text") == before
        with visit.page.expect_download() as download:
            visit.page.click("#file-calibration")
        saved = json.loads(download.value.path().read_text(encoding="utf-8"))
        assert f"times {saved['calibration']['scale']:.3f}" in before
        visit.page.unroute("**/v1/depth*")
        visit.page.click("#retry")
        visit.settled()
        assert visit.text("#calibrated-text") != before
        assert in_metres(visit.text("#pins li")) > metres
        assert len(visit.complaints) == 1, "browsers note what was refused"
        visit.complaints.clear()

    def test_try_again_asks_what_was_refused(self, visit: Visit, service: Service) -> None:
        visit.upload()
        focal = visit.page.input_value("#focal")
        busy = {"title": "The service is busy", "detail": "Wait.", "status": 503}
        visit.page.route("**/v1/depth*", lambda route: route.fulfill(status=503, json=busy))
        visit.page.fill("#fov", "35")
        visit.page.wait_for_selector("#retry")
        visit.settled()
        assert visit.page.input_value("#focal") == focal
        visit.page.unroute("**/v1/depth*")
        visit.page.click("#retry")
        visit.settled()
        assert float(visit.page.input_value("#focal")) == pytest.approx(
            service.arrays("&fov_x=35")["intrinsics"][0, 0], abs=0.06
        )
        assert len(visit.complaints) == 1, "browsers note what was refused"
        visit.complaints.clear()

    def test_turns_a_webp_as_the_service_does(self, visit: Visit, service: Service) -> None:
        visit.upload()
        visit.split(1)
        upright = visit.picture()
        depth = service.arrays()["depth"]
        for orientation in STORED:
            even = orientation % 2 == 0
            content = webp(photo(), orientation, b"Exif\0\0" if even else b"", "<" if orientation < 5 else ">")
            part = {"name": "turned.webp", "mimeType": "image/webp", "buffer": content}
            np.testing.assert_array_equal(service.arrays(photo=part)["depth"], depth)
            visit.upload(f"{orientation}.webp", content)
            visit.split(1)
            assert not visit.page.is_visible("#unshown")
            same = (visit.picture() == upright).all(axis=-1)
            assert same.mean() > 0.999, f"orientation {orientation}: {np.argwhere(~same)}"

    def test_shows_no_picture_over_depth_of_other_proportions(self, visit: Visit) -> None:
        visit.page.evaluate("""() => {
          const {createImageBitmap} = window;
          window.createImageBitmap = (blob) => createImageBitmap(blob, {resizeWidth: 72, resizeHeight: 96});
        }""")
        visit.upload()
        assert visit.page.is_visible("#unshown")
        assert not visit.page.is_visible("#splitter")
        assert f"{WIDTH} × {HEIGHT}" in visit.text("#about")

    def test_a_camera_changes_the_metres_at_once(self, visit: Visit, service: Service) -> None:
        visit.upload()
        assert "a guess" in visit.text("#camera-text")
        wide, narrow = service.arrays("&fov_x=80"), service.arrays("&fov_x=40")
        column, row = clear(wide["valid"] & narrow["valid"])
        visit.page.mouse.click(*window_place(visit, column, row))
        visit.page.fill("#fov", "80")
        visit.settled()
        assert "as you say" in visit.text("#camera-text")
        value = wide["depth"][row, column]
        assert in_metres(visit.text("#pins li")) == pytest.approx(value, abs=rounded_to(value))
        held: list[Any] = []
        visit.page.route("**/v1/depth*", lambda route: held.append(route))
        visit.page.fill("#fov", "40")
        value = narrow["depth"][row, column]
        assert value > 2 * wide["depth"][row, column]
        at_once = in_metres(visit.text("#pins li"))  # the service has not answered yet
        assert at_once == pytest.approx(value, abs=rounded_to(value))
        while not held:
            visit.page.wait_for_timeout(10)
        held[0].continue_()
        visit.page.unroute("**/v1/depth*")
        visit.settled()
        assert in_metres(visit.text("#pins li")) == at_once
        focal = WIDTH / 2 / np.tan(np.radians(20))
        assert float(visit.page.input_value("#focal")) == pytest.approx(focal, abs=0.06)

    def test_three_dimensions_show_points_and_a_surface(self, visit: Visit, service: Service) -> None:
        visit.upload()
        arrays = service.arrays()
        fx, cx = arrays["intrinsics"][0, [0, 2]]
        across = (np.arange(WIDTH) - cx) / fx * arrays["depth"]
        across = across[arrays["valid"]]
        for button, word in (("#show-space", "points"), ("#show-surface", "triangles")):
            visit.page.click(button)
            visit.page.wait_for_selector(f"#extent:has-text('{word}')")
            waits_until(lambda: shows_something(visit.picture("#scene")[60:-40]))  # the first frame may be empty
        found = re.search(r"([\d,]+) triangles; ([\d.]+) m wide", visit.text("#extent"))
        assert found
        assert int(found[1].replace(",", "")) > 1000
        assert float(found[2]) == pytest.approx(np.ptp(across), rel=0.02)
        # This device shows no room around: the page offers files for one that does.
        assert not visit.page.is_visible("#augmented")
        assert not visit.page.is_visible("#quick-look")
        assert "USDZ opens there on an iPhone" in visit.text("#room-elsewhere")

    def test_room_around_shows_the_scene_at_its_true_size(self, in_room: Visit, service: Service) -> None:
        in_room.upload()
        assert not in_room.page.is_visible("#room-elsewhere")
        in_room.page.click("#show-space")
        in_room.page.click("#show-surface")
        in_room.page.wait_for_selector("#extent:has-text('triangles')")
        wide, high, deep = (float(length) for length in re.findall(r"([\d.]+) m ", in_room.text("#extent")))
        in_room.page.evaluate("Object.assign(fakeRoom, {place: [0.3, -0.1, 0.2], yaw: 0.7})")
        in_room.page.click("#augmented")
        in_room.page.wait_for_selector("#room-hint:has-text('Tap the floor')")
        assert in_room.page.evaluate("fakeRoom.asked") == [["immersive-ar", ["hit-test", "dom-overlay"], "room"]]

        # First the camera of the photo is where the phone is, and looks where the phone looks.
        first = room_seen(in_room)
        (fx, _, cx), (_, fy, cy), _ = service.arrays()["intrinsics"]
        rows, columns = np.nonzero(first[..., 3] == 255)
        assert len(rows) > 0.3 * first[..., 3].size
        focal = in_room.page.evaluate("fakeRoom.focal")
        height, width = first.shape[:2]
        photographed = (columns + 0.5 - width / 2) / focal * fx + cx, (rows + 0.5 - height / 2) / focal * fy + cy
        told = first[rows, columns, 0] / 2, first[rows, columns, 1] / 3  # by the colours of the photo
        assert np.median(np.abs(np.subtract(told, photographed)), axis=1).max() < 1.5

        # A tap puts its foot there. From far away, by a long lens, everything of it is as far.
        far, focal = 200, 200 * min(100 / wide, 130 / high)
        in_room.page.evaluate(
            "values => Object.assign(fakeRoom, values)",
            {"place": [0, 0, 0], "yaw": 0, "focal": focal, "surface": [0, -high / 2, -far]},
        )
        in_room.page.evaluate("fakeRoom.tap()")
        rows, columns = np.nonzero(room_seen(in_room)[..., 3])
        for places, length, middle in ((rows, high, height / 2), (columns, wide, width / 2)):
            rounding = 0.03 + deep / far
            assert np.ptp(places) + 1 == pytest.approx(length * focal / far, rel=rounding, abs=2)
            assert (places.min() + places.max() + 1) / 2 == pytest.approx(
                middle, abs=2 + rounding * length * focal / far
            )

        in_room.page.evaluate("fakeRoom.surface = null")
        in_room.page.evaluate("fakeRoom.tap()")
        assert "No surface is known" in in_room.text("#room-hint")
        in_room.page.evaluate("Object.assign(fakeRoom, {place: [2, 0, 5], yaw: -2, focal: 150})")
        in_room.page.click("#room-again")
        np.testing.assert_allclose(room_seen(in_room).astype(int), first, atol=2)
        in_room.page.click("#room-leave")
        assert in_room.page.evaluate("fakeRoom.session") is None
        assert not in_room.page.is_visible("#room")
        waits_until(lambda: shows_something(in_room.picture("#scene")[60:-40]))

    def test_quick_look_gets_the_surface(self, with_quick_look: Visit, service: Service) -> None:
        visit = with_quick_look
        visit.upload()
        assert not visit.page.is_visible("#room-elsewhere")
        visit.page.click("#show-space")
        with visit.page.expect_download() as download:
            visit.page.click("#augmented")
        content = download.value.path().read_bytes()
        assert download.value.suggested_filename == "pixels.usdz"
        assert content == service.post("v1/depth?format=usdz&max_triangles=150000").body()
        link = "document.getElementById('quick-look')"
        assert visit.page.is_visible("#quick-look")
        assert visit.page.get_attribute("#quick-look", "rel") == "ar"
        assert visit.page.evaluate(f"[...{link}.children].map((part) => part.tagName)") == ["IMG"], "as Safari asks for"
        href = visit.page.evaluate(f"{link}.href")
        assert re.fullmatch(r"blob:.*#allowsContentScaling=0", href)
        kind = visit.page.evaluate("(url) => fetch(url).then((answer) => answer.blob()).then(({type}) => type)", href)
        assert kind == "model/vnd.usdz+zip"
        visit.page.fill("#fov", "50")
        visit.settled()
        assert not visit.page.is_visible("#quick-look"), "it is of another depth"
        assert visit.page.is_visible("#augmented")

    def test_downloads_hold_the_same_depth(self, visit: Visit, service: Service, tmp_path: Path) -> None:
        visit.upload()
        arrays = service.arrays()
        depth, valid = arrays["depth"], arrays["valid"]
        matrix = arrays["intrinsics"]

        def download(name: str) -> Path:
            with visit.page.expect_download() as download:
                visit.page.click(f"#file-{name}")
            path = tmp_path / download.value.suggested_filename
            download.value.save_as(path)
            visit.settled()
            return path

        def check_points(points: np.ndarray) -> None:
            """Points in the axes of the camera lie at the depth of the pixels that see them."""
            x, y, z = points.T
            columns, rows = (x / z * matrix[0, 0] + matrix[0, 2]), (y / z * matrix[1, 1] + matrix[1, 2])
            at = np.rint(rows).astype(int), np.rint(columns).astype(int)
            assert np.abs(columns - at[1]).max() < 0.01
            assert valid[at].all()
            np.testing.assert_allclose(z, depth[at], rtol=1e-5)

        np.testing.assert_allclose(read_depth(download("png")), depth, atol=0.0005001)
        np.testing.assert_array_equal(read_depth(download("exr")), depth)
        np.testing.assert_array_equal(read_depth(download("npz")), depth)
        vertices = PlyData.read(download("ply"))["vertex"]
        assert len(vertices["x"]) == valid.sum()
        check_points(np.stack([vertices[axis] for axis in "xyz"], axis=-1).astype(np.float64))
        (surface,) = trimesh.load(download("glb"), process=False).geometry.values()
        assert len(surface.faces) > 1000
        check_points(np.asarray(surface.vertices, np.float64) * (1, -1, -1))
        with ZipFile(download("usdz")) as archive:
            points = re.search(r"point3f\[\] points = (\[.*?\])", archive.read("photo.usda").decode())
        assert points
        np.testing.assert_allclose(literal_eval(points[1]), surface.vertices, atol=1e-6)
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            "pixels.exr", "pixels.glb", "pixels.npz", "pixels.ply", "pixels.usdz", "pixels_depth.png",
        ]  # fmt: skip

    def test_works_on_a_phone(self, phone: Visit, service: Service) -> None:
        phone.upload()
        arrays = service.arrays()
        column, row = clear(arrays["valid"])
        phone.page.touchscreen.tap(*window_place(phone, column, row))
        value = arrays["depth"][row, column]
        assert phone.text("#place").startswith(f"column {column}, row {row}")
        assert in_metres(phone.text("#value")) == pytest.approx(value, abs=rounded_to(value))
        assert in_metres(phone.text("#pins li")) == pytest.approx(value, abs=rounded_to(value))
        assert phone.page.evaluate("document.documentElement.scrollWidth") == 360
        [middle, aside] = phone.places((0.5, 0.5), (0.7, 0.5))
        before = [tapped(phone, place) for place in (middle, aside)]
        pinch(phone, middle, from_apart=80, to_apart=160)
        after = [tapped(phone, place) for place in (middle, aside)]
        assert after[0] == before[0], "what is between the fingers stays there"
        assert after[1][0] - after[0][0] == pytest.approx((before[1][0] - before[0][0]) / 2, abs=1)
        hidden = phone.page.evaluate(
            """[...document.querySelectorAll('button, select, input:not(.unseen):not(#splitter)')].filter((part) => {
                 const box = part.getBoundingClientRect();
                 return part.checkVisibility() && (box.left < 0 || box.right > 360);
               }).map((part) => part.id)"""
        )
        assert hidden == []
        phone.page.tap("#show-space")
        phone.page.tap("#augmented")  # only where the browser says that it can
        phone.page.wait_for_selector("#problem:not([hidden])")
        assert "there is no room around" in phone.text("#problem")
        assert phone.page.evaluate("window.asked") == ["immersive-ar"]
        phone.page.tap("#another")
        assert phone.page.is_visible("label:has(#take)")

    def test_works_by_keyboard_and_for_a_screen_reader(self, visit: Visit, service: Service) -> None:
        visit.page.focus('[data-example="examples/coffee.jpg"]')
        visit.page.keyboard.press("Enter")
        visit.page.wait_for_selector('#work[aria-busy="false"]')
        visit.page.focus("#stage")
        visit.page.keyboard.press("ArrowRight")
        visit.page.keyboard.press("ArrowDown")
        place = visit.text("#place")
        visit.page.keyboard.press("Shift+ArrowRight")
        assert visit.text("#place") != place
        visit.page.keyboard.press("Enter")
        assert visit.page.locator("#pins li").count() == 1
        visit.page.keyboard.press("Delete")
        assert visit.page.locator("#pins li").count() == 0
        visit.page.keyboard.press("Enter")
        visit.page.keyboard.press("+")
        visit.page.keyboard.press("0")
        nameless = visit.page.evaluate(
            """[...document.querySelectorAll('button, select, input, canvas, [tabindex]')].filter((part) =>
                 part.checkVisibility() && !part.closest('[aria-hidden=true]') && !part.getAttribute('aria-label')
                 && !part.innerText?.trim() && ![...(part.labels ?? [])].some((label) => label.innerText.trim())
               ).map((part) => part.outerHTML)"""
        )
        assert nameless == []

    def test_says_what_is_wrong_with_a_file(self, visit: Visit, service: Service) -> None:
        bad = {
            "not an image": b"this is text, and no picture",
            "cut off": PHOTO[: len(PHOTO) // 2],
            "empty": b"",
        }
        for name, content in bad.items():
            part = {"name": name, "mimeType": "image/png", "buffer": content}
            said = service.call.post(service.url + "v1/depth", multipart={"photo": part})
            assert said.status in (400, 415, 422), name
            visit.upload(name, content)
            visit.page.wait_for_selector("#problem:not([hidden])")
            assert said.json()["title"] in visit.text("#problem"), name
            assert said.json()["detail"] in visit.text("#problem"), name
        visit.upload()
        assert not visit.page.is_visible("#problem"), "the next photo is not bothered"
        refused = [text for text in visit.complaints if "Failed to load resource" in text]  # browsers note each refusal
        assert len(refused) == len(bad)
        visit.complaints[:] = [text for text in visit.complaints if text not in refused]

    def test_a_file_that_is_no_photo_leaves_the_one_that_is_open(self, visit: Visit) -> None:
        visit.upload()
        visit.page.mouse.click(*window_place(visit, WIDTH // 2, HEIGHT // 2))
        pins = visit.text("#pins")
        assert in_metres(pins) > 0
        file = {"name": "report.pdf", "mimeType": "application/pdf", "buffer": b"%PDF-1.7"}
        visit.page.set_input_files("#choose", files=[file])
        visit.page.wait_for_selector("#problem:has-text('report.pdf is of the type application/pdf')")
        assert visit.text("#pins") == pins
        assert f"{WIDTH} × {HEIGHT}" in visit.text("#about")

    def test_says_which_fields_of_view_there_are(self, visit: Visit) -> None:
        visit.upload()
        visit.page.fill("#fov", "170")
        visit.page.press("#fov", "Tab")
        assert visit.page.eval_on_selector("#fov", "field => field.validationMessage") == (
            "A field of view has from 2.8 to 160 degrees."
        )
        visit.page.fill("#fov", "70.25")
        visit.page.press("#fov", "Tab")
        assert not visit.page.eval_on_selector("#fov", "field => field.validity.customError")

    def test_paints_over_what_the_model_is_unsure_of(self, visit: Visit, service: Service) -> None:
        visit.upload()
        arrays = service.arrays()
        confidence = np.where(arrays["valid"], arrays["confidence"], np.nan)
        visit.split(0)
        visit.page.check("#confidence")
        assert visit.page.is_visible("#unsure-chip")
        picture = visit.picture().astype(int)
        left, top, *_ = visit.stage()
        colors = []
        for index in (np.nanargmin(confidence), np.nanargmax(confidence)):
            row, column = np.unravel_index(index, confidence.shape)
            x, y = window_place(visit, column, row)
            colors.append(picture[int(y - round(top)), int(x - round(left))])
        # Turquoise where it is least sure, and the map's own colour, which has little of it, where it is most.
        assert np.abs(colors[0] - (0, 214, 200)).max() < 30
        assert np.abs(colors[1] - (0, 214, 200)).max() > 100

    def test_takes_photos_by_drop_and_paste(self, visit: Visit) -> None:
        for kind in ("drop", "paste"):
            visit.page.evaluate(GIVES, [kind, list(PHOTO)])
            visit.page.wait_for_selector(f"#about:has-text('{kind}.png, {WIDTH} × {HEIGHT}')", state="attached")
            visit.settled()

    def test_tries_again_to_begin(self, visit: Visit) -> None:
        busy = {"title": "The service is busy", "detail": "Wait.", "status": 503}
        visit.page.route("**/v1/models", lambda route: route.fulfill(status=503, json=busy))
        visit.page.reload()
        visit.page.wait_for_selector("#retry")
        visit.page.unroute("**/v1/models")
        visit.page.click("#retry")
        visit.page.wait_for_selector("#model option", state="attached")
        assert not visit.page.is_visible("#problem")
        assert len(visit.complaints) == 1, "browsers note what was refused"
        visit.complaints.clear()

    def test_asks_for_the_token_and_says_when_nobody_answers(self, visit: Visit) -> None:
        def guard(route: "Route") -> None:
            if route.request.headers.get("authorization") == "Bearer of the tests":
                route.fallback()
            else:
                problem = {"title": "The service asks for a token", "detail": "Give it.", "status": 401}
                route.fulfill(status=401, json=problem)

        visit.page.route("**/v1/*", guard)
        visit.page.reload()
        visit.page.fill("#token", "of the tests")
        visit.page.keyboard.press("Enter")
        visit.page.wait_for_selector("#token-form", state="hidden")
        visit.page.wait_for_selector("#model option", state="attached")
        visit.page.route("**/v1/depth*", lambda route: route.abort())
        visit.upload()
        assert "The service does not answer" in visit.text("#problem")
        visit.page.unroute("**/v1/depth*")
        visit.page.click("#retry")
        visit.settled()
        assert f"{WIDTH} × {HEIGHT}" in visit.text("#about")
        assert not visit.page.is_visible("#problem")
        visit.page.unroute("**/v1/*")
        assert len(visit.complaints) == 2, "browsers note what was refused"
        visit.complaints.clear()

    def test_says_the_same_call_for_programs(self, visit: Visit, service: Service) -> None:
        visit.upload("a photo's.png")
        visit.page.fill("#fov", "50")
        visit.settled()
        visit.page.click("summary")
        curl = visit.text("#code")
        assert "fov_x=50" in curl
        assert f"{service.url}v1/depth?" in curl
        visit.page.click("#show-python")
        names: dict[str, Any] = {}
        program = visit.text("#code")
        compile(program, "code", "exec")
        exec(program[program.index("    params=") :].split("\n")[0].strip().rstrip(","), names)
        assert names["params"] == {"model": "tiny", "fov_x": "50", "format": "npz"}
        assert 'open("a photo\'s.png", "rb")' in program


class TestFiles:
    def test_holds_no_script_or_style_of_its_own_and_no_address_of_others(self) -> None:
        for path in FOLDER.rglob("*"):
            if path.suffix in (".html", ".js", ".css", ".svg"):
                text = path.read_text(encoding="utf-8")
                foreign = set(re.findall(r"https?://[\w.-]+", text)) - {"http://www.w3.org"}
                assert not foreign, path.name
        html = (FOLDER / "index.html").read_text(encoding="utf-8")
        assert not re.search(r"<style|\sstyle=|\son\w+=", html)
        assert all(re.fullmatch(r"\s*", inside) for inside in re.findall(r"<script[^>]*>(.*?)</script>", html, re.S))

    def test_refers_to_files_that_there_are(self) -> None:
        served, n_found = read_page(), 0
        for path in FOLDER.glob("*.*"):
            if path.suffix not in (".html", ".js"):
                continue
            text = path.read_text(encoding="utf-8")
            found = re.findall(
                r'(?:href|src|data-example|from|\.src =)[= ]?"\.?/?([\w./-]+\.(?:js|css|svg|jpg))"', text
            )
            n_found += len(found)
            for name in found:
                assert f"/{name}" in served, f"{path.name} wants {name}"
        assert n_found > 10
        assert b"three.js" in served["/three.min.js"].content[:100]

    def test_colors_depth_as_the_package_does(self) -> None:
        text = (FOLDER / "colormaps.js").read_text(encoding="utf-8")
        levels = np.arange(1, 257, dtype=np.float32)[None]
        for name in ("magma", "turbo", "Spectral"):
            found = re.search(rf"{name}:\s*((?:\"[0-9a-f]+\"[\s+]*)+),", text)
            assert found
            table = np.frombuffer(bytes.fromhex("".join(re.findall(r"[0-9a-f]{6,}", found[1]))), np.uint8).reshape(
                -1, 3
            )
            np.testing.assert_array_equal(table, colorize(levels, vmin=1, vmax=256, colormap=name)[0])
