"""The page of trainings by PPO: what it shows, that it believes nothing it is given, and how it looks in a browser."""

import json
import re
from html import unescape

import pytest

from pipeline.errors import PolicyError
from pipeline.locomotion.tasks import STAND
from pipeline.ppo.config import Order, PpoConfig
from pipeline.ppo.record import read_record
from pipeline.report.learned import Learned, meaning, success_charts, term_charts, unit
from pipeline.report.trainings import ShownTraining, grouped, trainings_page
from pipeline.statistics import wilson

STEPS, ITERATION = 40_960, 4096
HOSTILE = '<script>alert(1)</script><img src=x onerror=alert(2)>"\''


def point(k: int, seed: int) -> dict:
    terms = {name: weight * (0.5 + 0.04 * k + 0.01 * (seed % 3)) for name, weight in STAND.weights.items()}
    return {"step": ITERATION * (k + 1), "reward": sum(terms.values()), "terms": terms, "fallen": 20 - 2 * k,
            "full": 2 * k, "length": 100.0 + 40 * k, "std": 0.37 - 0.02 * k,
            "update": {"entropy": 4.0 - k, "kl": 0.01, "clipped": 0.1, "explained": 0.1 * k, "value_loss": 0.02}}


@pytest.fixture
def run(tmp_path):
    """Leaves what a finished training leaves, but for its policy; whatever is given stands in place of a field."""

    def left(seed: int, folder: str = "", **changed) -> "Path":  # noqa: F821
        order = Order(body="biped", name="stand", task=STAND, ppo=PpoConfig(steps=STEPS), seed=seed)
        values = {"order": order.model_dump(mode="json"), "id": order.id, "steps": STEPS, "onnx_apart": 1e-6,
                  "cpu_s": 12.0, "wall_s": 30.0, "curve": [point(k, seed) for k in range(10)]} | changed
        where = tmp_path / (folder or f"run-{seed}")
        where.mkdir()
        (where / "training.json").write_text(json.dumps(values))
        return where

    return left


def evaluation(full: int, n: int = 20) -> dict:
    def arm(reached: int) -> dict:
        share = wilson(reached, n)
        return {"full": reached, "rate": share.rate, "low": share.low, "high": share.high, "length_s": 9.0,
                "error": 0.1, "terms": {name: 0.4 * weight for name, weight in STAND.weights.items()}}

    return {"stratum": "leaning", "attempts": n, "training": "x",
            "arms": {"policy": arm(full), "zero action": arm(0), "random action": arm(1)}}


@pytest.fixture
def shown(run):
    return [ShownTraining("biped stand", f"seed {k}", read_record(run(k)), f"run-{k}", "ab" * 32, (evaluation(17 + k),))
            for k in range(2)]


def test_every_reward_term_has_a_chart_with_its_meaning_unit_weight_and_baselines(shown):
    charts = term_charts([one.learned for one in shown], {"zero action": dict.fromkeys(STAND.weights, 0.2)})
    assert len(charts) == len(STAND.weights) == 5
    for (name, weight), chart in zip(STAND.weights.items(), map(unescape, charts), strict=True):
        assert meaning(name) in chart
        assert f"Unit 1, weight {weight:g}".replace("-", "−")[:16] in chart
        names = re.findall(r'data-name="([^"]+)"', chart)
        assert names == ["zero action", "biped stand, seed 1", "biped stand, seed 0", "biped stand, mean of 2"]
        assert chart.count("<li>") == 2  # the legend names the mean and the baseline, a pointer the seeds


def test_the_mean_of_two_seeds_lies_between_them(shown):
    chart = term_charts([one.learned for one in shown])[0]
    lines = dict(re.findall(r'points="([^"]+)"[^>]*data-name="([^"]+)"', chart))
    heights = {name: [float(p.split(",")[1]) for p in points.split()] for points, name in lines.items()}
    three = (heights[f"biped stand, {name}"] for name in ("seed 0", "seed 1", "mean of 2"))
    for one, other, mean in zip(*three, strict=True):
        assert mean == pytest.approx((one + other) / 2, abs=0.11)


def test_the_unit_of_a_term_is_what_stands_in_brackets_at_the_end(monkeypatch):
    from types import MappingProxyType

    from pipeline.report import learned

    def swing(now):
        """How far a foot
        is lifted [m].

        More of it elsewhere.
        """

    monkeypatch.setattr(learned, "REWARDS", MappingProxyType({"swing": swing}))
    assert (meaning("swing"), unit("swing")) == ("How far a foot is lifted [m].", "m")


def test_success_is_a_share_of_the_attempts_that_ended(shown):
    chart = success_charts([Learned("a", "b", STAND, shown[0].record.curve)])[0]
    heights = [float(p.split(",")[1]) for p in re.search(r'points="([^"]+)"', chart)[1].split()]
    assert heights == pytest.approx([182 - 170 * 2 * k / 20 for k in range(10)], abs=0.1)


def test_the_page_shows_evaluation_orders_and_hashes(shown):
    page = trainings_page(shown, (), command="hardcase rl report run-0 run-1", notes=["mind the gap"])
    text = unescape(re.sub(r"<[^>]+>", " ", page))
    for said in ("85.0% full attempts", "[64.0, 94.8]", "zero action", shown[0].record.id, "ab" * 8, "mind the gap",
                 "KL divergence [nat]", "Explained variance", "hardcase rl report run-0 run-1"):
        assert said in text
    assert "abab" * 5 not in text
    assert page.count("<figure") == 3 + 5 + 6


def test_groups_are_called_by_what_they_differ_in():
    order = Order(body="biped", name="stand", task=STAND, ppo=PpoConfig(steps=STEPS))
    seeds = [order.model_copy(update={"seed": k}) for k in range(3)]
    assert grouped(seeds) == ["biped stand"] * 3
    warm = [one.model_copy(update={"goes_on": str(k) * 64}) for k, one in enumerate(seeds)]
    assert grouped([*seeds, *warm]) == ["biped stand, from scratch"] * 3 + ["biped stand, warm"] * 3
    long = [one.model_copy(update={"stratum": "leaning", "ppo": PpoConfig(hidden=(k,) * 40)}) for k, one in
            enumerate(seeds, 8)]
    assert len(set(grouped(long))) == 3


def test_hostile_text_is_shown_and_not_obeyed(run):
    order = Order(body=HOSTILE, name=HOSTILE, task=STAND.model_copy(update={"instruction": HOSTILE}),
                  ppo=PpoConfig(steps=STEPS))
    record = read_record(run(0, order=order.model_dump(mode="json"), id=order.id, note=HOSTILE))
    told = evaluation(3) | {"stratum": HOSTILE}
    told["arms"]["policy"]["terms"][HOSTILE] = 1.0
    page = trainings_page([ShownTraining(HOSTILE, HOSTILE, record, HOSTILE, HOSTILE, (told,))], (), command=HOSTILE,
                          notes=[HOSTILE])
    assert "<script>alert" not in page
    assert "<img src=x" not in page
    assert page.count("&lt;script&gt;alert(1)") > 10


@pytest.mark.parametrize(("changed", "told"), [
    ({"curve": []}, "curve: Tuple should have at least 1 item"),
    ({"curve": [point(0, 0), point(0, 0)]}, "the steps of the curve do not rise"),
    ({"curve": [point(0, 0) | {"reward": float("nan")}]}, "step 4096: a value is not finite"),
    ({"curve": [point(0, 0) | {"terms": {"upright": 1.0}}]}, "the terms are not those of the task"),
    ({"curve": [point(0, 0) | {"full": HOSTILE}]}, "curve.0.full"),
    ({"curve": HOSTILE}, "curve"),
    ({"id": HOSTILE}, "id: String should match pattern"),
    ({"order": {}}, "order.body: Field required"),
    ({"cpu_s": -1}, "cpu_s"),
], ids=["empty", "steps", "nan", "terms", "type", "text", "id", "order", "time"])
def test_a_broken_record_is_told_in_one_line(run, changed, told):
    with pytest.raises(PolicyError, match="mend: name a folder that hardcase rl train has left") as refused:
        read_record(run(0, **changed))
    assert told in refused.value.what


@pytest.mark.parametrize("data", [b"", b"{", b"[" * 200_000, b"\xff\xfe", b"null"],
                         ids=["empty", "half", "deep", "bytes", "null"])
def test_what_is_no_record_is_told_in_one_line(tmp_path, data):
    (tmp_path / "training.json").write_bytes(data)
    with pytest.raises(PolicyError, match="not the record of a training"):
        read_record(tmp_path)


def test_a_reward_term_that_there_is_not_is_named(run, hardcase):
    order = Order(body="biped", name="stand", task=STAND).model_dump(mode="json")
    order["task"]["weights"] = {"glory": 1.0}
    code, _, told = hardcase("rl", "report", run(0, order=order))
    assert (code, "glory" in told, "use one of" in told, "Traceback" in told) == (2, True, True, False)


def test_the_command_writes_a_page_and_json_of_records_alone(run, hardcase, tmp_path):
    folders = [run(k) for k in range(2)]
    page = tmp_path / "page.html"
    code, said, _ = hardcase("rl", "report", *folders, folders[0], "--out", page, "--json")
    told = json.loads(said)
    assert (code, told["page"], len(told["trainings"])) == (0, str(page), 2)
    assert told["trainings"][1]["last"]["step"] == STEPS
    assert "biped stand: 2 trainings" in page.read_text()
    code, _, told = hardcase("rl", "report", tmp_path)
    assert (code, "no training here" in told, "Traceback" in told) == (2, True, False)
    code, _, told = hardcase("rl", "report", folders[0], "--stratum", "flying")
    assert (code, "use one of: leaning, thrown" in told) == (2, True)


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1280, "light")])
def test_the_page_in_a_browser_is_quiet_fits_and_tells_values(shown, browser, tmp_path, width, scheme):
    (tmp_path / "page.html").write_text(trainings_page(shown, (), command="x" * 200))
    page, trouble = browser.new_page(), []
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)
    page.on("console", lambda message: trouble.append(message.text))
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("request", lambda asked: asked.url.startswith(("file:", "data:")) or trouble.append(asked.url))
    page.goto((tmp_path / "page.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.locator("#terms svg.curve").first.hover()
    assert "biped stand, seed 1:" in page.locator("#tip").inner_text()
    assert page.locator("#terms figure").count() == 5
    page.close()
    assert not trouble
