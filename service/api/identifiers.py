"""What an id looks like where one is asked for: its pattern for programs, and the same in words for people."""

from __future__ import annotations

import re

_LETTERS = "0-9a-hjkmnp-tv-z"
_EXAMPLE = "01k9abcdefghjkmnpqrstvwxyz"
KINDS = {
    "rig": "rig",
    "job": "job",
    "exp": "experiment",
    "mod": "model",
    "gap": "gap diagnosis",
    "hc": "health check",
    "sch": "schedule",
    "whd": "delivery",
    "aud": "line of the audit log",
}
ANY = rf"^[a-z]{{2,3}}_[{_LETTERS}]{{26}}[0-9a-z]*$"
"""Pattern of an id of any kind."""


def pattern(prefix: str) -> str:
    """Pattern of the ids of a kind: 128 bits in base 32, so that the first letter is 7 at most.

    >>> import re
    >>> bool(re.match(pattern("rig"), "rig_01k9abcdefghjkmnpqrstvwxyz")), bool(re.match(pattern("rig"), "rig_1"))
    (True, False)
    """
    more = "[0-9a-z]*" if prefix == "whd" else ""  # of several deliveries about one thing
    return rf"^{prefix}_[0-7][{_LETTERS}]{{25}}{more}$"


def place_pattern(prefix: str) -> str:
    """Pattern of a place in a list of a kind that is ordered by time: an id and µs since 1970.

    >>> import re
    >>> bool(re.match(place_pattern("exp"), "exp_01k9abcdefghjkmnpqrstvwxyz.1764547200000000"))
    True
    """
    return rf"{pattern(prefix)[:-1]}\.[0-9]{{1,16}}$"


def is_id(prefix: str, text: str) -> bool:
    """Whether a text is an id of a kind; a name or a file may begin as one.

    >>> is_id("exp", "exp_01k9abcdefghjkmnpqrstvwxyz"), is_id("exp", "exp_run3.h5")
    (True, False)
    """
    return re.fullmatch(pattern(prefix), text) is not None


def example(prefix: str) -> str:
    """An id of a kind.

    >>> example("job")
    'job_01k9abcdefghjkmnpqrstvwxyz'
    """
    return f"{prefix}_{_EXAMPLE}"


def _words(prefix: str) -> str:
    name = "; not its name" if prefix == "rig" else ""
    return f"the id of {_a(prefix)}, {prefix}_ and 26 digits and small letters, as {example(prefix)}{name}"


def _a(prefix: str) -> str:
    kind = KINDS[prefix]
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _place_words(prefix: str) -> str:
    return f"the id of {_a(prefix)} and when it was made, as {example(prefix)}.1764547200000000"


WORDS = {pattern(prefix): _words(prefix) for prefix in KINDS} | {
    **{place_pattern(prefix): _place_words(prefix) for prefix in KINDS},
    ANY: f"the id of a thing, its kind and 26 digits and small letters, as {example('job')}",
}
"""What a pattern asks for, in words."""
