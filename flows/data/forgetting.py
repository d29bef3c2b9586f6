"""hardcase forget: what would go, and its going."""

import json
from collections.abc import Callable
from datetime import UTC, datetime

from pipeline.errors import ConfigError
from pipeline.store import Store, store_root
from schemas.erasure import Erasure


def planned(episode: str, reason: str | None, *, with_log: bool) -> tuple[Erasure, bool]:
    """What forgetting an episode takes away, and whether it was ordered before and cut off.

    Raises:
        ConfigError: no reason is given.
        StoreError: there is nothing to forget under this id.
    """
    from pipeline.store.erasure_plan import plan_erasure

    with Store.open(store_root()) as store:
        for erasure in store.unfinished_erasures():
            if any(id.startswith(episode) for id in erasure.episodes):
                return erasure, True
        if reason is not None and not reason.strip():
            reason = None
        plan = plan_erasure(store, episode, (reason or "not told yet")[:500], datetime.now(UTC), with_log=with_log)
    if reason is None:
        raise ConfigError("why is it forgotten?", where=f"hardcase forget {episode}",
                          mend=f"say so: hardcase forget {episode} --reason \"asked by the person\"")
    return plan, False


def carried_out(erasure: Erasure, tell: Callable[[str], None]) -> dict[str, object]:
    """Do it; `tell` is told the steps. What machines would read.

    Raises:
        StoreError: a loop runs on this store, somebody writes in it, or a file cannot be deleted.
    """
    from pipeline.store.caches import cache_folder
    from stages.forget import forget

    with Store.open(store_root(), reserve_mb=0) as store:
        with store.lease(erasure.id, holder=f"hardcase forget {erasure.episode}", erases=True) as lease:
            done = forget(store, lease, erasure, caches=[cache_folder()], progress=tell)
        champions = [run for run in store.runs() if (top := store.champion(run)) and top.policy in erasure.policies]
    return json.loads(erasure.model_dump_json()) | {"freed": done.freed, "champion_of": champions}


def render(erasure: Erasure) -> str:
    """What goes, in lines that people read."""
    others = len(erasure.episodes) - 1
    lines = [f"forget episode {erasure.episode}: {erasure.reason}",
             f"  episodes: it and {others} that hold its frames or its start",
             f"  files: {len(erasure.blobs)} deleted, {len(erasure.shards)} shards of variants written without them",
             f"  hard cases: {len(erasure.hard_cases)}"]
    if erasure.raw_logs:
        lines.append(f"  raw logs: {', '.join(log[:12] for log in erasure.raw_logs)}, and what was made of them")
    lines.append(f"  versions that become incomplete: {', '.join(erasure.versions) or 'none'}")
    lines.append(f"  policies that saw it, and stay: {', '.join(erasure.policies) or 'none'}")
    lines.append(f"  reports of runs: {', '.join(erasure.runs) or 'none'}")
    lines.append("  copies: caches, leftovers of killed steps, and what lerobot copied for itself")
    return "\n".join(lines)


def render_done(done: dict[str, object], erasure: Erasure) -> str:
    """What is done and what a person should do now."""
    lines = [f"forgotten: {len(erasure.episodes)} episodes, {int(str(done['freed'])) / 1e6:.1f} MB of files"]
    if erasure.policies:
        lines.append(f"{len(erasure.policies)} policies saw it and stay: hardcase why {erasure.policies[-1]}")
    champion_of = done["champion_of"]
    if isinstance(champion_of, list) and champion_of:
        lines.append(f"one of them is the champion of run {', '.join(map(str, champion_of))}: train another, or "
                     "hardcase release --rollback")
    return "\n".join(lines)
