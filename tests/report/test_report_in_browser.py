"""The report as a reader sees it, in a real browser that has no network to lean on."""

from dataclasses import replace

import pytest

from pipeline.report.data import FilmStrip
from stages.report import report

PAIRS = (("ink", "page"), ("ink", "card"), ("soft", "page"), ("soft", "card"), ("accent", "page"),
         ("good", "good-bg"), ("bad", "bad-bg"), ("open", "open-bg"))


@pytest.fixture
def opened(browser, tmp_path):
    """Opens a report at a width; any complaint or request of the page fails the test."""
    trouble, pages = [], []

    def open_(data, width=1280, scheme="light"):
        page = browser.new_page()
        pages.append(page)
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.on("console", lambda message: trouble.append(message.text))
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on("request", lambda asked: asked.url.startswith(("file:", "data:")) or trouble.append(asked.url))
        page.goto(report(data, tmp_path / "report.html").as_uri())
        return page

    yield open_
    for page in pages:
        page.close()
    assert not trouble


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_the_page_never_scrolls_sideways(loop, bare, opened, width):
    for data in (loop, bare):
        page = opened(data, width)
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_long_unbroken_text_does_not_widen_a_telephone(loop, opened):
    word = "x" * 300
    shown = replace(loop.hard_cases[0], strip=FilmStrip(loop.hard_cases[0].strip.image, (word,) * 5))
    page = opened(replace(loop, command=word, notes=(word,), software={word: word}, hard_cases=(shown,)), 390)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_every_film_strip_is_a_picture_that_decodes(loop, opened):
    sizes = opened(loop).evaluate("[...document.images].map((image) => [image.naturalWidth, image.naturalHeight])")
    assert sizes == [[800, 120]] * 16


def test_pointing_at_a_mark_or_a_curve_shows_its_values(loop, opened):
    page = opened(loop)
    page.locator("svg.dots").first.locator(".hit").last.hover()
    assert "generation" in page.locator("#tip").inner_text() and "%" in page.locator("#tip").inner_text()
    curve = page.locator("svg.curve", has=page.locator("polyline")).first
    curve.hover()
    text = page.locator("#tip").inner_text()
    assert text.count("generation") == 4 and len(text.splitlines()) == 5


def test_the_style_and_script_pass_the_pages_own_security_policy(loop, opened):
    page = opened(loop)
    assert page.evaluate("getComputedStyle(document.querySelector('.hero')).display") == "grid"
    assert page.locator("[data-copy]").is_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(bare, opened, scheme):
    page = opened(bare, scheme=scheme)
    colours = {name: page.evaluate("(n) => getComputedStyle(document.documentElement).getPropertyValue(n)", f"--{name}")
               for pair in PAIRS for name in pair}
    worst = min((contrast(colours[a], colours[b]), a, b) for a, b in PAIRS)
    assert worst[0] >= 4.5, worst


def contrast(a: str, b: str) -> float:
    """Source: WCAG 2.2, relative luminance and contrast ratio."""
    def luminance(colour: str) -> float:
        digits = colour.strip().lstrip("#")
        parts = [int(digits[k:k + 2], 16) / 255 for k in (0, 2, 4)]
        linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    dark, light = sorted((luminance(a), luminance(b)))
    return (light + 0.05) / (dark + 0.05)
