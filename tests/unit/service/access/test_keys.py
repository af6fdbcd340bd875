"""A key opens the service to its holder, as far as its scope reaches and as long as it is valid, and to nobody else."""

from datetime import UTC, datetime, timedelta

import pytest

from service.access import keys
from service.access.errors import ForbiddenError, UnauthorisedError
from service.access.keys import Scope

NOW = datetime(2026, 1, 1, tzinfo=UTC)
ID = "key_018f2a3b4c5d"


def test_holder_is_recognised():
    record, key = keys.issue(ID, "laptop", Scope.operator, NOW)
    assert keys.id_of(key) == ID
    assert keys.verify(key, record, NOW) == keys.Identity(ID, "laptop", Scope.operator)


def test_the_secret_is_kept_nowhere():
    record, key = keys.issue(ID, "laptop", Scope.operator, NOW)
    secret = key.rsplit("_", 1)[1]
    assert secret not in repr(record)
    assert len(secret) == 48
    assert keys.issue(ID, "laptop", Scope.operator, NOW)[1] != key


@pytest.mark.parametrize("spoil", [lambda k: k[:-1] + ("0" if k[-1] != "0" else "1"), lambda k: "", lambda k: k + "0"])
def test_another_secret_is_refused(spoil):
    record, key = keys.issue(ID, "laptop", Scope.operator, NOW)
    with pytest.raises(UnauthorisedError, match="not known"):
        keys.verify(spoil(key), record, NOW)


def test_unknown_key_and_wrong_secret_read_the_same():
    record, key = keys.issue(ID, "laptop", Scope.operator, NOW)
    _, other = keys.issue(ID, "laptop", Scope.operator, NOW)
    with pytest.raises(UnauthorisedError) as unknown:
        keys.verify(key, None, NOW)
    with pytest.raises(UnauthorisedError) as wrong:
        keys.verify(other, record, NOW)
    assert str(unknown.value) == str(wrong.value)


def test_a_record_does_not_open_for_the_key_of_another_id():
    record, _ = keys.issue(ID, "a", Scope.admin, NOW)
    _, other = keys.issue("key_ffffffffffff", "b", Scope.viewer, NOW)
    with pytest.raises(UnauthorisedError):
        keys.verify(other, record, NOW)


def test_expired_and_revoked_keys_are_refused():
    record, key = keys.issue(ID, "laptop", Scope.viewer, NOW, NOW + timedelta(days=1))
    keys.verify(key, record, NOW + timedelta(hours=23))
    with pytest.raises(UnauthorisedError, match="expired"):
        keys.verify(key, record, NOW + timedelta(days=1))
    revoked = keys.KeyRecord(**{**vars(record), "revoked": NOW})
    with pytest.raises(UnauthorisedError, match="revoked"):
        keys.verify(key, revoked, NOW)


def test_a_key_that_never_was_valid_is_not_made():
    with pytest.raises(ValueError, match="future"):
        keys.issue(ID, "laptop", Scope.viewer, NOW, NOW)


@pytest.mark.parametrize("header", [None, "", "Bearer", "Bearer ", "Basic dXNlcjpwYXNz", "ambit_x_y"])
def test_a_request_without_a_key_is_told_how_to_give_one(header):
    with pytest.raises(UnauthorisedError, match="Authorization: Bearer"):
        keys.bearer(header)


def test_scopes_rise():
    viewer = keys.Identity(ID, "eye", Scope.viewer)
    assert viewer.must_reach(Scope.viewer) is viewer
    with pytest.raises(ForbiddenError, match="needs the scope operator"):
        viewer.must_reach(Scope.operator)
    for scope in Scope:
        assert keys.LOCAL.must_reach(scope)
