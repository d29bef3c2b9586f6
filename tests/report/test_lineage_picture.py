"""The picture of a lineage: boxes that do not overlap, arrows downwards, readable in light and dark."""

import re
import shutil
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.layers import GAP_X, lay_out
from pipeline.report.lineage import picture
from pipeline.store.graph import Graph, Node

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SVG = "{http://www.w3.org/2000/svg}"


def node(key, **how):
    known = {"kind": "episode", "ids": (key,), "title": key, "lines": ("x",)} | how
    return Node(key=key, **known)


def graph(*edges, focus="a", **how):
    keys = dict.fromkeys(k for e in edges for k in e)
    return Graph(tuple(node(k, focus=k == focus) for k in keys), tuple(edges), how.get("cut", False))


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)).filter(lambda e: e[0] != e[1]), max_size=30))
def test_boxes_never_overlap_and_arrows_lead_down(pairs):
    edges = list(dict.fromkeys((f"n{min(p)}", f"n{max(p)}") for p in pairs))
    keys = [f"n{k}" for k in range(13)]
    plan = lay_out(keys, edges, 100)
    assert sorted(k for row in plan.layers for k in row) == sorted(keys)
    for row in plan.layers:
        assert all(plan.x[b] - plan.x[a] >= 100 + GAP_X - 1e-6 for a, b in pairwise(row))
        assert all(50 - 1e-6 <= plan.x[k] <= plan.width - 50 + 1e-6 for k in row)
    for a, b in edges:
        assert plan.first[a] < plan.first[b]
        assert len(plan.ways[a, b]) == plan.first[b] - plan.first[a] + 1


def test_a_chain_stands_upright():
    plan = lay_out(list("abcd"), [("a", "b"), ("b", "c"), ("c", "d")], 100)
    assert np.ptp(list(plan.x.values())) < 1e-6


def test_a_circle_is_drawn_all_the_same():
    text = picture(graph(("a", "b"), ("b", "c"), ("c", "a")))
    assert len(ET.fromstring(text).findall(f"{SVG}path")) == 3


def test_words_of_others_stay_words():
    bad = Graph((node("a", focus=True, title="<script>alert(1)</script>", lines=("a & b",)),), (), False)
    root = ET.fromstring(picture(bad))
    assert not [e for e in root.iter() if e.tag.endswith("script")]
    assert "a & b" in [t.text for t in root.iter(f"{SVG}text")]


def test_it_says_what_is_grouped_what_is_wrong_and_that_there_is_more():
    saw = ("saw what was forgotten: 2",)
    many = Graph((node("a", focus=True, title="policy 12", kind="policy", lines=saw, bad=True),
                  node("b", ids=tuple(map(str, range(50))), title="50 demonstrations")), (("b", "a"),), True)
    text = picture(many)
    assert "there is more than is shown here" in text and "50 demonstrations" in text
    assert re.search('<rect class="box focus bad"', text) and 'class="behind"' in text
    assert "prefers-color-scheme:dark" in text and "http" not in text.replace("http://www.w3.org/2000/svg", "")


@pytest.fixture(scope="module")
def browser():
    if BROWSER is None:
        pytest.skip("no browser: sudo apt-get install -y chromium")
    from playwright.sync_api import sync_playwright
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=BROWSER,
                                             args=["--headless", "--no-sandbox", "--disable-gpu"])
        yield running
        running.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_shows_it_with_contrast(browser, scheme, tmp_path):
    (tmp_path / "why.svg").write_text(picture(graph(("a", "b"), ("a", "c"), ("b", "d"), ("c", "d"), ("a", "d"))))
    page = browser.new_page()
    page.emulate_media(color_scheme=scheme)
    page.goto((tmp_path / "why.svg").as_uri())
    ink, card = page.evaluate("""() => ['.title', '.box'].map(
        s => getComputedStyle(document.querySelector(s)).fill.match(/\\d+/g).map(Number))""")
    inside = page.evaluate("""() => [...document.querySelectorAll('g')].every(g => {
        const box = g.querySelector('.box').getBBox();
        return [...g.querySelectorAll('text')].every(t => t.getBBox().x + t.getBBox().width <= box.x + box.width)})""")
    page.close()
    assert abs(sum(ink) - sum(card)) > 400 and inside
