"""Consent records in the store: added once, revoked for good, also while a loop holds the lease."""

from datetime import UTC, date, datetime

import pytest

from pipeline.errors import StoreError
from pipeline.store import Store
from schemas.consent import Consent

FORM = Consent(id="form-12", operator="ada", site="lab", purposes=("training", "review"), given=date(2026, 1, 1),
               expires=date(2026, 12, 31))
MAY = datetime(2026, 5, 1, 8, 30, tzinfo=UTC)


def test_a_record_comes_back_as_it_was_added(root, store):
    other = FORM.model_copy(update={"id": "form-13"})
    for record in (FORM, other, FORM):
        store.add_consent(record)
    store.close()
    with Store.open(root) as again:
        assert again.consents() == {"form-12": FORM, "form-13": other}
        assert again.consent("form-13") == other


def test_a_revocation_is_for_good_and_its_first_moment_counts(store):
    store.add_consent(FORM)
    assert store.revoke_consent("form-12", MAY) == store.consent("form-12")
    store.revoke_consent("form-12", datetime(2026, 7, 1, tzinfo=UTC))
    assert store.consent("form-12").revoked == MAY
    with pytest.raises(StoreError, match=r"form-12 was revoked(.|\n)*mend: .*hardcase consent add --id NEW"):
        store.add_consent(FORM)


def test_a_record_never_changes(store):
    store.add_consent(FORM)
    with pytest.raises(StoreError, match=r"in the store with another site(.|\n)*mend: what is stored never changes"):
        store.add_consent(FORM.model_copy(update={"site": "home"}))
    assert store.consent("form-12") == FORM


def test_an_unknown_record_lists_those_that_are_there(store):
    with pytest.raises(StoreError, match="mend: there is none yet: hardcase consent add"):
        store.consent("form-12")
    store.add_consent(FORM)
    for ask in (store.consent, lambda id: store.revoke_consent(id, MAY)):
        with pytest.raises(StoreError, match=r"consent form-1 is not in the store(.|\n)*mend: use one of: form-12"):
            ask("form-1")


def test_a_person_can_revoke_while_a_loop_runs(root, store, small):
    store.add_consent(FORM)
    with store.lease(small.run), Store.open(root) as second:
        second.revoke_consent("form-12", MAY)
    assert store.consent("form-12").revoked == MAY
