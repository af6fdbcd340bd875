"""Which names a host can have, for whoever takes an address apart before it is used. No network is asked.

It stands below all who need it: the addresses of controllers, and those that the service sends messages to.
"""

from __future__ import annotations

LONGEST_PART = 63


def must_be_encodable(host: str) -> None:
    """Refuse a host that whoever connects to it fails to encode: it would come to grief there, time and again.

    Raises
    ------
    ValueError
        No network can know such a name; says why.

    >>> must_be_encodable("rig.plant.")
    >>> must_be_encodable("rig..plant")
    Traceback (most recent call last):
    ...
    ValueError: a part of the host 'rig..plant' is empty or longer than 63 letters
    """
    if any(letter.isspace() for letter in host):
        raise ValueError(f"the host {host!r} has a space")
    if "%" in host and ":" not in host:  # but for the zone of a link-local address, fe80::1%eth0
        raise ValueError(f"the host {host!r} has a % sign, which no host has; write the name as it is")
    import idna  # its tables: most who take an address apart have a number there

    name = host if host.isascii() else idna.encode(host.lower()).decode("ascii")
    parts = name.removesuffix(".").split(".")
    if not all(0 < len(part) <= LONGEST_PART for part in parts):  # as a socket sees to
        raise ValueError(f"a part of the host {host!r} is empty or longer than {LONGEST_PART} letters")
    for part in parts:
        if part.startswith("xn--"):
            idna.decode(part)
