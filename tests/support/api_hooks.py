"""Hooks of schemathesis: most requests are about things that the service has; AMBIT_TEST_IDS names them."""

import json
import os
import zlib

import schemathesis

IDS = json.loads(os.environ.get("AMBIT_TEST_IDS", "{}"))  # empty where a collector of doctests imports this


@schemathesis.hook
def before_call(context, case, kwargs):
    for name in case.path_parameters or {}:
        made_up = zlib.crc32(str(case.path_parameters[name]).encode())
        if name in IDS and case.method != "DELETE" and made_up % 8:  # now and then as it was made up
            case.path_parameters[name] = IDS[name]
            if case.operation.path.endswith(("/cancel", "/retry")):
                case.path_parameters[name] = IDS["other_job"]
    if isinstance(case.body, dict):
        for name in ("rig", "experiment", "model"):
            if isinstance(case.body.get(name), str) and len(case.body) > 1:
                case.body[name] = IDS[f"{name}_id"]
        if case.body.get("controller_url"):  # a rig that is not there would be waited for
            case.body["controller_url"] = "simulated://"
