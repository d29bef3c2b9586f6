"""Reading the catalog: by id, by filter, by the beginning of an id."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from json import dumps

from pipeline.errors import StoreError
from pipeline.store.catalog import Catalog
from pipeline.store.checks import check_history, checks_of
from pipeline.store.consents import consents, unknown_consent
from pipeline.store.erasures import erased, erased_in, forgotten
from pipeline.store.folder import check_id, check_prefix
from pipeline.store.ingests import conversion, conversions, ingestion_of, raw_log
from pipeline.store.records import RunInfo, StepManifest
from pipeline.store.worths import hurting, worths
from schemas.base import Frozen
from schemas.consent import Consent
from schemas.conversion import Conversion, Ingestion, RawLog
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.erasure import Erasure
from schemas.finding import CheckVerdict
from schemas.hardcase import HardCase
from schemas.mining import Family, RegressionScene
from schemas.night import Night
from schemas.policy import PolicyRecord
from schemas.release import Release
from schemas.verdict import Verdict
from schemas.worth import BatchWorth

TABLES = ("policy", "version", "verdict", "hard_case", "episode", "run", "raw_log", "conversion", "checked",
          "worth", "consent", "erased")
"""Tables whose rows have an id, in the order in which `find` looks."""

_NAMED = {"erased": " AND kind <> 'blob'"}
"""Table -> which of its rows a person may ask for."""


class Reader:
    """What can be asked of a store. Every method raises StoreError."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog

    def run(self, run: str) -> RunInfo:
        """A run as it was first invoked."""
        rows = self.query("SELECT json FROM run WHERE id = ?", (check_id("run", run),))
        if not rows:
            raise self._unknown("run", run)
        return RunInfo.model_validate_json(str(rows[0][0]))

    def runs(self) -> dict[str, RunInfo]:
        """Every run, as it was first invoked."""
        rows = self.query("SELECT id, json FROM run ORDER BY rowid")
        return {str(id): RunInfo.model_validate_json(str(text)) for id, text in rows}

    def history(self, run: str) -> list[RunInfo]:
        """Every invocation of a run that differs from the one before: what resumed it, on which versions."""
        rows = self.query("SELECT json FROM invocation WHERE run = ? ORDER BY number", (check_id("run", run),))
        return [RunInfo.model_validate_json(str(text)) for (text,) in rows]

    def step(self, run: str, generation: int, stage: str) -> StepManifest | None:
        """The manifest of a step, or None when it is not finished."""
        rows = self.query(
            "SELECT json FROM step WHERE (run, generation, stage) = (?, ?, ?)",
            (check_id("run", run), generation, stage),
        )
        return StepManifest.model_validate_json(str(rows[0][0])) if rows else None

    def steps(self, run: str) -> list[StepManifest]:
        """All finished steps of a run, in the order they were finished."""
        rows = self.query("SELECT json FROM step WHERE run = ? ORDER BY rowid", (check_id("run", run),))
        return [StepManifest.model_validate_json(str(text)) for (text,) in rows]

    def episode(self, id: str) -> Episode:
        """One attempt."""
        return self._one("episode", Episode, id)

    def episodes(
        self,
        ids: Iterable[str] | None = None,
        *,
        run: str | None = None,
        generation: int | None = None,
        origin: str | None = None,
        label: str | None = None,
        stratum: str | None = None,
        parent: str | None = None,
        policy: str | None = None,
    ) -> list[Episode]:
        """Attempts by their ids, in that order; else those that match all that is given, in the order of adding."""
        if ids is not None:
            return self._listed("episode", Episode, list(ids))
        where = {
            "generation": generation,
            "origin": origin,
            "label": label,
            "stratum": stratum,
            "parent": parent,
            "policy": policy,
        }
        return self._matching("episode", Episode, where, run)

    def version(self, id: str) -> DatasetVersion:
        """One dataset version."""
        return self._one("version", DatasetVersion, id)

    def versions(self, *, run: str | None = None, generation: int | None = None) -> list[DatasetVersion]:
        """Dataset versions, in the order they were added."""
        return self._matching("version", DatasetVersion, {"generation": generation}, run)

    def policy(self, id: str) -> PolicyRecord:
        """One policy."""
        return self._one("policy", PolicyRecord, id)

    def policies(
        self, *, run: str | None = None, generation: int | None = None, dataset: str | None = None
    ) -> list[PolicyRecord]:
        """Policies, in the order they were added."""
        return self._matching("policy", PolicyRecord, {"generation": generation, "dataset": dataset}, run)

    def verdict(self, id: str) -> Verdict:
        """One verdict of the gate."""
        return self._one("verdict", Verdict, id)

    def verdicts(
        self, *, run: str | None = None, generation: int | None = None, candidate: str | None = None
    ) -> list[Verdict]:
        """Verdicts, in the order they were added."""
        return self._matching("verdict", Verdict, {"generation": generation, "candidate": candidate}, run)

    def hard_cases(
        self,
        *,
        run: str | None = None,
        generation: int | None = None,
        family: str | None = None,
        corrected: bool | None = None,
        episode: str | None = None,
    ) -> list[HardCase]:
        """Hard cases, in the order they were added."""
        where = {
            "generation": generation,
            "family": family,
            "episode": episode,
            "corrected": None if corrected is None else int(corrected),
        }
        return self._matching("hard_case", HardCase, where, run)

    def hard_case(self, id: str) -> HardCase:
        """One hard case."""
        return self._one("hard_case", HardCase, id)

    def families(self, *, run: str | None = None) -> list[Family]:
        """Failure families that were found, in the order they were added."""
        return self._matching("failure_family", Family, {}, run)

    def regression_scenes(self, *, run: str | None = None) -> list[RegressionScene]:
        """Scenes that a release has fixed and that none may lose unsaid, in the order they were added."""
        return self._matching("regression_scene", RegressionScene, {}, run)

    def releases(self, run: str) -> list[Release]:
        """Every movement of a run's champion pointer, oldest first."""
        rows = self.query("SELECT json FROM release WHERE run = ? ORDER BY number", (check_id("run", run),))
        return [Release.model_validate_json(str(text)) for (text,) in rows]

    def nights(self, run: str) -> list[Night]:
        """What every night of a run did with its error budget, oldest first."""
        rows = self.query("SELECT json FROM night WHERE run = ? ORDER BY generation", (check_id("run", run),))
        return [Night.model_validate_json(str(text)) for (text,) in rows]

    def champion(self, run: str) -> Release | None:
        """The last release of a run, or None before the first."""
        return next(reversed(self.releases(run)), None)

    def consents(self) -> dict[str, Consent]:
        """Id -> what a person consented to, in the order of adding; revoked and expired records stay."""
        return consents(self._catalog)

    def consent(self, id: str) -> Consent:
        """One person's consent."""
        found = self.consents().get(id)
        if found is None:
            raise unknown_consent(self._catalog, id)
        return found

    def checks(self, subjects: Iterable[str]) -> dict[str, CheckVerdict]:
        """Hash of a recording or dataset -> the last verdict on it, for those that were checked."""
        return checks_of(self._catalog, subjects)

    def check_history(self, subject: str) -> list[CheckVerdict]:
        """Every verdict on a recording or dataset, the last one last."""
        return check_history(self._catalog, subject)

    def worths(self, *, last: bool = True) -> list[BatchWorth]:
        """The last verdict on every batch that was judged, or every verdict, oldest first."""
        return worths(self._catalog, last=last)

    def hurting(self) -> list[BatchWorth]:
        """The batches that are kept out: those whose last verdict is HURTS."""
        return hurting(self._catalog)

    def raw_log(self, id: str) -> RawLog | None:
        """A foreign log by its whole hash, or None."""
        return raw_log(self._catalog, id)

    def conversion(self, id: str) -> Conversion | None:
        """What was made of a foreign log, or None where nothing has this id yet."""
        return conversion(self._catalog, id)

    def conversions(self, log: str) -> list[Conversion]:
        """Everything that was ever made of a foreign log, oldest first."""
        return conversions(self._catalog, log)

    def ingestion_of(self, episode: Episode) -> Ingestion | None:
        """What made an ingested episode; None for any other."""
        return ingestion_of(self._catalog, episode)

    def log_of(self, episode: Episode) -> str | None:
        """The raw log that an ingested episode was made of, by hash; None for any other."""
        ingestion = self.ingestion_of(episode)
        made = self.conversion(ingestion.conversion) if ingestion else None
        return made.log if made else None

    def erased(self, ids: Iterable[str]) -> dict[str, Erasure]:
        """Those of some ids or hashes that were forgotten -> when, why, and what went with them."""
        return erased(self._catalog, ids)

    def erased_in(self, version: str) -> dict[str, Erasure]:
        """Episodes that a dataset version held until they were forgotten -> the erasure."""
        return erased_in(self._catalog, version)

    def query(self, sql: str, parameters: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
        """Rows of the catalog; for lineage, garbage and reports, which ask across tables. Reading only."""
        return self._catalog.rows(sql, parameters)

    def find(self, prefix: str, given: str = "") -> tuple[str, str]:
        """Table and whole id of what an id, or 8 and more of its first digits, names; `given` says where it was typed.

        Raises:
            StoreError: nothing or more than one thing begins so; the error lists them.
        """
        check_prefix(prefix, given)
        found = [
            (table, str(id))
            for table in TABLES
            for (id,) in self.query(f"SELECT id FROM {table} WHERE id >= ? AND id < ?{_NAMED.get(table, '')} LIMIT 5",
                                    (prefix, prefix + "g"))
        ]
        if not found:
            raise self._unknown("id", prefix)
        if len(found) > 1:
            names = ", ".join(f"{table} {id}" for table, id in found)
            raise StoreError(
                f"{len(found)} things begin with {prefix}", where=given or "the catalog",
                mend=f"use more digits: {names}",
            )
        return found[0]

    def _one[T: Frozen](self, table: str, model: type[T], id: str) -> T:
        rows = self.query(f"SELECT json FROM {table} WHERE id = ?", (check_id(table, id),))
        if not rows:
            raise self._unknown(table, id)
        return model.model_validate_json(str(rows[0][0]))

    def _listed[T: Frozen](self, table: str, model: type[T], ids: list[str]) -> list[T]:
        rows = self.query(f"SELECT id, json FROM {table} WHERE id IN (SELECT value FROM json_each(?))", (dumps(ids),))
        texts = {str(id): str(text) for id, text in rows}
        if missing := [id for id in ids if id not in texts]:
            raise self._unknown(table, missing[0])
        return [model.model_validate_json(texts[id]) for id in ids]

    def _matching[T: Frozen](
        self, table: str, model: type[T], where: Mapping[str, str | int | None], run: str | None
    ) -> list[T]:
        given = {column: value for column, value in where.items() if value is not None}
        tests = [f"{column} = ?" for column in given]
        if run is not None:
            tests.append("id IN (SELECT id FROM member WHERE run = ? AND kind = ?)")
        values = (*given.values(), *((check_id("run", run), table) if run is not None else ()))
        rows = self.query(f"SELECT json FROM {table} WHERE {' AND '.join(tests) or 'true'} ORDER BY place", values)
        return [model.model_validate_json(str(text)) for (text,) in rows]

    def _unknown(self, kind: str, id: str) -> StoreError:
        """The error for what is not there: it says if it was forgotten, or names what looks alike, or what there is."""
        if kind != "id" and (gone := self.erased([id])):
            return forgotten(id, kind.replace("_", " "), gone[id])
        tables = TABLES if kind == "id" else (kind,)
        ids = {str(i): t for t in tables for (i,) in self.query(f"SELECT id FROM {t} WHERE true{_NAMED.get(t, '')}")}
        near = [i for i in ids if i.startswith(id[:4])][:5] or get_close_matches(id, list(ids)[-5000:], n=5, cutoff=0.5)
        shown = near or list(ids)[-5:]
        listed = ", ".join(f"{ids[i]} {i}" for i in shown)
        mend = f"{'nearest' if near else 'the last'}: {listed}" if shown else "it holds none yet: hardcase loop"
        return StoreError(f"{kind} {id} is not in the store", where=self._catalog.path.parent, mend=mend)
