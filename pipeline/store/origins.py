"""Where things of other kinds come from: consents, conversions, verdicts of checks and on batches, erasures."""

from pipeline.store.facts import made, some
from pipeline.store.reader import Reader
from pipeline.store.tree import Lineage
from schemas.finding import CheckVerdict
from schemas.worth import BatchWorth, WorthPart


def tell_consent(store: Reader, id: str, full: bool) -> Lineage:
    """What a person allowed; nothing is behind it."""
    c = store.consent(id)
    return Lineage(kind="consent", id=id, facts={
        "operator": f"{c.operator} at {c.site}", "for": ", ".join(c.purposes),
        "holds": f"from {c.given} to {c.expires}", **({"revoked": str(c.revoked)} if c.revoked else {})})


def tell_conversion(store: Reader, id: str, full: bool) -> Lineage:
    """What was made of a foreign log, by which reading of it."""
    c = store.conversion(id)
    assert c is not None, "it was found by its id"
    log = store.raw_log(c.log)
    facts = {"state": f"{c.state}{': ' + c.reason if c.reason else ''}", "reading": c.reads, "code": c.code,
             "files": some([f"{name} {sha if full else sha[:12]}" for name, sha in sorted(c.files.items())], full)}
    source = {"size": f"{log.size_bytes} B", "first ingested from": log.source} if log else {}
    return Lineage(kind="conversion", id=id, facts=facts,
                   children=(Lineage(kind="raw_log", id=c.log, role="made of", facts=source),))


def tell_check(store: Reader, id: str, full: bool) -> Lineage:
    """What the checks found of one file or folder, and whether a later verdict stands in its place."""
    ((text,),) = store.query("SELECT json FROM checked WHERE id = ?", (id,))
    v = CheckVerdict.model_validate_json(str(text))
    last = store.checks([v.subject])[v.subject]
    facts = {"verdict": "passed" if v.passed else f"FAILED: {v.reason}", "of": f"{v.kind} {v.name}",
             "subject": v.subject, "contract": v.contract, "code": v.code,
             "checks": f"{len(v.checks)}, {len(v.skipped)} had nothing to look at",
             **({} if last.id == id else {"replaced by": last.id}),
             **{f"finding {k}": f.line() for k, f in enumerate(v.findings[:None if full else 3], 1)}}
    return Lineage(kind="checked", id=id, facts=facts)


def tell_worth(store: Reader, id: str, full: bool) -> Lineage:
    """What a batch was found to be worth, and whether a later verdict stands in its place."""
    ((text,),) = store.query("SELECT json FROM worth WHERE id = ?", (id,))
    w = BatchWorth.model_validate_json(str(text))
    last = next(other for other in store.worths() if other.batch == w.batch)
    facts = {"verdict": f"{w.decision}: {w.reason}", "batch": f"{w.says}, {len(w.episodes)} episodes",
             "episodes": some(w.episodes, full), "seeds": f"{len(w.seeds_with)} with, {len(w.seeds_without)} without",
             **{p.name: _part(p, "solved") for p in w.parts}, **{p.name: _part(p, "ended so") for p in w.families},
             **({} if last.id == id else {"replaced by": last.id})}
    return Lineage(kind="worth", id=id, facts=facts,
                   children=(Lineage(kind="version", id=w.version, role="measured in", facts={}),))


def _part(p: WorthPart, what: str) -> str:
    """Scenes of each seed, then the difference."""
    sides = f"{', '.join(map(str, p.with_batch))} against {', '.join(map(str, p.without))} of {p.scenes} {what}"
    interval = "" if p.low is None or p.high is None else f" [{p.low:+.3f} {p.high:+.3f}]"
    return f"{sides}; {p.difference:+.3f}{interval}" + ("" if p.p_holm is None else f", corrected p {p.p_holm:.2g}")


def tell_erased(store: Reader, id: str, full: bool) -> Lineage:
    """When and why something was forgotten, and what went with it."""
    e = store.erased([id])[id]
    kind = str(store.query("SELECT kind FROM erased WHERE id = ?", (id,))[0][0])
    unfinished = store.query("SELECT 1 FROM erasure WHERE id = ? AND state <> 'done'", (e.id,))
    facts = {
        "was": kind.replace("_", " "), "forgotten": f"on {e.at.date()}: {e.reason}",
        **({"unfinished": f"it was cut off; finish it: hardcase forget {e.episode} --yes"} if unfinished else {}),
        "asked for": f"episode {e.episode}",
        "went with it": f"{len(e.episodes)} episodes, {len(e.blobs)} files: {some(e.episodes, full)}",
        "versions that are incomplete": some(e.versions, full) or "none",
        "policies that saw it": some(e.policies, full) or "none",
        **made(store, kind, id),
    }
    return Lineage(kind="erased", id=id, facts=facts)
