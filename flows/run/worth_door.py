"""The door between a batch that hurts and a release, on the training side of a lap."""

from collections.abc import Sequence

from flows.run.arm_run import ArmRun, Made, no_rows
from pipeline.errors import GateError
from schemas.episode import Episode
from schemas.verdict import Verdict
from schemas.worth import BatchWorth


def spared(run: ArmRun, episodes: Sequence[Episode]) -> tuple[list[Episode], str]:
    """The episodes without those of batches that hurt, and what a stage says of the others; '' where there are none."""
    wanted = run.recipe.dataset.sources
    out = run.material.worths().against(episodes)
    told = {w.id: w for e in episodes if e.origin in wanted and (w := out.get(e.id)) is not None}
    kept = [e for e in episodes if e.id not in out]
    count = sum(e.origin in wanted and e.id in out for e in episodes)
    return kept, f"; {count} left out, they hurt: {'; '.join(map(line, told.values()))}" if told else ""


def held_back(run: ArmRun, verdict: Verdict) -> Made | None:
    """What comes of a candidate that learnt from a batch which hurts: it is not released. None for any other.

    Raises:
        GateError: there is no champion that could stay.
    """
    version = run.store.version(run.store.policy(verdict.candidate).dataset)
    bad = run.material.worths().in_version(version)
    if bad is None:
        return None
    champion = run.store.champion(run.run)
    if champion is None:
        raise GateError(f"{verdict.candidate} learnt from a batch that hurts: {line(bad)}", where=f"run {run.run}",
                        mend=f"derive a version without it, or judge it again: hardcase worth {bad.version}")
    return Made((champion.policy,), f"{verdict.decision}, but the candidate learnt from a batch that hurts: "
                f"{line(bad)}; the champion stays", {"released": False, "worth": bad.id}, no_rows)


def line(worth: BatchWorth) -> str:
    """A verdict in one line."""
    return f"{worth.says} ({worth.id}) {worth.reason}"
