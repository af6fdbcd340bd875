"""Without keys only this machine is served, whatever a web page in its browser tries."""

import pytest

from service.access.errors import UnauthorisedError
from service.access.loopback import bound_to, must_be_this_machine

HERE = {"host": "127.0.0.1:8311"}


def refusal(address, headers) -> str:
    """What a caller is told; nothing where it is served."""
    try:
        must_be_this_machine(address, headers)
    except UnauthorisedError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("address", "headers"),
    [
        ("127.0.0.1", HERE),
        ("::1", {"host": "[::1]:8311"}),
        ("::ffff:127.0.0.1", {"host": "localhost:8311"}),
        ("127.0.0.1", HERE | {"origin": "http://127.0.0.1:8311", "sec-fetch-site": "same-origin"}),
        ("127.0.0.1", HERE | {"sec-fetch-site": "none"}),
    ],
)
def test_this_machine_is_served(address, headers):
    assert refusal(address, headers) == ""


@pytest.mark.parametrize(
    ("address", "headers"),
    [
        ("10.0.0.7", HERE),
        (None, HERE),
        ("127.0.0.1", {}),
        ("127.0.0.1", {"host": "rotor.example.org"}),  # a name that resolves to 127.0.0.1
        ("127.0.0.1", HERE | {"origin": "https://example.org"}),
        ("127.0.0.1", HERE | {"origin": "null"}),
        ("127.0.0.1", HERE | {"sec-fetch-site": "cross-site"}),
        ("127.0.0.1", {"host": "127.0.0.1.example.org"}),
        ("127.0.0.1", HERE | {"x-forwarded-for": "203.0.113.9"}),  # a proxy that asks for this machine by its address
        ("127.0.0.1", HERE | {"x-forwarded-proto": "https"}),
        ("127.0.0.1", HERE | {"forwarded": "for=203.0.113.9"}),
    ],
)
def test_elsewhere_is_told_to_make_a_key(address, headers):
    assert "ambit keys create" in refusal(address, headers)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "rig-pc"])
def test_without_keys_nothing_listens_to_the_network(host):
    address, notice = bound_to(host, any_key=False)
    assert address == "127.0.0.1"
    assert "no API key" in notice
    assert bound_to(host, any_key=True) == (host, "")
