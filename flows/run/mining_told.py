"""What mining found in a run, for people: families with film strips, the queue with reasons, the regression set."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console, Group
from rich.table import Column, Table

from flows.run.mining import before, mined_at
from flows.run.opening import open_order, recall, refuse_legged
from flows.run.regression import solved_of
from flows.run.shadow_report import deployed_lap
from flows.run.steps import Steps
from pipeline.errors import StoreError
from pipeline.files import atomic
from schemas.hardcase import HardCase
from schemas.mining import Family, Ranked, RegressionScene
from stages.harvest import hard_cases
from stages.mine import Mined


@dataclass(frozen=True, slots=True)
class Told:
    """One lap of a run, mined."""

    run: str
    generation: int
    families: tuple[Family, ...]
    """Of all laps up to this one."""
    new: frozenset[str]
    """Ids of those that this lap was the first to show."""
    cases: tuple[HardCase, ...]
    queue: tuple[Ranked, ...]
    strips: dict[str, Path]
    """Family id -> film strip of its medoid."""
    notes: tuple[str, ...]

    def count(self, family: str) -> int:
        """Failures of this lap that belong to a family."""
        return sum(c.found == family for c in self.cases)


def mine_run(root: Path, run: str | None, generation: int | None, *, film: bool) -> Told:
    """Look at the failures of a lap of a recorded run again, and say what should be corrected first.

    Nothing is written but the film strips. A run that was recorded before families were looked for is mined from its
    first lap on, so that families have the names that they would have got.

    Args:
        root: the store.
        run: the newest loop where None.
        generation: lap whose deployment is looked at; the last that was deployed where None.
        film: render the medoids.

    Raises:
        StoreError: no such run, or nothing was deployed.
    """
    with open_order(recall(root, run), root) as steps:
        assert isinstance(steps, Steps)
        refuse_legged(steps.recipe, "mining")
        lap = deployed_lap(steps, generation)
        families: list[Family] = []
        mined = Mined((), (), ())
        for g in range(lap + 1):
            mined = mined_lap(steps, g, families)
            families += mined.new
        strips, notes = _filmed(steps, families, lap) if film else ({}, ())
    return Told(steps.run, lap, tuple(families), frozenset(f.id for f in mined.new), mined.cases, mined.queue, strips,
                notes)


def mined_lap(steps: Steps, lap: int, families: Sequence[Family]) -> Mined:
    """The failures of one lap; `families` are those of the laps before it."""
    config = steps.recipe.harvest.judge
    attempts = steps.material.failed_attempts(lap) if config is None else steps.material.deployed_attempts(lap)
    known = steps.store.hard_cases(run=steps.run, generation=lap)
    cases = known or hard_cases(attempts, lap, steps.name)
    there = {e.id for e, _ in attempts}  # what was forgotten, or may teach no more, is not looked at
    knew = replace(before(steps, lap), families=tuple(families))
    return mined_at(steps, lap, [c for c in cases if c.episode in there], attempts, knew)


def _filmed(steps: Steps, families: Sequence[Family], lap: int) -> tuple[dict[str, Path], tuple[str, ...]]:
    from flows.run.reporting import film_strips

    cases = [HardCase(id=f.id, episode=f.medoid, trigger=f.subtask, tick=0, family=f.name, stratum="", generation=lap)
             for f in families]
    made, notes = film_strips(steps, cases, lambda done, total: None)
    paths: dict[str, Path] = {}
    for family, strip in made.items():
        paths[family] = steps.store.root / "reports" / f"families-{steps.run}" / f"{family}.{_kind(strip.image)}"
        with atomic(paths[family]) as stream:
            stream.write(strip.image)
    return paths, notes


def _kind(image: bytes) -> str:
    return "png" if image.startswith(b"\x89PNG") else "webp" if image.startswith(b"RIFF") else "jpg"


def whole(name: str) -> Column:
    """A column whose words are broken rather than cut where the terminal is narrow."""
    return Column(name, overflow="fold")


def show(told: Told) -> None:
    """Print families and queue."""
    table = Table(whole("family"), "failures", "subtask", "what happened in its medoid", whole("film strip"),
                  title=f"run {told.run}, generation {told.generation}: {len(told.cases)} failures")
    for f in sorted(told.families, key=lambda f: -told.count(f.id)):
        flag = " NEW" if f.id in told.new else f" (since {f.generation})"
        table.add_row(f.name + flag, str(told.count(f.id)), f.subtask, f.says, str(told.strips.get(f.id, "")))
    names, by_id = {f.id: f.name for f in told.families}, {c.id: c for c in told.cases}
    queue = Table("", whole("hard case"), whole("family"), "ended in 1,000", "correct from", "why",
                  title="what to correct first")
    for k, place in enumerate(told.queue, 1):
        case = by_id[place.case]
        queue.add_row(str(k), place.case, names[place.family], f"{place.per_1000:.1f}",
                      f"{case.subtask}, tick {case.begins}", place.reason)
    Console().print(Group(table, queue, *told.notes))


def as_json(told: Told) -> dict[str, object]:
    """The same for machines."""
    families = [{**f.model_dump(mode="json"), "failures": told.count(f.id), "new": f.id in told.new,
                 "strip": str(told.strips[f.id]) if f.id in told.strips else None} for f in told.families]
    return {"run": told.run, "generation": told.generation, "families": families,
            "cases": [c.model_dump(mode="json") for c in told.cases],
            "queue": [place.model_dump(mode="json") for place in told.queue]}


def regression_of(root: Path, run: str | None, policy: str | None, *,
                  play: bool) -> tuple[list[RegressionScene], list[int] | None]:
    """The regression set of a run by family, and how often a policy solves each scene of 8 times, where it was asked.

    Args:
        root: the store.
        run: the newest loop where None.
        policy: id or its first digits; the champion where None.
        play: whether to play them at all.

    Raises:
        StoreError: no such run or policy.
    """
    with open_order(recall(root, run), root) as steps:
        assert isinstance(steps, Steps)
        scenes = sorted(steps.store.regression_scenes(run=steps.run), key=lambda s: (s.family, s.generation, s.id))
        if not play:
            return scenes, None
        who = steps.store.champion(steps.run)
        id = who.policy if policy is None and who else _policy(steps, policy)
        return scenes, solved_of(steps.policy(id), [s.scene for s in scenes], 8, steps.recipe.threads)


def _policy(steps: Steps, prefix: str | None) -> str:
    table, id = steps.store.find(prefix or "")
    if table != "policy":
        raise StoreError(f"{id} is no policy, but of the table {table}", where=steps.store.root,
                         mend="name a policy: " + ", ".join(p.id for p in steps.store.policies(run=steps.run)))
    return id


def show_regression(scenes: Sequence[RegressionScene], solved: Sequence[int] | None) -> None:
    """Print the set by family."""
    table = Table(whole("family"), whole("scene"), "start [cm]", whole("fixed by"), "lap", "solved then", "solved now",
                  title=f"{len(scenes)} scenes that no release may lose unsaid")
    for k, s in enumerate(scenes):
        x, y = s.scene.object_xy_m
        start = f"{s.scene.stratum} {100 * x:.0f}, {100 * y:.0f}"
        now = "" if solved is None else f"{solved[k]} of 8"
        table.add_row(s.family, s.id, start, s.fixed_by, str(s.generation), f"{s.solved} of {s.played}", now)
    Console().print(table)
