"""A vendor's map whose amplitudes have coarser steps than ours: what is played is what is asked for, and recorded."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.controller import Controller, Tone
from drivers.device.machine import RigDevice
from drivers.device.serve import CanOptions, ModbusOptions, serve_canopen, serve_modbus
from drivers.url import connect
from service.campaign.aims import Profile
from service.campaign.run import run_campaign
from sim.reference import reference_datasheet, reference_rig
from tests.support.vendor import assert_works_like_our_own

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
SHORT = Profile(
    points=4, from_hz=40, to_hz=200, validation_points=2, amplifier_points=2, coarse_points=3, rig_seconds=60
)


def coarse(type_: str = "U16", per_unit: int | None = 1000) -> str:
    scale = "" if per_unit is None else f"per_unit = {per_unit}\n"
    amplitudes = "".join(f'[objects."{g}.amplitude_a"]\ntype = "{type_}"\n{scale}' for g in ("tone", "result"))
    return amplitudes + "".join(f'[objects."{g}.crc"]\nabsent = true\n' for g in ("tone", "result"))


@contextmanager
def bench(folder: Path, text: str, bus: str = "modbus") -> Iterator[Controller]:
    (path := folder / "vendor.toml").write_text(text)
    device = RigDevice(reference_rig(), 3)
    if bus == "modbus":
        served = serve_modbus(device, ModbusOptions(port=0, map=path))
    else:
        served = serve_canopen(device, CanOptions(map=path))
    controller = connect(f"{served.url}&map={path}")
    try:
        yield controller
    finally:
        controller.close()
        served.close()


@pytest.mark.parametrize("bus", ["modbus", "canopen"])
@pytest.mark.parametrize(("asked_a", "played_a"), [(0.0123456, 0.012), (0.02, 0.02), (0.0129999, 0.012)])
def test_an_amplitude_between_two_steps_is_played_at_the_lower_one(
    tmp_path: Path, bus: str, asked_a: float, played_a: float
) -> None:
    with bench(tmp_path, coarse(), bus) as controller, controller.lease("host"):
        point = controller.measure(replace(TONE, amplitude_a=asked_a))
    assert point.tone.amplitude_a == played_a
    np.testing.assert_allclose(point.R[:, 1, 1], played_a, rtol=1e-12)


def test_a_map_that_carries_less_than_the_controller_plays_is_the_limit(tmp_path: Path) -> None:
    with bench(tmp_path, coarse(per_unit=100_000)) as controller:
        assert controller.capabilities().max_amplitude_a == 0.65535


def test_amplitudes_that_a_map_has_as_floats_are_in_amperes(tmp_path: Path) -> None:
    with bench(tmp_path, coarse("F32", None)) as controller:
        assert_works_like_our_own(controller, TONE, raw_samples=500)


def test_a_session_over_such_a_map_is_replayed(tmp_path: Path) -> None:
    record = tmp_path / "session.jsonl"
    (path := tmp_path / "vendor.toml").write_text(coarse())
    served = serve_modbus(RigDevice(reference_rig(), 3), ModbusOptions(port=0, map=path))
    told = []
    for url in (f"{served.url}&map={path}&transcript={record}", f"replay://{record}"):
        controller = connect(url)
        with controller.lease("host"):
            told.append(controller.measure(replace(TONE, amplitude_a=0.0123456)))
        controller.close()
    served.close()
    assert told[0].tone == told[1].tone
    np.testing.assert_array_equal(told[0].Y, told[1].Y)


def test_a_campaign_records_the_amplitudes_that_were_played(tmp_path: Path) -> None:
    with bench(tmp_path, coarse()) as controller:
        experiment = run_campaign(controller, reference_datasheet(), tmp_path / "out", profile=SHORT)
    for sweep in experiment.sweeps:
        if sweep.kind == "noise":
            continue
        steps = 1000 * sweep.amplitude_a
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert (steps > 0.5).all()
        excited = np.abs(sweep.R[np.arange(len(steps)), :, 1, sweep.axis]).mean(axis=1)
        np.testing.assert_allclose(excited, sweep.amplitude_a, rtol=1e-12)
