"""Assemble: kinds of start and the starts of falls become a curriculum: an immutable dataset version of starts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pipeline
from pipeline.consent import NO_CONSENTS, Consents, needs
from pipeline.errors import ConfigError
from pipeline.files import short_id, source_hash
from pipeline.lerobot_view.manifest import load_version, write_content
from pipeline.locomotion.curriculum import Curriculum, HardStart
from pipeline.locomotion.lesson import Lesson
from pipeline.locomotion.tasks import load_legged_task
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.hardcase import HardCase
from schemas.recipe import Recipe, RlConfig

FOLDER = "versions"
"""Where versions lie, relative to the store's root."""
DRAWN, HARD = "drawn", "hard"
"""Groups of starts, and their shares of a training's attempts."""
SOURCES = ("locomotion/curriculum.py", "locomotion/lesson.py", "locomotion/starts.py", "locomotion/tasks.py")
"""Files of pipeline/ that decide where attempts begin."""


def assemble(cases: Sequence[HardCase], episodes: Mapping[str, Episode], recipe: Recipe, *, store: Path,
             generation: int, parent: DatasetVersion | None = None,
             consents: Consents = NO_CONSENTS) -> DatasetVersion:
    """Make the curriculum that a lap learns from, or return it if it is already there.

    Drawn are the task's common kinds of start. Of the hard cases the newest `recipe.rl.kept` that have a start teach,
    weighted by age and, where the recipe says so, evenly over the families of falls; a share of all of them, the same
    ones in every lap, is held out for the gate.

    Args:
        cases: hard cases of all laps so far.
        episodes: the attempts that they are about, by id.
        recipe: robot, task, and `rl`.
        store: root of the store; the version becomes store/versions/ID.
        generation: lap of the loop, from 0.
        parent: the curriculum of the lap before.
        consents: who agrees at this moment.

    Raises:
        ConfigError: the recipe says nothing of reinforcement learning.
        ConsentError: a person in one of the attempts does not consent.
        DatasetError: the folder that is there was changed.
    """
    if recipe.rl is None:
        raise ConfigError("a curriculum needs the numbers of its recipe", where=f"recipe {recipe.name}: rl",
                          mend="give the recipe a section rl, as in datasets/recipes/biped.yaml")
    taught, held = _split([c for c in cases if c.start is not None], recipe.rl)
    used = list({c.episode: episodes[c.episode] for c in (*taught, *held)}.values())
    consents.check(used)
    lesson = _lesson(_weighted(taught, recipe.rl, generation), held, used, recipe, recipe.rl)
    code, share = code_hash(), lesson.curriculum.hard_share
    version = short_id("curriculum", lesson.model_dump_json(), generation, parent.id if parent else "", code)
    target = store / FOLDER / version
    if not target.exists():
        content: dict[str, Any] = {
            "id": version, "generation": generation, "parent": parent.id if parent else None, "code": code,
            "recipe": recipe.name, "path": f"{FOLDER}/{version}", "episodes": [e.id for e in used],
            "held_out": list(dict.fromkeys(c.episode for c in held)),
            "weights": {DRAWN: 1 - share, HARD: share} if share else {DRAWN: 1.0},
            "inputs": list(dict.fromkeys(e.blob for e in used if e.blob)), "frames": 0,
            "starts": [c.id for c in (*taught, *held)]}
        lesson.write(target, write_content(content, recipe=recipe.model_dump(mode="json"),
                                           task=lesson.task.instruction), aside=store / "tmp")
    return load_version(target)


def _lesson(starts: tuple[HardStart, ...], held: Sequence[HardCase], used: Sequence[Episode], recipe: Recipe,
            rl: RlConfig) -> Lesson:
    """What a lap learns from; without a hard start all are drawn."""
    task = load_legged_task(recipe.task)
    curriculum = Curriculum(kinds=dict.fromkeys(task.common, 1.0), hard_share=rl.hard_share if starts else 0.0,
                            spread=rl.spread if starts else 0.0, starts=starts)
    return Lesson(body=recipe.robot, name=recipe.task, task=task, curriculum=curriculum, vary=rl.vary,
                  held_out=tuple(_hard(c, 1.0) for c in held), needs={e: n for e, n in needs(used).items() if n})


def code_hash() -> str:
    """Hash of every source file that decides where the attempts of a curriculum begin."""
    root = Path(pipeline.__path__[0])
    return source_hash([Path(__file__), *(root / name for name in SOURCES)])


def _split(cases: Sequence[HardCase], config: RlConfig) -> tuple[list[HardCase], list[HardCase]]:
    """Cases that teach, the newest ones, and those that only the gate plays; a case stays what it is for ever."""
    held = [c for c in cases if int(short_id("held out", c.id), 16) < config.held_out * 16**16]
    out = {c.id for c in held}
    taught = sorted((c for c in cases if c.id not in out), key=lambda c: c.generation)
    return taught[-config.kept:], held


def _weighted(cases: Sequence[HardCase], config: RlConfig, generation: int) -> tuple[HardStart, ...]:
    """The starts with their weights: younger ones weigh more, and no frequent family crowds out a rare one."""
    age = [config.recency ** (generation - 1 - c.generation) for c in cases]
    total: dict[str, float] = {}
    for case, weight in zip(cases, age, strict=True):
        total[case.family] = total.get(case.family, 0.0) + weight
    even = config.families == "even"
    return tuple(_hard(c, w / total[c.family] if even else w) for c, w in zip(cases, age, strict=True))


def _hard(case: HardCase, weight: float) -> HardStart:
    assert case.start is not None, "cases without a start were left out"
    return HardStart(case=case.id, episode=case.episode, family=case.family, generation=case.generation, weight=weight,
                     start=case.start)
