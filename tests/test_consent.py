"""What makes a consent hold, and how the one refusal reads."""

from datetime import UTC, date, datetime, timedelta, timezone

import pytest
from pydantic import ValidationError

from pipeline.consent import NO_CONSENTS, Consents, needs
from pipeline.errors import ConsentError
from schemas.consent import Consent
from schemas.episode import Episode, Origin, Outcome, Segment
from schemas.scene import SceneSpec

FORM = Consent(id="form-12", operator="ada", site="lab", purposes=("training",), given=date(2026, 1, 1),
               expires=date(2026, 12, 31))
NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
SCENE = SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                  object_xy_m=(0.3, 0.0), object_yaw_rad=0.1, object_half_m=0.02, target_xy_m=(0.3, 0.1))


def episode(k, origin: Origin = "teleop", consent="form-12", actor="ada", parent=None):
    return Episode(id=f"{k:016x}", origin=origin, scene=SCENE, control_hz=20, frames=3, generation=0, consent=consent,
                   outcome=Outcome(label="success", judged_by="operator"), parent=parent and f"{parent:016x}",
                   segments=(Segment(kind="demonstration", start=0, stop=3, actor=actor),))


def at(now=NOON, **changes):
    return Consents({"form-12": FORM.model_copy(update=changes)}, now)


@pytest.mark.parametrize("now", [
    datetime(2026, 1, 1, tzinfo=UTC), NOON, datetime(2026, 12, 31, 23, 59, tzinfo=UTC),
    datetime(2027, 1, 1, 1, tzinfo=timezone(timedelta(hours=2))),  # still the last day in UTC
], ids=["first moment", "between", "last moment", "another time zone"])
def test_a_consent_holds_from_its_first_day_to_the_end_of_its_last(now):
    at(now).check([episode(1)])


@pytest.mark.parametrize(("consents", "reason"), [
    (at(datetime(2027, 1, 1, tzinfo=UTC)), "consent form-12 expired on 2026-12-31"),
    (at(datetime(2025, 12, 31, 23, tzinfo=UTC)), "consent form-12 holds from 2026-01-01 on"),
    (at(revoked=datetime(2026, 5, 1, tzinfo=UTC)), "consent form-12 was revoked on 2026-05-01"),
    (at(purposes=("evaluation", "review")), "consent form-12 is for evaluation, review"),
    (at(operator="bob"), "consent form-12 is not of 'ada'"),
], ids=["expired", "not yet", "revoked", "another purpose", "another person"])
def test_a_consent_that_does_not_hold_is_refused_and_named(consents, reason):
    with pytest.raises(ConsentError) as caught:
        consents.check([episode(1)])
    assert str(caught.value).splitlines() == [
        "episode 0000000000000001 has no valid consent record; it cannot be used for training",
        f"  at:   episode 0000000000000001: {reason}",
        "  mend: leave the episode out, or look at the record: hardcase consent show form-12",
    ]


@pytest.mark.parametrize(("bad", "consent"), [
    (episode(1, consent="form-13"), "form-13"),
    (episode(1, consent="none"), "none"),
    (episode(1, consent="simulated"), "simulated"),
    (episode(1, origin="scripted", consent="simulated"), "simulated"),
], ids=["unknown record", "a person without consent", "a person called simulated", "a person called scripted"])
def test_an_episode_without_a_record_is_refused_in_the_promised_words(bad, consent):
    with pytest.raises(ConsentError) as caught:
        at().check([bad])
    assert str(caught.value).splitlines() == [
        "episode 0000000000000001 has no consent record; it cannot be used for training",
        f"  at:   episode 0000000000000001: its consent is {consent!r}",
        "  mend: leave the episode out, or have the person consent first: hardcase consent add, then record with "
        "--consent; of a foreign log, name it in the map: consent, operator",
    ]


@pytest.mark.parametrize("actor", ["expert", "stand-in"])
def test_what_nobody_but_a_simulator_made_needs_no_record(actor):
    NO_CONSENTS.check([episode(1, origin="scripted", consent="simulated", actor=actor)])


def test_what_was_made_from_an_episode_needs_the_consent_of_everybody_before_it():
    first = episode(1, consent="none")
    second = episode(2, origin="corrected", parent=1)
    variant = episode(3, origin="retargeted", consent="simulated", actor="expert", parent=2)
    at().check([variant], [second])
    with pytest.raises(ConsentError, match=r"episode 0000000000000003 .*no consent(.|\n)*made from episode 0{15}1"):
        at().check([variant], [second, first])
    assert needs([variant], [second, first])[variant.id] == ("form-12", "none")


def test_what_rests_on_a_consent_that_ended_is_left_out_and_what_never_had_one_is_not_hidden():
    ended = at(revoked=datetime(2026, 5, 1, tzinfo=UTC))
    mine, variant = episode(1), episode(2, origin="retargeted", consent="simulated", actor="expert", parent=1)
    other = episode(3, origin="scripted", consent="simulated", actor="expert")
    assert ended.standing([mine, variant, other]) == [other]
    assert at(datetime(2027, 1, 1, tzinfo=UTC)).standing([variant, other], [mine]) == [other]
    assert at().standing([mine, variant, other]) == [mine, variant, other]
    never = [episode(4, consent="none"), episode(5, consent="form-13")]
    assert ended.standing([mine, *never]) == never
    assert at(purposes=("review",)).standing([mine]) == [mine]


@pytest.mark.parametrize(("changes", "rule"), [
    ({"id": "simulated"}, "choose another id"), ({"id": "none"}, "choose another id"),
    ({"expires": date(2025, 1, 1)}, "expires 2025-01-01 is before given 2026-01-01"),
    ({"purposes": ()}, "purposes"), ({"operator": "Ada Lovelace"}, "operator"),
], ids=["simulated", "none", "dates", "no purpose", "a real name"])
def test_a_record_that_makes_no_sense_is_refused(changes, rule):
    with pytest.raises(ValidationError, match=rule):
        Consent.model_validate(FORM.model_dump() | changes)
