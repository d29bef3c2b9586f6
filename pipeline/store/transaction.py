"""One step's writes: rows are checked against what the catalog holds, and reach it together or not at all."""

import os
import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path

from pydantic import JsonValue

from pipeline.errors import StoreError
from pipeline.files import sync_folder
from pipeline.store.blobs import Blobs
from pipeline.store.erasures import refuse_forgotten
from pipeline.store.folder import FaultPoint, check_id, check_name, inside, shas_in
from pipeline.store.records import RunInfo, StepManifest
from pipeline.store.rows import Cell, insert, require, require_all
from schemas.base import Frozen
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.hardcase import HardCase
from schemas.mining import Family, RegressionScene
from schemas.night import Night
from schemas.policy import PolicyRecord
from schemas.release import Release
from schemas.verdict import Verdict


class Transaction:
    """The writes of one run; made by `Store.commit`, dead after it.

    Adding what is there already changes nothing; adding something else under the same id is an error.
    Every method raises StoreError.
    """

    def __init__(self, db: sqlite3.Connection, root: Path, blobs: Blobs, run: str, fault: FaultPoint) -> None:
        self._db, self._root, self._blobs, self._fault = db, root, blobs, fault
        self._run = check_id("run", run)
        self._new_blobs: set[str] = set()
        self._new_folders: set[Path] = set()
        self._members: list[tuple[str, str]] = []
        self._step: StepManifest | None = None

    def add_run(self, info: RunInfo) -> None:
        """Note that this run is invoked, before anything is added to it; a resumed run adds a line to its history."""
        text = info.model_dump_json()
        first = self._db.execute("SELECT json FROM run WHERE id = ?", (self._run,)).fetchone()
        if first is None:
            self._db.execute("INSERT INTO run VALUES (?, ?)", (self._run, text))
        elif not RunInfo.model_validate_json(first[0]).same_loop(info):
            raise StoreError(
                "one run id for two loops: recipe, seed, twin or control differ",
                where=f"run {self._run}",
                mend="the id of a run follows from recipe, seed, twin and control; resume with the same ones",
            )
        last = self._db.execute(
            "SELECT number, json FROM invocation WHERE run = ? ORDER BY number DESC", (self._run,)
        ).fetchone()
        if last is None or last[1] != text:
            self._db.execute("INSERT INTO invocation VALUES (?, ?, ?)", (self._run, last[0] + 1 if last else 1, text))

    def add_episodes(self, episodes: Iterable[Episode]) -> None:
        """Add attempts; parents may come in the same call, in any order; blobs must be in the store."""
        batch = list(episodes)
        refuse_forgotten(self._db, "episode", (e.id for e in batch))
        for e in batch:
            if e.policy:
                self._require("policy", e.policy, f"episode {e.id}")
            self._insert(
                "episode",
                e,
                id=e.id,
                origin=e.origin,
                generation=e.generation,
                label=e.outcome.label,
                stratum=e.scene.stratum,
                parent=e.parent,
                policy=e.policy,
                blob=e.blob,
            )
        for e in batch:
            if e.parent:
                self._require("episode", e.parent, f"parent of episode {e.id}")
        self._new_blobs.update(e.blob for e in batch if e.blob)

    def add_version(self, version: DatasetVersion) -> None:
        """Add a dataset version whose folder lies in the store already, whole."""
        if version.parent:
            self._require("version", version.parent, f"parent of version {version.id}")
        require_all(self._db, "episode", version.episodes, f"version {version.id}")
        self._insert("version", version, id=version.id, parent=version.parent, generation=version.generation)
        self._db.executemany(
            "INSERT OR IGNORE INTO version_episode VALUES (?, ?)", [(version.id, e) for e in version.episodes]
        )
        self._db.executemany(
            "INSERT OR IGNORE INTO version_input VALUES (?, ?)", [(version.id, b) for b in version.inputs]
        )
        self._new_blobs.update(version.inputs)
        self._new_folders.add(self._folder(version.path))

    def add_policy(self, policy: PolicyRecord) -> None:
        """Add a policy whose checkpoint folder lies in the store already, with every file of the record."""
        self._require("version", policy.dataset, f"policy {policy.id}")
        folder = self._folder(policy.checkpoint)
        for name in policy.files:
            if not inside(folder, name).is_file():
                raise StoreError(
                    f"file {name!r} of policy {policy.id} is missing",
                    where=folder,
                    mend="write the checkpoint folder before the record; then: hardcase loop --resume",
                )
        self._insert("policy", policy, id=policy.id, dataset=policy.dataset, generation=policy.generation)
        self._new_folders.add(folder)

    def add_verdict(self, verdict: Verdict) -> None:
        """Add what the gate found; candidate and champion are known policies."""
        self._require("policy", verdict.candidate, f"candidate of verdict {verdict.id}")
        if verdict.champion:
            self._require("policy", verdict.champion, f"champion of verdict {verdict.id}")
        self._insert(
            "verdict",
            verdict,
            id=verdict.id,
            candidate=verdict.candidate,
            generation=verdict.generation,
            decision=verdict.decision,
        )

    def add_release(self, release: Release) -> None:
        """Move this run's champion pointer: the number grows, and `previous` is the champion until now."""
        self._require("policy", release.policy, f"release {release.number}")
        if release.verdict:
            self._require("verdict", release.verdict, f"release {release.number}")
        inside(self._root, release.onnx)
        last = self._db.execute(
            "SELECT number, policy FROM release WHERE run = ? ORDER BY number DESC", (self._run,)
        ).fetchone()
        number, champion = last or (0, None)
        if release.number > number and release.previous != champion:
            raise StoreError(
                f"the champion is {champion}, not {release.previous}",
                where=f"release {release.number} of run {self._run}",
                mend="another release came between; look at it with `hardcase why`, then release again",
            )
        if release.number > number + 1:
            raise StoreError(
                f"release {release.number} follows release {number}",
                where=f"run {self._run}",
                mend=f"use the next number, {number + 1}",
            )
        self._insert(
            "release", release, key=("run", "number"), run=self._run, number=release.number, policy=release.policy
        )

    def add_night(self, night: Night) -> None:
        """Add what a night did with the error budget; its verdicts come in the same call or before."""
        for verdict in filter(None, (night.verdict, night.anchor_verdict)):
            self._require("verdict", verdict, f"night of generation {night.generation}")
        self._insert("night", night, key=("run", "generation"), run=self._run, generation=night.generation,
                     day=night.day)

    def add_hard_cases(self, cases: Iterable[HardCase]) -> None:
        """Add hard cases; a stored one without a correction takes one, and nothing else of it changes."""
        for case in cases:
            self._require("episode", case.episode, f"hard case {case.id}")
            if case.correction:
                self._require("episode", case.correction, f"correction of hard case {case.id}")
            self._correct(case)
            self._insert(
                "hard_case",
                case,
                id=case.id,
                episode=case.episode,
                correction=case.correction,
                family=case.family,
                stratum=case.stratum,
                generation=case.generation,
                corrected=int(case.corrected),
            )

    def add_families(self, families: Iterable[Family]) -> None:
        """Add failure families that a lap was the first to show; each goes with its medoid, if that is forgotten."""
        for family in families:
            self._require("episode", family.medoid, f"medoid of family {family.id}")
            self._insert("failure_family", family, id=family.id, medoid=family.medoid, generation=family.generation)

    def add_regression_scenes(self, scenes: Iterable[RegressionScene]) -> None:
        """Add scenes that a release has fixed; nothing but forgetting the attempt itself takes one away again."""
        for scene in scenes:
            self._require("hard_case", scene.hard_case, f"regression scene {scene.id}")
            self._require("policy", scene.fixed_by, f"regression scene {scene.id}")
            self._insert("regression_scene", scene, id=scene.id, hard_case=scene.hard_case,
                         generation=scene.generation)

    def finish_step(
        self,
        generation: int,
        stage: str,
        *,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, JsonValue] | None = None,
        code: str | None = None,
        wall_s: float = 0.0,
    ) -> StepManifest:
        """Mark a step as finished, with everything that this transaction adds as its work.

        Args:
            generation: the lap, from 0.
            stage: name of the stage.
            inputs: what was read, name -> id or hash.
            outputs: what a later step or a resumed run needs to know, ids and numbers.
            code: hash of the source files of the stage.
            wall_s: how long it took [s]; not compared when a step is finished twice.
        """
        step = StepManifest(
            run=self._run,
            generation=generation,
            stage=check_name("stage", stage),
            inputs=dict(inputs or {}),
            outputs=dict(outputs or {}),
            code=code,
            wall_s=wall_s,
        )
        known = self._db.execute(
            "SELECT json FROM step WHERE (run, generation, stage) = (?, ?, ?)", (self._run, generation, stage)
        ).fetchone()
        if known:
            old = StepManifest.model_validate_json(known[0])
            step = step.model_copy(update={"wall_s": old.wall_s})
        self._insert(
            "step", step, key=("run", "generation", "stage"), run=self._run, generation=generation, stage=stage
        )
        self._step = step
        self._new_blobs.update(sha for sha in shas_in(step.model_dump_json()) if self._blobs.path(sha).is_file())
        return step

    def settle(self) -> None:
        """Make durable what the rows speak of: blobs and folders. The store calls it before the commit."""
        if self._new_blobs:
            self._blobs.settle(sorted(self._new_blobs))
        for folder in sorted(self._new_folders):
            self._sync_tree(folder)
        for parent in sorted({f.parent for f in self._new_folders}):
            self._fault("fsync folder")
            sync_folder(parent)
        made = (self._step.generation, self._step.stage) if self._step else (None, None)
        self._db.executemany(
            "INSERT OR IGNORE INTO member VALUES (?, ?, ?, ?, ?)",
            [(self._run, kind, id, *made) for kind, id in self._members],
        )

    def _sync_tree(self, folder: Path) -> None:
        for at, _, names in os.walk(folder):
            for name in sorted(names):
                self._fault("fsync file")
                sync_folder(Path(at) / name)  # fsync of a file by its name: the same call
            sync_folder(Path(at))

    def _folder(self, relative: str) -> Path:
        path = inside(self._root, relative)
        if not path.is_dir():
            raise StoreError(
                f"folder {relative} is not in the store",
                where=path,
                mend="write the folder before its row; then: hardcase loop --resume",
            )
        return path

    def _correct(self, case: HardCase) -> None:
        known = self._db.execute("SELECT json FROM hard_case WHERE id = ?", (case.id,)).fetchone()
        if known and case.correction:
            old = HardCase.model_validate_json(known[0])
            if old.correction is None and old == case.model_copy(
                update={"correction": None, "corrected": old.corrected}
            ):
                self._db.execute(
                    "UPDATE hard_case SET correction = ?, corrected = ?, json = ? WHERE id = ?",
                    (case.correction, int(case.corrected), case.model_dump_json(), case.id),
                )

    def _require(self, table: str, id: str, where: str) -> None:
        require(self._db, table, id, where)

    def _insert(self, table: str, value: Frozen, /, *, key: tuple[str, ...] = ("id",), **row: Cell) -> None:
        if self._db.execute("SELECT 1 FROM run WHERE id = ?", (self._run,)).fetchone() is None:
            raise StoreError(
                f"run {self._run} is not in the store", where=f"{table} of it", mend="start it through: hardcase loop"
            )
        insert(self._db, table, value, key, row)
        if "id" in row:
            self._members.append((table, str(row["id"])))
