"""Pages of a raw record: whatever is wrong with one shows."""

import pytest

from drivers.errors import BusError
from drivers.pages import PAGE_BYTES, page_data, paged, paged_bytes


def _cut(pages: bytes) -> list[bytes]:
    return [pages[at : at + PAGE_BYTES] for at in range(0, len(pages), PAGE_BYTES)]


@pytest.mark.parametrize("size", [0, 2, 246, 248, 12_000])
def test_a_record_is_put_together_from_its_pages(size: int) -> None:
    record = bytes(k % 251 for k in range(size))
    pages = paged(7, record)
    assert len(pages) == paged_bytes(size)
    assert b"".join(page_data(7, k, page) for k, page in enumerate(_cut(pages))) == record


def test_a_page_that_is_not_what_was_asked_for_is_refused() -> None:
    first, second, *_ = _cut(paged(7, bytes(1000)))
    assert page_data(7, 0, first) == bytes(246)
    flipped = bytes([first[0] ^ 1]) + first[1:]
    for result, number, page in ((7, 0, flipped), (7, 0, second), (7, 1, first), (8, 0, first), (7, 0, b"")):
        with pytest.raises(BusError, match=f"page {number} of the raw record"):
            page_data(result, number, page)
