"""One loop as a reader would meet it: the numbers of a real prototype run, the gaps filled by formulas."""

import io
import math
import shutil

import pytest
from PIL import Image, ImageDraw

from pipeline.files import sha256, short_id
from pipeline.report.data import FilmStrip, ReportData, ShownCase
from schemas.dataset import DatasetVersion
from schemas.hardcase import HardCase
from schemas.policy import PolicyRecord
from schemas.recipe import Recipe
from schemas.summary import (
    AugmentReport,
    GateLine,
    Generation,
    Lap,
    LoopResult,
    Paired,
    ShadowLine,
    TriggerReport,
    WorthLine,
)
from schemas.verdict import Look, Proportion, StratumResult, Verdict

COMMON, RARE = (281, 288, 292, 294), (2, 46, 66, 74)
CONTROL = ((280, 1), (285, 5), (287, 9), (288, 13))
DECISIONS = ("BOOTSTRAP", "PASS", "INCONCLUSIVE", "PASS")
FAMILIES = (("missed_grasp", "closed_on_nothing"), ("never_reached", "stall"), ("dropped", "dropped"))
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ARGUMENTS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", "--no-first-run"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A real browser that has no network to lean on."""
    if BROWSER is None:
        pytest.skip("no browser: sudo apt-get install -y chromium")
    from playwright.sync_api import sync_playwright
    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            str(tmp_path_factory.mktemp("profile")), executable_path=BROWSER, args=ARGUMENTS)
        yield context
        context.close()


def proportion(successes: int, n: int) -> Proportion:
    z, rate = 1.959964, successes / n
    centre, half = rate + z * z / (2 * n), z * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    return Proportion(n=n, successes=successes, rate=rate, low=max(0, (centre - half) / (1 + z * z / n)),
                      high=min(1, (centre + half) / (1 + z * z / n)))


def exam(common: int, rare: int) -> dict[str, Proportion]:
    a, b = proportion(common, 300), proportion(rare, 100)
    mix = {k: 0.88 * getattr(a, k) + 0.12 * getattr(b, k) for k in ("rate", "low", "high")}
    return {"all": proportion(common + rare, 400), "common": a, "rare": b,
            "deployment_mix": Proportion(n=400, successes=common + rare, **mix)}


def generation(g: int, common: int, rare: int, arm: str) -> Generation:
    wall = {"collect": 2.4} if g == 0 else {"deploy": 3.6, "harvest": 1.9}
    wall |= {"augment": 6.3 if g == 0 else 1.2, "build": 1.7, "train": 7.4, "gate": 6.1 + g, "exam": 7.9}
    return Generation(generation=g, dataset_version=short_id("version", g), policy=short_id(arm, g - (g == 2)),
                      success=exam(common, rare), gate=GateLine(verdict=DECISIONS[g], p=(None, 1e-6, 0.11, 0.0042)[g]),
                      robot_s=1312.5 * g, corrections=12 * g, wall_s=wall)


def lap(g: int) -> Lap:
    tried = {"replayed": 150, "retargeted": 250} if g == 0 else {"retargeted": 66}
    kept = {k: round(v * (0.81 + 0.03 * g)) for k, v in tried.items()}
    survival = {short_id("demo", k): min(1.0, 0.35 + 0.7 * ((k * 37) % 50) / 50) for k in range(50 if g == 0 else 11)}
    reach = tuple(-0.3 * math.exp(-t / (30 - 3 * g)) for t in range(200))
    placed = tuple((0.78 + 0.05 * g) / (1 + math.exp((110 - 6 * g - t) / 9)) for t in range(200))
    return Lap(generation=g, augment=AugmentReport(tried=tried, kept=kept, survival=survival,
                                                   coverage_before=0.41 + 0.07 * g, coverage_after=0.46 + 0.07 * g),
               triggers=TriggerReport(
                   precision=0.93, recall=0.88 + 0.02 * g, flagged=28 - 6 * g, failed=29 - 6 * g,
                   by_trigger={"closed_on_nothing": 14 - 3 * g, "stall": 9 - 2 * g, "dropped": 5 - g},
                   by_family={"missed_grasp": 14 - 3 * g, "never_reached": 9 - 2 * g, "dropped": 5 - g}),
               exam_strata={"side": proportion(RARE[g] // 2, 50), "large": proportion(RARE[g] - RARE[g] // 2, 50)},
               candidate_exam=proportion(COMMON[g] + RARE[g], 400),
               rewards={"reach": reach, "grasp": tuple(0.4 * v for v in placed), "place": placed},
               correction_success=proportion(11 - g % 2, 12) if g else None,
               frames_by_source={"scripted": 4210, "replayed": 12120, "retargeted": 20844 + 5000 * g}
               | ({"corrected": 1730 * g} if g else {}), shadow_disagreement=(0.21, 0.66 - 0.05 * g) if g else None)


def policy(g: int) -> PolicyRecord:
    train = tuple((s, 0.42 * math.exp(-s / 260) + 0.021 - 0.002 * g + 0.004 * abs(math.sin(s * 1.7)))
                  for s in range(1, 1501, 5))
    held_out = tuple((s, 0.42 * math.exp(-s / 260) + 0.031 - 0.003 * g) for s in range(50, 1501, 50))
    return PolicyRecord(id=short_id("loop", g), kind="chunked", dataset=short_id("version", g), seed=7, generation=g,
                        steps=1500, config=sha256(b"config"), code=sha256(b"code"), checkpoint=f"policies/{g}",
                        files={}, train_loss=train, held_out_loss=held_out, onnx_error=3.1e-7)


def verdict(g: int) -> Verdict:
    first = g == 0

    def line(stratum: str, n: int, before: float, after: float, fixed: int, broken: int) -> StratumResult:
        return StratumResult(stratum=stratum, candidate=proportion(round(after * n), n),
                             champion=None if first else proportion(round(before * n), n),
                             fixed=0 if first else fixed, broken=0 if first else broken,
                             p_gain=None if first else 0.0007 * g, p_loss=None if first else 0.97,
                             loss_upper=None if first else 0.013 + 0.04 * (g == 2) + 0.003 * n / 100)

    looks = () if g == 0 else (Look(scenes=200, alpha=0.0021, decision="continue"), Look(
        scenes=400, alpha=0.0169, decision="PASS" if DECISIONS[g] == "PASS" else "continue"))
    return Verdict(id=short_id("verdict", g), candidate=short_id("loop", g), generation=g, decision=DECISIONS[g],
                   champion=None if g == 0 else short_id("loop", g - 1),
                   reason=("lower bound .87 reaches .50", "significant gain in rare, no loss above 5 points",
                           "no significant gain within 400 scenes", "significant gain overall")[g],
                   strata=(line("all", 400, .86, .93, 38, 9), line("common", 280, .95, .97, 9, 4),
                           line("side", 70, .35, .71, 22, 3), line("large", 50, .52, .74, 14, 2)),
                   looks=looks, p=(None, 1e-6, 0.11, 0.0042)[g], scenes=400, margin=0.05,
                   more_scenes=400 if DECISIONS[g] == "INCONCLUSIVE" else None)


def version(g: int) -> DatasetVersion:
    episodes = tuple(short_id("episode", g, k) for k in range(380 + 60 * g))
    return DatasetVersion(id=short_id("version", g), digest=sha256(b"%d" % g), recipe="reference", generation=g,
                          parent=short_id("version", g - 1) if g else None, path=f"versions/{short_id('version', g)}",
                          episodes=episodes, held_out=episodes[:38 + 6 * g], inputs=(), code=sha256(b"code"),
                          weights={"base": 0.6, "corrections": 0.4} if g else {"base": 1.0}, frames=37174 + 6730 * g)


def strip(k: int, form: str = "WEBP") -> FilmStrip:
    picture = Image.new("RGB", (5 * 160, 120), (222, 211, 196))
    pen = ImageDraw.Draw(picture)
    for frame in range(5):
        x, hand = 160 * frame, 30 + 9 * frame
        pen.rectangle((x + 66 + 5 * k % 40, 78, x + 84 + 5 * k % 40, 96), fill=(206, 54, 60))
        pen.line((x + 80, 10, x + 70 + hand // 3, hand + 20), fill=(48, 88, 170), width=9)
        pen.ellipse((x + 112, 84, x + 130, 92), fill=(52, 158, 92))
    stream = io.BytesIO()
    picture.save(stream, form)
    return FilmStrip(stream.getvalue(), ("0.0 s", "1.6 s", "3.2 s", "4.8 s", "stall"))


def case(k: int) -> ShownCase:
    family, trigger = FAMILIES[(k * k) % 3]
    return ShownCase(HardCase(id=short_id("case", k), episode=short_id("attempt", k), trigger=trigger, tick=61 + 3 * k,
                              family=family, stratum=("side", "large")[k % 2], generation=k // 6,
                              correction=short_id("correction", k) if k % 5 else None, corrected=k % 5 > 1),
                     strip(k) if k < 16 else None)


SHADOW = ShadowLine(champion=short_id("policy", 2), candidate=short_id("policy", 3), agreement=0.97, attempts=150,
                    apart=24, judged=16, right={"candidate": 5, "champion": 2, "both": 9, "neither": 0}, undecided=3,
                    change=(0.021, -0.004, 0.046), verdict="hold")
WORTH = WorthLine(generation=3, batch="lap 3", episodes=42, points=2.5, seeds=1, scenes=200,
                  kinds={"common": -0.5, "side": 5.5})


@pytest.fixture
def loop() -> ReportData:
    laps = range(4)
    result = LoopResult(generations=tuple(generation(g, COMMON[g], RARE[g], "loop") for g in laps),
                        control=tuple(generation(g, *CONTROL[g], "control") for g in laps),
                        paired=Paired(fixed=91, broken=6, p=3.2e-21), wall_s=151.4, peak_pss_mb=1312.0, seed=7,
                        twin=103, shadow=SHADOW, worth=WORTH)
    sources = {"scripted": 46, "replayed": 122, "retargeted": 212}
    return ReportData(
        recipe=Recipe(name="reference"), result=result, laps=tuple(lap(g) for g in laps),
        command="hardcase loop --recipe reference --generations 3 --seed 7 --twin 103 --control --json loop.json",
        policies=tuple(policy(g) for g in laps), verdicts=tuple(verdict(g) for g in laps),
        versions=tuple(version(g) for g in laps), hard_cases=tuple(case(k) for k in range(18)),
        episodes_by_source={short_id("version", g): sources | ({"corrected": 60 * g} if g else {}) for g in laps},
        software={"hardcase": "0.1.0", "mujoco": "4.0.0", "lerobot": "0.6.1", "torch": "2.11.0", "python": "3.12.4"},
        store={"episodes": 1304, "recordings": 536, "dataset_versions": 4, "policies": 4, "hard_cases": 44})


@pytest.fixture
def bare() -> ReportData:
    """A loop that stopped before its first exam."""
    result = LoopResult(generations=(), paired=Paired(fixed=0, broken=0, p=1.0), wall_s=0.0, peak_pss_mb=0.0, seed=0,
                        twin=0)
    return ReportData(recipe=Recipe(name="smoke"), command="hardcase loop --recipe smoke", result=result)


@pytest.fixture
def make_strip():
    return strip
