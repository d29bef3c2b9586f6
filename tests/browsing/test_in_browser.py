"""An episode as a person sees it: a real browser that draws in software, with no network to lean on."""

import json
import shutil
import signal
import time

import numpy as np
import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ARGUMENTS = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
             "--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run"]
PATIENCE_S = 240
"""A viewer that is drawn in software on a busy machine takes minutes; on an idle one 15 s."""

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no browser: apt-get install -y chromium")]


def pixels(png: bytes) -> np.ndarray:
    from io import BytesIO

    from PIL import Image
    return np.asarray(Image.open(BytesIO(png)).convert("RGB")).reshape(-1, 3).astype(int)


def near(image: np.ndarray, colour: tuple[int, int, int], within: int = 30) -> int:
    """Pixels that have about this colour."""
    return int((np.abs(image - np.array(colour)).max(axis=1) < within).sum())


def test_an_episode_is_drawn_with_robot_plots_and_lanes(shelf):
    from playwright.sync_api import sync_playwright

    process = shelf.start("--web", "--json", shelf.failure.id)
    elsewhere = []
    try:
        address = json.loads(process.stdout.readline())["address"]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=BROWSER, args=ARGUMENTS)
            page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
            page.add_init_script("console.debug = () => {}")  # the viewer says thousands of things
            page.on("request", lambda r: r.url.startswith((address, "data:", "blob:")) or elsewhere.append(r.url))
            page.goto(address)
            page.wait_for_selector("canvas", timeout=PATIENCE_S * 1000)
            image = _drawn(page)
            browser.close()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(240) == 0
    assert near(image, (204, 194, 178)) > 10_000, "the table"
    assert near(image, (212, 56, 61), 60) > 100, "the cube"
    assert near(image, (251, 146, 60), 40) > 300, "curves of commands"
    assert near(image, (96, 165, 250), 40) > 300, "curves of states"
    assert len(np.unique(image // 16, axis=0)) > 100, "many colours"
    assert not [url for url in elsewhere if "rerun.io" not in url and "github" not in url]


def _drawn(page) -> np.ndarray:
    """The page once table and curves are there, or as it is when patience ends."""
    ends = time.monotonic() + PATIENCE_S
    while True:
        page.wait_for_timeout(3000)
        image = pixels(page.screenshot(timeout=PATIENCE_S * 1000))
        if (near(image, (204, 194, 178)) > 10_000 and near(image, (251, 146, 60), 40) > 300) or time.monotonic() > ends:
            return image
