"""The worker processes of a diagnosis: modules that they load in advance.

No fit begins before these are loaded, in every diagnosis. So what few diagnoses need is loaded where it is needed: the
next experiment's rehearsal by an import in its function, ``scipy.optimize`` and the like as attributes of ``scipy``,
which loads them when they are first asked for.
"""

from __future__ import annotations

from service.pool import prepare

LOADED = ("service.gap.fitting.candidates", "service.gap.loop")


def prepared() -> None:
    """Have the modules loaded once where the worker processes cannot begin as copies of this one."""
    prepare(*LOADED)
