"""Who commits to a truth cannot change it, and who sees the commitment cannot learn it."""

import json
from hashlib import sha256

import pytest

from sim.withheld.seal import SealError, opened, seal

TRUTH = {"effects": ["loop_delay"], "parameters": {"loop_delay": {"delay_s": 3.5e-5}}}


def test_what_was_sealed_comes_out_again() -> None:
    sealed = seal(TRUTH)
    through_a_file = json.loads(json.dumps(sealed.document()))
    assert opened(through_a_file, sealed.commitment) == TRUTH


def test_another_truth_in_the_sealed_file_is_caught() -> None:
    sealed = seal(TRUTH)
    for better in ({"effects": ["sensor_lag"]}, {**TRUTH, "kind": "single"}, {}):
        forged = sealed.document() | {"truth": json.dumps(better, sort_keys=True)}
        with pytest.raises(SealError, match="was changed"):
            opened(forged, sealed.commitment)


def test_a_whole_new_seal_is_caught_by_the_commitment_shown_before() -> None:
    shown = seal(TRUTH).commitment
    forged = seal({"effects": ["sensor_lag"]}).document()
    with pytest.raises(SealError, match=shown[:12]):
        opened(forged, shown)


def test_another_nonce_is_caught() -> None:
    sealed = seal(TRUTH)
    with pytest.raises(SealError):
        opened(sealed.document() | {"nonce": "0" * 32}, sealed.commitment)


def test_the_commitment_does_not_tell_the_truth() -> None:
    first, second = seal(TRUTH), seal(TRUTH)
    assert first.commitment != second.commitment
    assert first.commitment != sha256(first.truth.encode()).hexdigest()


@pytest.mark.parametrize("broken", [{}, {"nonce": "ab"}, {"truth": "{}"}])
def test_a_document_with_parts_missing_is_refused(broken: dict[str, str]) -> None:
    with pytest.raises(SealError, match="has no"):
        opened(broken, "00")


@pytest.mark.parametrize(("text", "message"), [("[1]", "no JSON object"), ("{", "cannot be read")])
def test_a_truth_that_is_no_object_is_refused(text: str, message: str) -> None:
    from sim.withheld.seal import commitment_to

    with pytest.raises(SealError, match=message):
        opened({"nonce": "ab", "truth": text}, commitment_to("ab", text))


def test_a_commitment_is_read_as_it_was_copied() -> None:
    sealed = seal(TRUTH)
    assert opened(sealed.document(), f" {sealed.commitment.upper()}\n") == TRUTH
    with pytest.raises(SealError, match="was changed"):
        opened(sealed.document(), "é")
