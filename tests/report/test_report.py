import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from pipeline.errors import ConfigError
from pipeline.report.data import FilmStrip, ReportData, ShownCase
from pipeline.report.text import duration, number, p_value, percent
from schemas.hardcase import HardCase
from schemas.recipe import Recipe
from schemas.summary import Paired
from stages.report import report

HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&{{ 7 * 7 }}"
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """A strict reader: every element is closed, tables are read as rows of text."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.text = ""
        self.caption = ""
        self.feed(html)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag in VOID:
            return
        self.open.append(tag)
        if tag == "caption":
            self.caption = ""
        elif tag == "tr":
            self.tables.setdefault(self.caption, []).append([])
        elif tag in ("td", "th"):
            self.tables[self.caption][-1].append("")

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        if "style" in self.open or "script" in self.open:
            return
        self.text += data
        if "caption" in self.open:
            self.caption += data
        elif "td" in self.open or "th" in self.open:
            self.tables[self.caption][-1][-1] += data


def read(data: ReportData, folder: Path) -> tuple[str, Page]:
    html = report(data, folder / "report.html").read_text("utf-8")
    return html, Page(html)


def cells(page: Page, caption: str) -> list[list[str]]:
    return [[" ".join(cell.split()) for cell in row] for row in page.tables[caption]]


def test_the_headline_says_from_what_to_what_with_interval_and_paired_test(loop, tmp_path):
    text = " ".join(read(loop, tmp_path)[1].text.split())
    first, last = (loop.result.generations[k].success["deployment_mix"] for k in (0, -1))
    assert "The robot got better" in text
    for shown in (percent(first.rate), percent(last.rate), f"[{100 * last.low:.1f}, {100 * last.high:.1f}]",
                  "fixed 91, broken 6, p < 0.0001", "speaks of this pair of policies and nothing more"):
        assert shown in text


@pytest.mark.parametrize(("paired", "swap", "title"), [
    (Paired(fixed=4, broken=3, p=0.5), False, "Higher, but not proven"),
    (Paired(fixed=6, broken=91, p=1e-9), True, "The robot did not get better"),
], ids=["not significant", "worse"])
def test_the_headline_claims_no_gain_that_the_numbers_do_not_show(loop, tmp_path, paired, swap, title):
    laps = loop.result.generations[::-1] if swap else loop.result.generations
    result = loop.result.model_copy(update={"paired": paired, "generations": laps})
    page = read(replace(loop, result=result), tmp_path)[1]
    assert title in page.text and "The robot got better" not in page.text


def test_every_success_of_both_arms_stands_in_the_exam_table(loop, tmp_path):
    rows = cells(read(loop, tmp_path)[1], "Exam of each generation’s champion, success in %")[1:]
    assert [row[0] for row in rows] == ["loop"] * 4 + ["control"] * 4
    for row, lap in zip(rows, (*loop.result.generations, *loop.result.control), strict=True):
        for cell, (kind, found) in zip(row[2:6], lap.success.items(), strict=True):
            counted = "" if kind == "deployment_mix" else f" {found.successes}/{found.n}"
            assert cell == f"{percent(found.rate)} [{100 * found.low:.1f}, {100 * found.high:.1f}]{counted}"
        assert row[6] == lap.policy


def test_every_number_of_the_gate_stands_in_its_tables(loop, tmp_path):
    page = read(loop, tmp_path)[1]
    for verdict in loop.verdicts:
        rows = cells(page, f"Gate of generation {verdict.generation} by stratum")[1:]
        for row, found in zip(rows, verdict.strata, strict=True):
            assert row[0] == found.stratum and percent(found.candidate.rate) in row[1]
            assert (percent(found.champion.rate) in row[2]) if found.champion else row[2] == "–"
            assert row[3:] == [str(found.fixed), str(found.broken), p_value(found.p_gain), p_value(found.p_loss),
                               percent(found.loss_upper), str(found.candidate.n)]
        assert verdict.reason in page.text
    assert "400 more scenes" in page.text


def test_shadow_and_worth_of_the_last_lap_stand_under_the_gate(loop, tmp_path):
    page = read(loop, tmp_path)[0]
    assert ("candidate and champion apart in 24 of 150 attempts; right: candidate 5, champion 2, both 9; "
            "promotion +2.1 points [-0.4 +4.6], hold") in page
    assert "+2.5 points by the 42 episodes of lap 3 on 200 scenes (common -0.5, side +5.5); 1 seed, indicative" in page


def test_data_training_triggers_and_cost_stand_in_tables(loop, tmp_path):
    page = read(loop, tmp_path)[1]
    augmentation = cells(page, "Augmentation")[1:]
    assert augmentation[0] == ["0", "replayed", "150", "122", "81.3%", "41.0%", "46.0%"]
    for row, version in zip(cells(page, "Dataset versions")[1:], loop.versions, strict=True):
        assert row[1:5] == [version.id, str(len(version.episodes)), str(len(version.held_out)), f"{version.frames:,}"]
    assert "corrected 180" in cells(page, "Dataset versions")[-1][5]
    for row, policy in zip(cells(page, "Policies")[1:], loop.policies, strict=True):
        assert row[5:7] == [number(policy.train_loss[-1][1]), number(policy.held_out_loss[-1][1])]
    for row, lap in zip(cells(page, "Triggers of each deployment against truth")[1:], loop.laps, strict=True):
        assert row[1:5] == [str(lap.triggers.flagged), str(lap.triggers.failed), percent(lap.triggers.precision),
                            percent(lap.triggers.recall)]
    for row, lap in zip(cells(page, "Wall seconds by stage, robot seconds and corrections so far")[1:],
                        loop.result.generations, strict=True):
        assert row[-3:] == [f"{sum(lap.wall_s.values()):.1f}", f"{lap.robot_s:,.0f}", str(lap.corrections)]
    survival = loop.laps[0].augment.survival
    assert all(demonstration in page.text for demonstration in survival)
    for fact in (loop.command, "hardcase why", "4.0.0", "1,304", duration(loop.result.wall_s)):
        assert fact in page.text


def test_hard_cases_stand_by_family_the_largest_first_with_film_strips(loop, tmp_path):
    html, page = read(loop, tmp_path)
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(images) == 16 and all(i["src"].startswith("data:image/webp;base64,") for i in images)
    assert all("frames of a" in i["alt"] and "4.8 s" in i["alt"] for i in images)
    assert html.index("never reached <span") < html.index("missed grasp <span")
    assert {row[0] for row in cells(page, "Hard cases")[1:]} == {shown.case.id for shown in loop.hard_cases}


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP"])
def test_a_film_strip_may_be_png_jpeg_or_webp(loop, tmp_path, form, make_strip):
    shown = replace(loop.hard_cases[0], strip=make_strip(0, form))
    assert f"data:image/{form.lower()};base64," in read(replace(loop, hard_cases=(shown,)), tmp_path)[0]


def test_bytes_that_are_no_picture_are_left_out(loop, tmp_path):
    shown = replace(loop.hard_cases[0], strip=FilmStrip(b"<svg onload=alert(1)>", ("now",)))
    html, page = read(replace(loop, hard_cases=(shown,)), tmp_path)
    assert "<img" not in html and shown.case.id in page.text


def test_the_page_names_no_address_outside_itself(loop, tmp_path):
    html, page = read(loop, tmp_path)
    assert not re.search(r"https?:|//[a-z]|url\(|@import", re.sub(r"(base64,|sha256-)[A-Za-z0-9+/=]+", "", html))
    assert all(a.get("href", "#").startswith("#") for _, a in page.tags)
    policy = next(a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "unsafe" not in policy


def hostile(loop: ReportData) -> ReportData:
    recipe = Recipe.model_construct(**(dict(loop.recipe) | {"task": HOSTILE, "name": HOSTILE}))
    case = HardCase.model_construct(**(dict(loop.hard_cases[0].case) | {"family": HOSTILE, "trigger": HOSTILE}))
    verdict = loop.verdicts[-1].model_copy(update={"reason": HOSTILE})
    lap = loop.laps[-1].model_copy(update={"rewards": {HOSTILE: (0.0, 1.0)}, "exam_strata": {
        HOSTILE: loop.laps[-1].exam_strata["side"]}, "frames_by_source": {HOSTILE: 7}})
    strip = FilmStrip(loop.hard_cases[0].strip.image, (HOSTILE,))
    return replace(loop, recipe=recipe, command=f"hardcase loop {HOSTILE}", notes=(HOSTILE,), laps=(lap,),
                   verdicts=(verdict,), hard_cases=(ShownCase(case, strip),), software={HOSTILE: HOSTILE},
                   store={HOSTILE: 1})


def test_hostile_text_is_shown_and_never_becomes_markup(loop, tmp_path):
    page = read(hostile(loop), tmp_path)[1]
    assert sum(tag == "script" for tag, _ in page.tags) == 1
    assert all("onerror" not in a and a.get("src") != "x" for _, a in page.tags)
    assert page.text.count("<script>alert(1)</script>") >= 8 and "{{ 7 * 7 }}" in page.text


def test_a_loop_without_a_finished_generation_still_reports(bare, tmp_path):
    page = read(bare, tmp_path)[1]
    assert "No generation was finished" in page.text and bare.command in page.text
    assert not page.tables


def test_a_single_generation_compares_nothing(loop, tmp_path):
    result = loop.result.model_copy(update={"generations": loop.result.generations[:1], "control": None})
    page = read(replace(loop, result=result, laps=loop.laps[:1], verdicts=(), policies=(), versions=(), hard_cases=()),
                tmp_path)[1]
    assert "nothing to compare with yet" in page.text and "this pair of policies" not in page.text


def test_a_missing_control_arm_is_said_and_how_to_add_it(loop, tmp_path):
    assert "No control arm was run" not in read(loop, tmp_path)[1].text
    page = read(replace(loop, result=loop.result.model_copy(update={"control": None})), tmp_path)[1]
    assert "No control arm was run: add --control" in page.text


def test_a_loss_that_is_not_finite_does_not_spoil_the_page(loop, tmp_path):
    policy = loop.policies[0].model_copy(update={"train_loss": ((1, 0.4), (2, float("nan")), (3, float("inf"))),
                                                 "held_out_loss": ()})
    html, page = read(replace(loop, policies=(policy,)), tmp_path)
    assert cells(page, "Policies")[1][5:7] == ["–", "–"]
    assert not re.search(r'(points|x|y|cx|cy|width)="[^"]*(nan|inf)', html)


def test_a_report_that_cannot_be_written_says_what_to_do_and_leaves_nothing(loop, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(ConfigError, match=r"mend: name a file in a folder"):
        report(loop, tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(("value", "written"), [
    (0, "0"), (0.02612, "0.0261"), (1312.0, "1,312"), (-9.137, "−9.14"), (3.1e-7, "3.10e−07"), (0.5, "0.500"),
    (99.96, "100.0"), (None, "–"), (float("nan"), "–")])
def test_numbers_are_written_for_people(value, written):
    assert number(value) == written


@pytest.mark.parametrize(("seconds", "written"), [(9.0, "9.0 s"), (86.4, "1 min 26 s"), (3937.5, "1 h 5 min")])
def test_durations_are_written_for_people(seconds, written):
    assert duration(seconds) == written
