"""A service without keys serves the person in front of it, and no web page that this person happens to have open."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from urllib.parse import urlsplit

from service.access.errors import UnauthorisedError

FIRST_KEY = "ambit keys create --scope admin"
_ALONE = "no API key exists: only this machine is served; make the first key with {}"
_NAMES = {"localhost"}
_SAME = {"", "none", "same-origin", "same-site"}


def is_loopback(host: str | None) -> bool:
    """Whether a host name or address is this machine's own.

    >>> [is_loopback(h) for h in ("127.0.0.1", "127.9.9.9", "::1", "localhost", "10.0.0.1", "example.org", None)]
    [True, True, True, True, False, False, False]
    """
    if host is None:
        return False
    if host.lower().rstrip(".") in _NAMES:
        return True
    try:
        address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback


def bound_to(host: str, any_key: bool, first_key: str = FIRST_KEY) -> tuple[str, str]:
    """Address to listen on, and what to tell the operator ("" for nothing): the command that makes the first key.

    >>> bound_to("0.0.0.0", any_key=True)
    ('0.0.0.0', '')
    >>> bound_to("0.0.0.0", any_key=False)[0]
    '127.0.0.1'
    """
    if any_key:
        return host, ""
    return (host if is_loopback(host) else "127.0.0.1"), _ALONE.format(first_key)


def must_be_this_machine(address: str | None, headers: Mapping[str, str]) -> None:
    """Refuse a request without a key that comes from elsewhere, or from a page of elsewhere in a browser here.

    The address alone does not tell: any page may send to 127.0.0.1, and by a name that resolves to it (DNS rebinding)
    even read the answer. So the name that was asked for, and the page that asked, must be of this machine too. A proxy
    here may hide all of that: whatever it passes on for others is refused.

    Parameters
    ----------
    address
        Of the caller, as the connection or a trusted proxy tells it.
    headers
        Of the request, names in lower case.

    Raises
    ------
    UnauthorisedError
        It comes from elsewhere, or through a proxy.
    """
    passed_on = [name for name in headers if name == "forwarded" or name.startswith("x-forwarded-")]
    if passed_on:
        raise UnauthorisedError(
            f"no API key exists, and {passed_on[0]} tells of a proxy: make the first key with {FIRST_KEY}"
        )
    asked_for = urlsplit(f"//{headers.get('host', '')}").hostname
    origin = headers.get("origin")
    from_page = None if origin is None else urlsplit(origin).hostname
    if (
        not is_loopback(address)
        or not is_loopback(asked_for)
        or (origin is not None and not is_loopback(from_page))
        or headers.get("sec-fetch-site", "") not in _SAME
    ):
        raise UnauthorisedError(_ALONE.format(FIRST_KEY))
