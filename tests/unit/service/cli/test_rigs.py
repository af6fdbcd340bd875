"""A latched trip is cleared from a terminal, once somebody says so."""

import json
from contextlib import closing

from drivers.controller import State
from drivers.device.machine import RigDevice
from drivers.device.serve import ModbusOptions, serve_modbus
from service.cli import run
from sim.reference import reference_rig


def test_a_trip_is_acknowledged_at_one_place(capsys):
    """Neither at none, nor at a controller that may be another rig's."""
    for words in ([], ["reference", "--controller", "modbus://127.0.0.1:9"]):
        assert run(["acknowledge", *words]) == 2
        assert "--controller" in capsys.readouterr().err


def test_a_latched_trip_is_acknowledged_and_told(capsys):
    with closing(serve_modbus(RigDevice(reference_rig(), seed=1), ModbusOptions(port=0))) as served:
        words = ["acknowledge", "--controller", served.url]
        assert run(words) == 0
        assert "no trip is latched" in capsys.readouterr().out
        served.device.fault("sensor supply lost")
        assert run([*words, "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert "sensor supply lost" in told["acknowledged"]
        assert told["state"] == "levitated"
        assert served.device.status().state == State.LEVITATED
