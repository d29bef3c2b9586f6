"""What a person sees: live progress, one line a finished stage, and the tables at the end."""

import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from flows.run.steps_api import StepResult
from flows.service.estimate import Clock, plan
from flows.service.running import Step
from schemas.recipe import Recipe
from schemas.summary import Generation, LoopResult
from schemas.verdict import Proportion, Verdict

KINDS = ("all", "common", "rare", "deployment_mix")
SHORT = {"all": "all", "common": "common", "rare": "rare", "deployment_mix": "mix"}
BARS = " ▁▂▃▄▅▆▇█"


class Display:
    """Live progress on a terminal, one plain line a stage everywhere; also a Watcher and a context manager."""

    def __init__(self, recipe: Recipe, console: Console, *, control: bool = False) -> None:
        self._console = console
        self._steps = plan(recipe, control=control)
        self._clock = Clock(self._steps, recipe)
        self._last = recipe.generations
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} % of the loop"),
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
            refresh_per_second=4,
        )
        self._task = self._bar.add_task("starting", total=1.0, left="")
        self._now: Step | None = None
        self._begun_s = 0.0

    def __enter__(self) -> "Display":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def begin(self, step: Step) -> None:
        """A stage begins."""
        self._now, self._begun_s = step, time.monotonic()
        self.advance(0, 0)

    def advance(self, done: int, total: int) -> None:
        """How far the running stage is; a few microseconds, so a stage may call it often."""
        if self._now is None or self._bar.disable:
            return
        share = min(done / total, 1.0) if total > 0 else 0.0
        elapsed_s = time.monotonic() - self._begun_s
        whole = self._clock.share_done()
        counted = f" {done}/{total}" if total > 0 else ""
        self._bar.update(
            self._task,
            description=f"{_where(self._now, self._last)} {self._now.stage}{counted}",
            completed=whole,
            left=f"{duration(self._clock.left_s(self._now, elapsed_s, share))} left",
        )

    def end(self, step: Step, result: StepResult) -> None:
        """A stage is finished: its line stays on the screen."""
        took_s = time.monotonic() - self._begun_s
        self._clock.finish(step, took_s, resumed=result.resumed)
        took = "kept" if result.resumed else f"{took_s:.1f} s"
        line = f"{_where(step, self._last)}  {step.stage:<8} {took:>8}  {result.says}"
        self._console.print(Text(line), soft_wrap=True)


def _where(step: Step, last: int) -> str:
    arm = "" if step.arm == "loop" else f"{step.arm} "
    return f"{arm}generation {step.generation}/{last}"


def duration(seconds: float) -> str:
    """'8 s', '2 min 5 s', '1 h 4 min'."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def success_table(laps: tuple[Generation, ...], title: str) -> Table:
    """Success of each generation's champion in the exam, by kind of start, with Wilson 95 % intervals.

    Narrow enough for 80 columns.
    """
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 0, 0, 1))
    table.add_column("gen", justify="right")
    for kind in KINDS:
        table.add_column(SHORT[kind], justify="right", no_wrap=True)
    table.add_column("gate", no_wrap=True)
    for lap in laps:
        cells = [_interval(lap.success.get(kind)) for kind in KINDS]
        table.add_row(str(lap.generation), *cells, lap.gate.verdict)
    return table


def _interval(p: Proportion | None) -> str:
    """'.947 [.92 .96]'."""
    if p is None:
        return "-"
    return f"{p.rate:.3f} [{p.low:.2f} {p.high:.2f}]".replace("0.", ".")


def chart(laps: tuple[Generation, ...]) -> Text:
    """A row of bars for each kind of start: eighths of a block from 0 to 1, a generation a column."""
    text = Text()
    for kind in KINDS:
        found = [lap.success[kind].rate for lap in laps if kind in lap.success]
        bars = "  ".join(BARS[round(rate * (len(BARS) - 1))] * 3 for rate in found)
        ends = f"{found[0]:.2f} -> {found[-1]:.2f}" if found else "-"
        text.append(f"{SHORT[kind]:>7}  {bars}  {ends}\n")
    return text


def verdict_lines(verdict: Verdict) -> list[str]:
    """The last gate, in the words of the gate and one line a stratum."""
    against = f" against {verdict.champion}" if verdict.champion else ""
    p = "" if verdict.p is None else f", p of a gain {verdict.p:.2g}"
    lines = [f"Last gate: {verdict.decision}, {verdict.candidate}{against}, {verdict.scenes} scenes{p}"]
    for stratum in verdict.strata:
        mine, theirs = stratum.candidate, stratum.champion
        before = f" (champion {theirs.rate:.3f})" if theirs else ""
        loss = "" if stratum.loss_upper is None else f", loss at most {stratum.loss_upper:.3f}"
        pairs = f", fixed {stratum.fixed}, broken {stratum.broken}" if theirs else ""
        lines.append(f"  {stratum.stratum:<10} {mine.successes}/{mine.n} = {mine.rate:.3f}{before}{pairs}{loss}")
    if verdict.more_scenes:
        lines.append(f"  about {verdict.more_scenes} more scenes would decide")
    return lines


def show_result(console: Console, result: LoopResult, verdict: Verdict | None, report: Path | None, *,
                legged: bool = False) -> None:
    """Everything a finished loop has to say on a screen; a legged robot succeeds where it does not fall."""
    what = "Attempts without a fall" if legged else "Success"
    console.print(success_table(result.generations,
                                f"{what} in the exam by generation, with 95 % intervals (mix: as in deployment)"))
    if result.control:
        new = "many steps of PPO at drawn starts" if legged else "many new episodes at random starts"
        console.print(success_table(result.control, f"Control: as {new}"))
    console.print(chart(result.generations))
    last, paired = result.generations[-1], result.paired
    asked = "" if legged else f", {last.corrections} corrections asked for"
    console.print(f"Robot time {duration(last.robot_s)}{asked}", highlight=False)
    console.print(
        f"Generation 0 against the last on the same starts: {paired.fixed} fixed, {paired.broken} broken, "
        f"p = {paired.p:.2g} (this pair of policies, nothing more)",
        highlight=False,
    )
    for line in verdict_lines(verdict) if verdict else []:
        console.print(Text(line))
    if result.shadow is not None:
        console.print(Text(f"Shadow: {result.shadow.says}"), soft_wrap=True)
    if result.worth is not None:
        console.print(Text(f"Worth of the last batch: {result.worth.says}"), soft_wrap=True)
    console.print(
        f"{duration(result.wall_s)}, {result.peak_pss_mb:.0f} MB at most, seed {result.seed}, twin {result.twin}",
        highlight=False,
    )
    if report is not None:
        console.print(Text(f"Report: {report}"), soft_wrap=True)
