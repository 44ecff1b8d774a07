"""Makes the pictures of the service's page in docs/images, with the shipped model and its own example photos.

    zoedepth serve --port 8000 &
    python scripts/page_pictures.py [--browser chromium] [--url http://127.0.0.1:8000/]

serve.webp        a room with pins, one of them calibrated
serve-3d.webp     the surface of a cup, turned
serve-dark.webp   a cup, with another lens, in a dark scheme
serve-phone.webp  the same page 360 pixels wide
"""

import argparse
import io
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from zoedepth.synthetic.dataset import make_picture

IMAGES = Path(__file__).parent.parent / "docs" / "images"
QUALITY = 82
ROOM_SEED, ROOM_SIZE = 2, (720, 960)
"""The room of examples/room.jpg, whose true depth is known."""
PINS = ((690, 300), (830, 480), (330, 470))
"""Columns and rows: a bookshelf, a cushion, the back of a chair."""


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--browser", default="chromium", help="Chromium or Chrome")
    parser.add_argument("--url", default="http://127.0.0.1:8000/", help="where the service is")
    options = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which(options.browser),
            args=["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"],
        )
        room(browser, options.url)
        surface(browser, options.url)
        dark(browser, options.url)
        phone(browser, options.url)
        browser.close()


def room(browser: Browser, url: str) -> None:
    """A room with pins, one of them calibrated with its true depth."""
    _, depth, _ = make_picture("indoor", ROOM_SIZE, np.random.default_rng(ROOM_SEED))
    page = open_example(browser, url, "room")
    stage = page.locator("#stage").bounding_box()
    assert stage
    scale = min(stage["width"] / ROOM_SIZE[1], stage["height"] / ROOM_SIZE[0])
    left, top = (stage["width"] - ROOM_SIZE[1] * scale) / 2, (stage["height"] - ROOM_SIZE[0] * scale) / 2
    for column, row in PINS:
        x, y = stage["x"] + left + (column + 0.5) * scale, stage["y"] + top + (row + 0.5) * scale
        page.mouse.click(x, y)
    for index, (column, row) in enumerate(PINS):
        page.fill(f'[data-field="measured-{index}"]', f"{depth[row, column]:.2f}")
    page.click("#calibrate")
    settled(page)
    page.mouse.move(stage["x"] + 0.72 * stage["width"], stage["y"] + 0.8 * stage["height"])
    save(page, "serve.webp")


def surface(browser: Browser, url: str) -> None:
    """The surface of a cup, turned."""
    page = open_example(browser, url, "coffee")
    page.click("#show-space")
    page.click("#show-surface")
    page.wait_for_selector("#extent:has-text('triangles')")
    turned(page)
    save(page, "serve-3d.webp")


def dark(browser: Browser, url: str) -> None:
    """A cup in a dark scheme, with another lens, and other colours."""
    page = open_example(browser, url, "coffee", is_dark=True)
    page.fill("#fov", "50")
    settled(page)
    page.select_option("#colormap", "turbo_r")
    stage = page.locator("#stage").bounding_box()
    assert stage
    page.mouse.move(stage["x"] + 0.62 * stage["width"], stage["y"] + 0.7 * stage["height"])
    save(page, "serve-dark.webp")


def phone(browser: Browser, url: str) -> None:
    """Three looks at the page of a phone, side by side."""
    shots = []
    page = new_page(browser, url, on_phone=True)
    shots.append(page.screenshot())
    page.tap('[data-example="examples/room.jpg"]')
    settled(page)
    stage = page.locator("#stage").bounding_box()
    assert stage
    for x, y in ((0.75, 0.45), (0.3, 0.62)):
        page.touchscreen.tap(stage["x"] + x * stage["width"], stage["y"] + y * stage["height"])
    shots.append(page.screenshot())
    page = new_page(browser, url, on_phone=True, is_dark=True)
    page.tap('[data-example="examples/coffee.jpg"]')
    settled(page)
    page.tap("#show-space")
    page.wait_for_selector("#extent:has-text('points')")
    turned(page)
    shots.append(page.screenshot())
    pictures = [Image.open(io.BytesIO(shot)).convert("RGB") for shot in shots]
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width * 3 + 80, height), (128, 128, 128))
    for place, picture in enumerate(pictures):
        sheet.paste(picture, (place * (width + 40), 0))
    sheet.save(IMAGES / "serve-phone.webp", quality=QUALITY)


def open_example(browser: Browser, url: str, name: str, *, is_dark: bool = False) -> Page:
    page = new_page(browser, url, is_dark=is_dark)
    page.click(f'[data-example="examples/{name}.jpg"]')
    settled(page)
    return page


def new_page(browser: Browser, url: str, *, on_phone: bool = False, is_dark: bool = False) -> Page:
    context = browser.new_context(
        viewport={"width": 360, "height": 740} if on_phone else {"width": 1280, "height": 800},
        device_scale_factor=1.5,
        is_mobile=on_phone,
        has_touch=on_phone,
        color_scheme="dark" if is_dark else "light",
    )
    page = context.new_page()
    page.set_default_timeout(180_000)
    page.goto(url)
    page.wait_for_selector("#model option", state="attached")
    return page


def settled(page: Page) -> None:
    page.wait_for_selector('#work[aria-busy="false"]')


def turned(page: Page) -> None:
    """Drag the scene a little to the side."""
    scene = page.locator("#scene").bounding_box()
    assert scene
    x, y = scene["x"] + scene["width"] / 2, scene["y"] + scene["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 0.09 * scene["height"], y + 0.07 * scene["height"], steps=4)
    page.mouse.up()
    page.mouse.wheel(0, 400)
    page.wait_for_timeout(1000)


def save(page: Page, name: str) -> None:
    page.wait_for_timeout(300)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    picture.save(IMAGES / name, quality=QUALITY)


if __name__ == "__main__":
    main()
