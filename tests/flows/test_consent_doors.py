"""Every door to a training set, with real recordings in a real store: nobody is learnt from who does not agree."""

import json
from datetime import UTC, date, datetime
from types import SimpleNamespace

import pytest

from flows.run import learning, working
from flows.run.arm_run import ArmRun, run_id
from flows.run.arms import LOOP
from flows.run.facts import software
from pipeline.consent import Consents
from pipeline.errors import ConsentError
from pipeline.recording import read_attachments, read_episode, write_episode
from pipeline.shards import write_shard
from pipeline.simulation.tasks import load_task
from pipeline.store import Store
from schemas.consent import Consent
from schemas.episode import Outcome, Segment
from schemas.recipe import AugmentConfig, CollectConfig, DatasetConfig, HarvestConfig, Recipe, TrainConfig
from stages.build import build, load_version
from stages.collect import collect

RECIPE = Recipe(name="doors", collect=CollectConfig(demonstrations=4), augment=AugmentConfig(replays=6, retargets=0),
                dataset=DatasetConfig(sources=("scripted", "teleop", "replayed", "retargeted", "corrected")),
                train=TrainConfig(steps=4, batch=8, width=8, checkpoint_every=4), harvest=HarvestConfig(corrections=2))
FORM = Consent(id="form-12", operator="ada", site="lab", purposes=("training",), given=date(2020, 1, 1),
               expires=date(2099, 12, 31))
WHILE_IT_HELD = datetime(2020, 6, 1, tzinfo=UTC)


def nothing(done, total):
    """No progress to show."""


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """Three scripted demonstrations that succeeded, in files."""
    made = collect(RECIPE, seed=0, folder=tmp_path_factory.mktemp("demonstrations"), software=software("collect"))
    good = [r for r in made if r.episode.outcome.label == "success"]
    assert len(good) >= 3
    return good[:3]


@pytest.fixture
def house(tmp_path, demonstrations):
    """A run of the loop with two scripted demonstrations; `person` adds what somebody did, under some consent."""
    run = run_id(RECIPE, 0, 4, LOOP)
    with Store.open(tmp_path / "store", create=True) as store, store.lease(run) as lease:
        arm = ArmRun(store, lease, RECIPE, 0, 4, LOOP)
        scripted = [r.episode for r in demonstrations[:2]]
        store.put_blobs([r.path for r in demonstrations[:2]])

        def person(consent="form-12", kind="demonstration", **changes):
            source, trace = read_episode(demonstrations[2].path)
            told = {"origin": "teleop", "consent": consent,
                    "segments": (Segment(kind=kind, start=0, stop=source.frames, actor="ada"),), **changes}
            episode = source.model_copy(update={"id": f"{len(list(tmp_path.iterdir())):016x}"} | told)
            path = tmp_path / f"{episode.id}.mcap"
            known = store.consents().get(consent)
            blob = write_episode(path, episode, trace, attachments=read_attachments(demonstrations[2].path),
                                 consent=known)
            store.put_blob(path)
            return episode.model_copy(update={"blob": blob})

        def finish(stage, episodes, generation=0):
            with store.commit(lease) as tx:
                tx.add_episodes(episodes)
                tx.finish_step(generation, stage, outputs={"ids": [e.id for e in episodes], "says": ""})

        yield SimpleNamespace(arm=arm, store=store, lease=lease, scripted=scripted, person=person, finish=finish)


def at_augment(house, consent):
    """Variants of what a person showed."""
    person = house.person(consent)
    house.finish("collect", [*house.scripted, person])

    def go():
        made = learning.augmented(house.arm, 0, nothing)
        with house.store.commit(house.lease) as tx:
            made.write(tx)
        variants = house.store.episodes(made.ids)
        assert all(v.consent == consent for v in variants if v.parent == person.id)
        return {str(v.parent) for v in variants} & {person.id}

    return go


def at_augment_near_corrections(house, consent):
    """Variants that begin where a person helped out after a policy had failed."""
    attempt = house.person("simulated", origin="deployed", segments=(
        Segment(kind="autonomous", start=0, stop=house.person().frames, actor="policy"),))
    correction = house.person(consent, "intervention", origin="corrected", parent=attempt.id, generation=0)
    house.finish("collect", house.scripted)
    house.finish("deploy", [attempt])
    house.finish("harvest", [correction])

    def go():
        made = learning.augmented(house.arm, 1, nothing)
        with house.store.commit(house.lease) as tx:
            made.write(tx)
        variants = [v for v in house.store.episodes(origin="retargeted") if correction.id in str(v.transform)]
        assert all(v.consent == consent for v in variants)
        return {correction.id for _ in variants}

    return go


def at_build(house, consent):
    """A dataset version of what a person showed."""
    person = house.person(consent)
    house.finish("collect", [*house.scripted, person])
    house.finish("augment", [])
    return lambda: {person.id} & set(built(house).episodes)


def at_build_of_a_variant(house, consent):
    """A variant that calls itself simulated, of what a person showed and the recipe leaves out."""
    person = house.person(consent, outcome=Outcome(label="failure", judged_by="operator"))
    house.finish("collect", [*house.scripted, person])
    frames = house.arm.material.frames(person)
    variant = person.model_copy(update={
        "id": "f" * 16, "origin": "replayed", "parent": person.id, "consent": "simulated", "transform": "replay",
        "outcome": Outcome(label="success", judged_by="simulator"),
        "segments": (Segment(kind="demonstration", start=0, stop=len(frames), actor="expert"),)})
    shard = house.arm.folder() / "variants.arrow"
    write_shard(shard, {variant.id: frames})
    house.finish("augment", [variant.model_copy(update={"blob": house.store.put_blob(shard)})])
    return lambda: {variant.id} & set(built(house).episodes)


def at_harvest(house, consent):
    """Corrections of an attempt in which a person had taken over."""
    first = house.person(consent)
    half = first.frames // 2
    attempt = house.person(consent, outcome=Outcome(label="failure", judged_by="operator", trigger="stall", tick=half,
                                                    family="stalled"),
                           segments=(Segment(kind="autonomous", start=0, stop=half, actor="policy"),
                                     Segment(kind="intervention", start=half, stop=first.frames, actor="ada")))
    house.finish("deploy", [attempt])

    def go():
        made = working.harvested(house.arm, 0, nothing)
        with house.store.commit(house.lease) as tx:
            made.write(tx)
        corrections = house.store.episodes(made.ids)
        assert all(c.consent == consent for c in corrections)
        return {str(c.parent) for c in corrections}

    return go


def built(house):
    made = learning.built(house.arm, 0)
    version = load_version(house.store.path(f"versions/{made.ids[0]}"))
    assert ("left out, their consent has ended" in made.says) == (len(version.episodes) < 3)
    return version


DOORS = (at_augment, at_augment_near_corrections, at_build, at_build_of_a_variant, at_harvest)
WORDS = [door.__name__.removeprefix("at_").replace("_", " ") for door in DOORS]


@pytest.mark.parametrize("door", DOORS, ids=WORDS)
def test_the_door_is_open_to_somebody_who_agrees(house, door):
    house.store.add_consent(FORM)
    assert len(door(house, "form-12")()) == 1


@pytest.mark.parametrize("door", DOORS, ids=WORDS)
@pytest.mark.parametrize(("record", "consent", "what"), [
    (None, "none", "has no consent record"),
    (None, "simulated", "has no consent record"),
    (FORM, "form-13", "has no consent record"),
    (FORM.model_copy(update={"purposes": ("review",)}), "form-12", "has no valid consent record"),
    (FORM.model_copy(update={"operator": "bob"}), "form-12", "has no valid consent record"),
], ids=["no consent", "a person called simulated", "an unknown record", "for another purpose", "of another person"])
def test_the_door_is_shut_to_somebody_who_never_agreed(house, door, record, consent, what):
    if record is not None:
        house.store.add_consent(record)
    go = door(house, consent)
    with pytest.raises(ConsentError) as caught:
        go()
    first, at, mend = str(caught.value).splitlines()
    assert what in first and first.endswith("it cannot be used for training")
    assert at.startswith("  at:   episode ")
    assert mend.startswith("  mend: leave the episode out, or ")
    assert not house.store.versions() and not list((house.store.root / "versions").iterdir())


@pytest.mark.parametrize("door", DOORS, ids=WORDS)
@pytest.mark.parametrize("how", ["revoked", "expired"])
def test_whose_consent_has_ended_is_passed_over(house, door, how):
    house.store.add_consent(FORM if how == "revoked" else FORM.model_copy(update={"expires": date(2020, 12, 31)}))
    go = door(house, "form-12")
    if how == "revoked":
        house.store.revoke_consent("form-12", datetime.now(UTC))
    assert go() == set()


def test_of_all_that_people_drove_only_what_they_agreed_to_enters_a_version(house):
    """Recordings of the store that belong to no lap: nobody asked for one of them by name, so none is refused."""
    other = {"id": "form-13", "purposes": ("evaluation",)}
    ended = {"id": "form-14", "expires": date(2020, 12, 31)}
    for record in (FORM, FORM.model_copy(update=other), FORM.model_copy(update=ended)):
        house.store.add_consent(record)
    drove = [house.person(consent) for consent in ("form-12", "form-13", "form-14", "none", "form-99", "simulated")]
    house.finish("collect", house.scripted)
    house.finish("augment", [])
    with house.store.commit(house.lease) as tx:
        tx.add_episodes(drove)
    assert set(built(house).episodes) == {drove[0].id, *(e.id for e in house.scripted)}
    house.store.revoke_consent("form-12", datetime.now(UTC))
    (version,) = learning.built(house.arm, 0).ids
    assert set(load_version(house.store.path(f"versions/{version}")).episodes) == {e.id for e in house.scripted}


@pytest.mark.parametrize("how", ["revoked", "expired"])
def test_a_version_is_trained_on_only_while_everybody_in_it_agrees(house, how):
    house.store.add_consent(FORM if how == "revoked" else FORM.model_copy(update={"expires": date(2020, 12, 31)}))
    person = house.person()
    house.finish("collect", [*house.scripted, person])
    version = build(house.store.episodes(), house.arm.material.frames, RECIPE, store=house.store.root,
                    task=load_task("pick-place").instruction, generation=0,
                    consents=Consents(house.store.consents(), WHILE_IT_HELD))
    with house.store.commit(house.lease) as tx:
        tx.add_version(version)
        tx.finish_step(0, "build", outputs={"ids": [version.id], "says": ""})
    if how == "revoked":
        assert learning.trained(house.arm, 0, nothing).ids
        house.store.revoke_consent("form-12", datetime.now(UTC))
    with pytest.raises(ConsentError) as caught:
        learning.trained(house.arm, 0, nothing)
    assert f"episode {person.id} has no valid consent record; it cannot be used for training" in str(caught.value)
    assert how in str(caught.value) and f"versions/{version.id}" in str(caught.value)
    assert "mend: leave the episode out, or look at the record: hardcase consent show form-12" in str(caught.value)


def test_people_add_list_show_and_revoke_consents(hardcase):
    words = ("consent", "add", "--operator", "ada", "--site", "lab", "--purpose", "training", "--purpose", "review",
             "--expires", "2099-12-31")
    added = hardcase(*words, "--id", "form-12", "--json")
    assert added.returncode == 0, added.stderr
    made = hardcase(*words).stdout.strip()
    assert made == hardcase(*words).stdout.strip(), "the same words make the same record"
    (first, second) = json.loads(hardcase("consent", "list", "--json").stdout)
    assert (first["id"], second["id"], first["purposes"]) == ("form-12", made, ["training", "review"])
    assert first["holds"]
    assert "consent form-12: holds\n  operator: ada at lab" in hardcase("consent", "show", "form-12").stdout
    assert "does not hold: consent form-12 was revoked on" in hardcase("consent", "revoke", "form-12").stdout
    shown = json.loads(hardcase("consent", "show", "form-12", "--json").stdout)
    assert (shown["holds"], shown["episodes"]) == (False, [])


@pytest.mark.parametrize(("arguments", "at", "mend"), [
    (("add", "--operator", "Ada Lovelace"), "--operator Ada Lovelace", "a pseudonym, never a person's name"),
    (("add", "--operator", "ada", "--purpose", "fun"), "--purpose fun", "training, evaluation, review"),
    (("add", "--operator", "ada", "--given", "2100-01-01"), "--expires", "a last day that is not before the first"),
    (("add", "--operator", "ada", "--given", "soon"), "--given", "--given 2027-12-31"),
    (("add", "--operator", "ada", "--id", "simulated"), "--id simulated", "'simulated' and 'none' are taken"),
], ids=["a real name", "purpose", "days", "no day", "reserved id"])
def test_a_consent_that_makes_no_sense_is_refused(hardcase, arguments, at, mend):
    done = hardcase("consent", *arguments, "--site", "lab", "--purpose", "training", "--expires", "2099-12-31")
    what, where, way = done.stderr.splitlines()
    assert done.returncode == 2 and what
    assert where == f"  at:   {at}"
    assert mend in way


def test_show_lists_what_rests_on_a_consent(house, tmp_path, hardcase):
    house.store.add_consent(FORM)
    person = house.person()
    house.finish("collect", [*house.scripted, person])
    house.finish("augment", [])
    made = learning.built(house.arm, 0)
    with house.store.commit(house.lease) as tx:
        made.write(tx)
    shown = json.loads(hardcase("consent", "show", "form-12", "--json").stdout)
    assert (shown["episodes"], shown["versions"]) == ([person.id], list(made.ids))
