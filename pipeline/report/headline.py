"""What the loop came to, in one honest sentence."""

from dataclasses import dataclass

from pipeline.report.data import ReportData
from pipeline.report.text import p_equals, points
from schemas.summary import Generation
from schemas.verdict import Proportion

SURE = 0.05
"""A paired p at or above this is not called a gain."""


@dataclass(frozen=True, slots=True)
class Headline:
    """The first screen of the report."""

    title: str
    sentence: str
    measure: str
    """Which success the numbers are: the deployment mix where it was measured."""
    first: Proportion | None
    last: Proportion | None


def success(generation: Generation) -> tuple[str, Proportion | None]:
    """The success that counts most, and its name."""
    for name in ("deployment_mix", "all"):
        if name in generation.success:
            return name, generation.success[name]
    return next(iter(generation.success.items()), ("success", None))


def headline(data: ReportData) -> Headline:
    """Compare the first generation with the last; claims a gain only where the paired test shows one."""
    laps = data.result.generations
    if not laps:
        return Headline("No generation was finished", "The loop ended before its first exam.", "success", None, None)
    (measure, first), (_, last) = success(laps[0]), success(laps[-1])
    if first is None or last is None:
        return Headline("No exam was sat", "No success was measured on the twin.", measure, None, None)
    if len(laps) == 1:
        return Headline("Generation 0 is ready", "One generation: there is nothing to compare with yet.", measure,
                        first, last)
    paired, gain = data.result.paired, last.rate - first.rate
    test = f"fixed {paired.fixed}, broken {paired.broken}, {p_equals(paired.p)}"
    if gain > 0 and paired.fixed > paired.broken and paired.p < SURE:
        return Headline("The robot got better", f"{points(gain)} from generation {laps[0].generation} to "
                        f"{laps[-1].generation}; on the same exam scenes: {test}.", measure, first, last)
    if gain > 0:
        return Headline("Higher, but not proven", f"{points(gain)}, yet the paired test on the same exam scenes does "
                        f"not show a gain: {test}.", measure, first, last)
    return Headline("The robot did not get better", f"{points(gain)} from generation {laps[0].generation} to "
                    f"{laps[-1].generation}; on the same exam scenes: {test}.", measure, first, last)

