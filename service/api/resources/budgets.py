"""Whether a health check fits into its budget, as far as that is known before it begins."""

from __future__ import annotations

import json
from typing import Any

from service.api.problems import UnprocessableError
from service.api.resources.options import HealthOptions
from service.api.state import Services
from service.errors import JobError
from service.storage import results, rigs
from sim import rig_file
from sim.errors import AmbError


def must_hold_a_check(api: Services, rig_id: str, options: dict[str, Any]) -> None:
    """Refuse options of a health check whose budget holds none of this rig, as it and its baseline are now.

    What else keeps a rig from being checked is told by whoever submits the check, or by the check.

    Raises
    ------
    UnprocessableError
        The budget is too small; names the least that will do.
    """
    from service import checkup  # with it comes scipy, for which every start would wait

    budget_s = HealthOptions.model_validate(options).budget_s
    try:
        with api.database.read() as session:
            rig = rigs.active(session, rig_id)
            datasheet = rig_file.parse(rigs.version(session, rig).datasheet)
            model = results.baseline(session, rig)
        document = json.loads(api.blobs.read(model.result_sha256))
        checkup.must_suffice(checkup.baseline_from(document, model.id), datasheet, budget_s)
    except JobError as error:
        raise UnprocessableError(f"options.budget_s: {error}") from error
    except (AmbError, ValueError, ArithmeticError, LookupError):  # a result that gives no plan: the check's to tell
        return
