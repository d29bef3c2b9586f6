"""Release: who is champion from now on, as values; moving the pointer atomically is the store's part."""

from collections.abc import Sequence

from pipeline.errors import GateError
from schemas.policy import PolicyRecord
from schemas.release import Release
from schemas.verdict import Verdict


def release(verdict: Verdict, champion: Release | None, policy: PolicyRecord) -> Release:
    """The release that a verdict earned.

    Args:
        verdict: PASS against the present champion, or BOOTSTRAP where there is none.
        champion: the latest release, None before the first.
        policy: the candidate of the verdict.

    Raises:
        GateError: the verdict is FAIL or INCONCLUSIVE, speaks of another policy or of a champion that is no longer
            one, or the policy holds no single ONNX file.
    """
    where = f"verdict {verdict.id}"
    if verdict.candidate != policy.id:
        raise GateError(f"the verdict judged {verdict.candidate}, not {policy.id}", where=where,
                        mend="gate this policy first: hardcase gate")
    if verdict.decision not in ("PASS", "BOOTSTRAP"):
        raise GateError(f"{policy.id} is not released: {verdict.decision}, {verdict.reason}", where=where,
                        mend=_mend(verdict))
    holder = champion.policy if champion is not None else None
    if verdict.champion != holder:
        raise GateError(f"the verdict compared with {verdict.champion or 'nobody'}, the champion is "
                        f"{holder or 'nobody'}", where=where,
                        mend="gate it against the present champion: hardcase gate")
    if policy.id == holder:
        raise GateError(f"{policy.id} is the champion already", where=where, mend="nothing to do: deploy it")
    return Release(number=champion.number + 1 if champion is not None else 1, policy=policy.id, previous=holder,
                   verdict=verdict.id, kind="promotion" if champion is not None else "bootstrap", onnx=_onnx(policy))


def rollback(history: Sequence[Release]) -> Release:
    """The release that puts the champion before the present one back; the number grows, nothing is erased.

    Rolling back twice goes back twice: promotions are stacked and a rollback takes the top one off for good.

    Args:
        history: every release of the run, by rising number.

    Raises:
        GateError: nothing was released before the present champion, or the history has gaps or is out of order.
    """
    standing = _standing(history)
    if len(standing) < 2:
        what = f"{standing[0].policy} is the first champion" if standing else "nothing was released yet"
        raise GateError(f"no earlier champion: {what}", where="release history",
                        mend="there is nothing to go back to; train and gate a better policy: hardcase train")
    target = standing[-2]
    return Release(number=len(history) + 1, policy=target.policy, previous=standing[-1].policy,
                   verdict=target.verdict, kind="rollback", onnx=target.onnx)


def return_to(history: Sequence[Release], policy: str, verdict: str) -> Release:
    """The release that puts a former champion back, past all that were promoted since; nothing is erased.

    Args:
        history: every release of the run, by rising number.
        policy: a champion that stands below the present one: the anchor.
        verdict: what found it better than the present one.

    Raises:
        GateError: it never was champion, it is champion now, or the history has gaps or is out of order.
    """
    standing = _standing(history)
    target = next((r for r in reversed(standing[:-1]) if r.policy == policy), None)
    if target is None or standing[-1].policy == policy:
        raise GateError(f"{policy} does not stand below the present champion", where="release history",
                        mend=f"return to one of: {', '.join(r.policy for r in standing[:-1]) or 'none was before it'}")
    return Release(number=len(history) + 1, policy=policy, previous=standing[-1].policy, verdict=verdict,
                   kind="rollback", onnx=target.onnx)


def _standing(history: Sequence[Release]) -> list[Release]:
    """The promotions that were not taken back, the present champion last."""
    if [r.number for r in history] != list(range(1, len(history) + 1)):
        raise GateError(f"releases {[r.number for r in history]} are not 1, 2, 3, ...", where="release history",
                        mend="give every release of the run in order; if one is missing: hardcase doctor")
    standing: list[Release] = []
    for step in history:
        if step.kind != "rollback":
            standing.append(step)
            continue
        standing.pop()
        while standing and standing[-1].policy != step.policy:
            standing.pop()
    return standing


def _mend(verdict: Verdict) -> str:
    """What to do with a candidate that did not pass."""
    if verdict.champion is None:
        return "teach it better first: more collect.demonstrations, augment.replays or train.steps in the recipe"
    if verdict.tonight is not None:
        return "the champion stays until a night promotes; tomorrow's candidate gets a stake of its own: hardcase night"
    if verdict.decision == "INCONCLUSIVE" and verdict.more_scenes is not None:
        total = verdict.scenes + verdict.more_scenes
        return f"the champion stays; gate on more scenes (a look at {total} in gate.looks), or train the next candidate"
    return "the champion stays; learn from its failures: hardcase harvest, then build, train and gate"


def _onnx(policy: PolicyRecord) -> str:
    """The one ONNX file of a policy, relative to the store's root."""
    names = sorted(name for name in policy.files if name.endswith(".onnx"))
    if len(names) != 1:
        raise GateError(f"{len(names)} ONNX files instead of one", where=f"{policy.checkpoint} of policy {policy.id}",
                        mend="train it again, training exports the ONNX file: hardcase train")
    return f"{policy.checkpoint}/{names[0]}"
