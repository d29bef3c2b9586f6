"""How long still: the shares of the stages, corrected by the time that they really take."""

from collections.abc import Iterator

from flows.service.running import Step
from schemas.recipe import Recipe


def plan(recipe: Recipe, *, control: bool) -> tuple[Step, ...]:
    """Every step of a whole loop, in order; must tell the same story as flows.loop.turn."""
    arms = ("loop", "control") if control else ("loop",)
    steps = [step for arm in arms for step in turn_steps(arm, recipe.generations, recipe)]
    return (*steps, *(Step("loop", recipe.generations, stage) for stage in last_steps(recipe)))


def last_steps(recipe: Recipe) -> tuple[str, ...]:
    """The stages that follow the last lap; a batch that was judged in full is not judged by one training again."""
    return ("judge", "report") if recipe.harvest.worth_seeds else ("judge", "worth", "report")


def learning_steps(generation: int, recipe: Recipe) -> Iterator[str]:
    """The stages of a lap from what was harvested to the exam."""
    yield from ("augment", "build")
    if recipe.harvest.worth_seeds and generation:
        yield "worth"
    yield from ("train", "gate", "release", "exam")


def turn_steps(arm: str, last: int, recipe: Recipe) -> Iterator[Step]:
    """The steps of one arm from generation 0 to `last`; nothing is harvested that no lap would learn from."""
    yield Step(arm, 0, "collect")
    for generation in range(last + 1):
        for stage in learning_steps(generation, recipe):
            yield Step(arm, generation, stage)
        if generation < last:
            yield Step(arm, generation, "deploy")
            yield Step(arm, generation, "harvest")


def night_steps(generation: int, recipe: Recipe) -> Iterator[Step]:
    """The steps of one night: robot time first, so that each night learns from the champion of the one before."""
    if generation == 0:
        yield Step("loop", 0, "collect")
    else:
        yield Step("loop", generation - 1, "deploy")
        yield Step("loop", generation - 1, "harvest")
    for stage in (*learning_steps(generation, recipe), "judge"):
        yield Step("loop", generation, stage)


def expected_s(step: Step, recipe: Recipe) -> float:
    """Seconds a step takes on two idle cores, from the counts of the recipe; docs/decisions/007 says how measured.

    A gate ends at any of its looks: their mean is expected.
    """
    first = step.generation == 0
    if recipe.rl is not None:
        return _legged_s(step.stage, recipe, recipe.train.steps if first else recipe.rl.lap_steps)
    augment, harvest, looks = recipe.augment, recipe.harvest, recipe.gate.looks
    variants = augment.replays + augment.retargets if first else augment.per_correction * harvest.corrections
    played = looks[0] if first else 2 * sum(looks) / len(looks)
    return {
        "collect": 0.2 + 0.012 * recipe.collect.demonstrations,
        "augment": 0.2 + 0.006 * variants,
        "build": 0.2 + 0.0005 * variants,
        "train": 0.3 + 0.0024 * recipe.train.steps + (0.9 if first else 0.0),  # importing PyTorch
        "gate": 0.2 + 0.007 * played,
        "release": 0.02,
        "exam": 0.1 + 0.0057 * (recipe.exam.common + recipe.exam.rare),
        "deploy": 0.2 + 0.0095 * recipe.deploy.episodes,
        "harvest": 0.1 + 0.02 * harvest.corrections,
        "judge": 0.0 if first else 0.5 + 0.02 * recipe.deploy.episodes,
        "worth": 0.0 if first else (0.6 + 0.0026 * recipe.train.steps) * max(1, 2 * harvest.worth_seeds),
        "report": 1.0,
    }[step.stage]


def _legged_s(stage: str, recipe: Recipe, steps: int) -> float:
    """The same for a legged robot: what counts is how many ticks are simulated, 300 an attempt."""
    attempts = {"gate": 2 * recipe.gate.looks[0], "exam": recipe.exam.common + recipe.exam.rare,
                "deploy": recipe.deploy.episodes}
    if stage == "train":
        return 1.0 + 1e-4 * steps
    return 0.2 + 0.025 * attempts[stage] if stage in attempts else 2.0 if stage == "report" else 0.05


class Clock:
    """Estimates what is left; learns the pace of every kind of stage as it goes."""

    def __init__(self, steps: tuple[Step, ...], recipe: Recipe) -> None:
        self._left = {step: expected_s(step, recipe) for step in steps}
        self._total_s = sum(self._left.values())
        self._done: dict[str, tuple[float, float]] = {}

    def finish(self, step: Step, took_s: float, *, resumed: bool) -> None:
        """Take one measured step off the list; one that was only looked up says nothing of the pace."""
        expected = self._left.pop(step, None)
        if expected is not None and not resumed:
            before = self._done.get(step.stage, (0.0, 0.0))
            self._done[step.stage] = (before[0] + expected, before[1] + took_s)

    def share_done(self) -> float:
        """Finished share of the whole by expected time, 0 to 1."""
        return 1.0 - sum(self._left.values()) / self._total_s

    def left_s(self, now: Step, elapsed_s: float, share: float) -> float:
        """Seconds left, the running step included.

        Args:
            now: the running step.
            elapsed_s: how long it has been running [s].
            share: how much of it is done, 0 to 1; 0 if it has not said.
        """
        planned = self._left.get(now, 0.0) * self._pace(now.stage)
        own = elapsed_s / share if share > 0.05 else max(planned, elapsed_s)
        others = sum(s * self._pace(step.stage) for step, s in self._left.items() if step != now)
        return max(own - elapsed_s, 0.0) + others

    def _pace(self, stage: str) -> float:
        """Measured over expected: of this kind of stage, else of all so far, else 1."""
        measured = [self._done[stage]] if stage in self._done else list(self._done.values())
        if not measured:
            return 1.0
        return sum(took for _, took in measured) / sum(expected for expected, _ in measured)
