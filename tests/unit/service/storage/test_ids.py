"""Identifiers are in the order in which they were made, which lists rely on."""

from service.storage.ids import new_id


def test_identifiers_of_one_millisecond_are_in_the_order_of_their_making() -> None:
    made = [new_id("aud") for _ in range(3000)]
    assert made == sorted(made)
    assert len(set(made)) == len(made)
    assert {len(one) for one in made} == {30}
