"""How far the buses reach: agreement, faults, kills, throughput, bus time. ``python benchmarks/buses.py [name]``."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _bus_faults
import _bus_kills
import _bus_speed
import _one_thread  # noqa: F401  before numpy
import numpy as np

from drivers.canopen.codec import beat_bytes
from drivers.controller import Controller, PointResult, Tone
from drivers.device.hub import CanHub, Frame
from drivers.device.machine import RigDevice
from drivers.device.serve import CanOptions, ModbusOptions, RtuOptions, serve_canopen, serve_modbus, serve_modbus_rtu
from drivers.heartbeat import PERIOD_S
from drivers.simulated.driver import SimulatedController
from drivers.url import connect
from service import bootstrap
from service.campaign.aims import Profile
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from sim.reference import reference_datasheet, reference_rig

NOISE_Y_M, NOISE_I_A = 20e-9, 2e-3


def _campaign(controller: Controller, profile: Profile | None) -> Experiment:
    with tempfile.TemporaryDirectory() as folder:
        return run_campaign(controller, reference_datasheet(), Path(folder), profile=profile)


Figures = dict[str, tuple[float, float]]
"""Value and standard deviation of ki, ks, wn and zeta by name, as result.json has them."""


def _commissioned(controller: Controller) -> tuple[Experiment, Figures]:
    """A quick commissioning, to the files: its experiment, and the figures in its result.json."""
    with tempfile.TemporaryDirectory() as folder:
        experiment = bootstrap.measure(
            controller, reference_datasheet(), Path(folder), profile=bootstrap.quick_profile()
        )
        bootstrap.identify_into(experiment, reference_datasheet(), Path(folder))
        result = json.loads((Path(folder) / bootstrap.RESULT).read_text())
    figures: Figures = {}
    for plane, found in result["planes"].items():
        for name, estimate in found["stiffness"].items():
            figures[f"{plane} {name}"] = estimate["value"], estimate["std"]
        for k, mode in enumerate(found["rotor_modes"], 1):
            for name, key in (("wn", "natural_frequency_rad_s"), ("zeta", "damping_ratio")):
                figures[f"{plane} {name}{k}"] = mode[key]["value"], mode[key]["std"]
    return experiment, figures


def agreement() -> None:
    """The same seed and rig over every bus and in process: every point, and the figures of result.json."""
    reference, figures = _commissioned(SimulatedController(reference_rig(), seed=7))
    for name, serve in (
        ("Modbus TCP", lambda d: serve_modbus(d, ModbusOptions(port=0))),
        ("Modbus RTU", lambda d: serve_modbus_rtu(d, RtuOptions())),
        ("CANopen", lambda d: serve_canopen(d, CanOptions())),
    ):
        device = RigDevice(reference_rig(), 7)
        served = serve(device)
        controller = connect(served.url)
        experiment, found = _commissioned(controller)
        controller.close()
        served.close()
        cut_short = sum(event.text.startswith("trip HOST") for event in device.events())
        _compare(name, reference, experiment)
        _compare_figures(name, figures, found)
        if cut_short:
            print(f"agreement: {name}: {cut_short} tones were cut short by the watchdog on this machine, and repeated")


def _compare(name: str, reference: Experiment, experiment: Experiment) -> None:
    y = i = 0.0
    points = 0
    for k, (sweep, other) in enumerate(zip(reference.sweeps, experiment.sweeps, strict=True)):
        if sweep.I is None or other.I is None or sweep.Y.shape != other.Y.shape:
            print(f"agreement: {name}: sweep {k} differs in shape")
            continue
        points += len(sweep.frequency_hz)
        y = max(y, float(np.max(np.abs(sweep.Y - other.Y))))
        i = max(i, float(np.max(np.abs(sweep.I - other.I))))
    print(
        f"agreement: {name} and in process, {points} points: largest difference {y:.1e} m ({y / NOISE_Y_M:.1e} of "
        f"the sensor noise), {i:.1e} A ({i / NOISE_I_A:.1e} of the current noise); asked: below 0.1"
    )


def _compare_figures(name: str, figures: Figures, found: Figures) -> None:
    if figures.keys() != found.keys():
        print(f"agreement: {name}: result.json has other figures: {sorted(figures.keys() ^ found.keys())}")
        return
    off = {key: abs(found[key][0] - value) / std for key, (value, std) in figures.items()}
    worst = max(off, key=off.__getitem__)
    print(
        f"agreement: {name} and in process, {len(off)} figures of result.json (ki, ks, wn, zeta): largest difference "
        f"{off[worst]:.1e} of its standard deviation ({worst}); asked: below 0.1"
    )


def faults(points: int = 10_000) -> None:
    """Random tones over a Modbus link on which every fault strikes."""
    tally = _bus_faults.run(points, seed=20, rate=0.0005, progress=_ticker(points))
    print(
        f"faults: {tally.points} points under {sum(tally.faults.values())} faults in {tally.seconds:.0f} s: "
        f"{tally.wrong} wrong values accepted, {tally.excited_without_lease} excitations without a lease; "
        f"marked and repeated: {dict(tally.marks) or 'none'}"
    )
    print(f"faults: {dict(sorted(tally.faults.items()))}")


def kills(count: int = 50) -> None:
    """Hosts killed while a tone plays."""
    for protocol, n in (("modbus", count), ("canopen", max(count // 5, 1))):
        ms = 1e3 * np.array(_bus_kills.run(n, protocol))
        print(
            f"kills: {protocol}, {n} hosts killed: excitation off after {np.median(ms):.0f} ms in the median, "
            f"{ms.min():.0f} to {ms.max():.0f} ms; asked: at most 250 ms"
        )


def throughput() -> None:
    """A raw record of 120 kB."""
    driver, bare = _bus_speed.modbus()
    print(
        f"throughput: Modbus TCP raw record {driver / 1e3:.0f} kB/s, bare sockets of the same depth {bare / 1e3:.0f} "
        f"kB/s: {driver / bare:.0%}; asked: at least 60 %"
    )
    block, limit, bitrate = _bus_speed.sdo_block()
    print(
        f"throughput: SDO block {block / 1e3:.1f} kB/s on a line of {bitrate / 1e6:.0f} Mbit/s, whose limit is "
        f"{limit / 1e3:.1f} kB/s: {block / limit:.0%}; asked: at least 85 %"
    )


class _Meter:
    """A controller that counts, for lock-in tones and raw records apart, bits on the line and seconds of the rig."""

    def __init__(self, controller: Controller, hub: CanHub) -> None:
        self._controller, self._hub = controller, hub
        self.bits = {False: 0, True: 0}
        self.rig_seconds = {False: 0.0, True: 0.0}
        self.points = {False: 0, True: 0}

    def measure(self, tone: Tone) -> PointResult:
        before = self._hub.bits
        point = self._controller.measure(tone)
        self.bits[tone.raw] += self._hub.bits - before
        self.rig_seconds[tone.raw] += point.rig_seconds
        self.points[tone.raw] += 1
        return point

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)


def bus_time() -> None:
    """The whole commissioning on CAN: bits on the line against the time that the rig measures."""
    hub, _, url = _bus_speed.hub_device()
    meter = _Meter(connect(url), hub)
    _campaign(meter, None)
    meter.close()
    hub.close()
    beat_bits = Frame(0x205, beat_bytes(1, 1)).bits
    for raw, what, asked in ((False, "by lock-in", "; asked: at most 5 %"), (True, "with raw records", "")):
        seconds = (meter.bits[raw] + meter.rig_seconds[raw] / PERIOD_S * beat_bits) / 1e6
        print(
            f"bus time: {meter.points[raw]} points {what}, {meter.rig_seconds[raw]:.0f} s on the rig: "
            f"{seconds:.1f} s of a CAN line of 1 Mbit/s, a heartbeat every 50 ms included: "
            f"{seconds / meter.rig_seconds[raw]:.2%}{asked}"
        )


def _ticker(total: int) -> Callable[[int], None]:
    began = time.monotonic()

    def tick(done: int) -> None:
        if done % 1000 == 0 and sys.stderr.isatty():
            print(f"  {done} of {total} after {time.monotonic() - began:.0f} s", file=sys.stderr)

    return tick


BENCHMARKS = {f.__name__: f for f in (agreement, faults, kills, throughput, bus_time)}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=", ".join(BENCHMARKS))
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=50)
    options = parser.parse_args()
    for name in options.names or BENCHMARKS:
        more = {"faults": (options.points,), "kills": (options.kills,)}.get(name, ())
        BENCHMARKS[name](*more)
