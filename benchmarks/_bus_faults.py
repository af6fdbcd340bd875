"""Ten thousand points under random faults, each result checked against what the device really measured."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drivers.controller import Controller, PointResult, State, Tone
from drivers.device.faults import KINDS, FaultPlan, ModbusSpoiler
from drivers.device.front import DeviceFront
from drivers.device.machine import Event, RigDevice
from drivers.device.modbus import TcpServer
from drivers.errors import ControllerError
from drivers.url import connect
from sim.reference import reference_rig


@dataclass
class Tally:
    """What a run under faults came to."""

    points: int = 0
    wrong: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    marks: Counter[str] = field(default_factory=Counter)
    excited_without_lease: int = 0
    seconds: float = 0.0


class Witness(RigDevice):
    """A device that remembers its last results, and counts excitation without a lease."""

    def __init__(self, tally: Tally) -> None:
        self.truth: dict[int, PointResult] = {}
        self._tally = tally
        self._leased = False
        super().__init__(reference_rig(), 1, on_event=self._watch)

    def _watch(self, event: Event) -> None:
        if event.text.startswith("leased"):
            self._leased = True
        elif event.text == "lease released":
            self._leased = False
        elif event.text.startswith("excitation on") and not self._leased:
            self._tally.excited_without_lease += 1

    def arm(self, tone: Tone, token: int) -> Callable[[], PointResult]:
        play = super().arm(tone, token)

        def remembered() -> PointResult:
            point = play()
            self.truth[point.sequence] = point
            self.truth.pop(point.sequence - 100, None)
            return point

        return remembered


def run(points: int, seed: int, rate: float, progress: Callable[[int], None] = lambda _: None) -> Tally:
    """Play that many random tones through a faulty Modbus link, every fault at ``rate`` per frame."""
    tally = Tally()
    device = Witness(tally)
    spoiler = ModbusSpoiler(FaultPlan(seed, dict.fromkeys(KINDS, rate)))
    server = TcpServer(DeviceFront(device, "big"), spoiler=spoiler)
    generator = np.random.default_rng(seed)
    controller = _connected(f"modbus://127.0.0.1:{server.port}", tally)
    began = time.monotonic()
    try:
        while tally.points < points:
            try:
                with controller.lease("benchmark", seconds=1.0):
                    if controller.status().state is State.TRIPPED:
                        controller.acknowledge()
                    while tally.points < points:
                        tone = _tone(generator)
                        point = _measured(controller, tone, tally)
                        tally.wrong += not _same(tone, point, device.truth[point.sequence])
                        tally.points += 1
                        progress(tally.points)
            except ControllerError as error:
                tally.marks[type(error).__name__] += 1
    finally:
        spoiler.dice.on = False
        controller.close()
        server.close()
        device.close()
    tally.faults = spoiler.dice.struck
    tally.seconds = time.monotonic() - began
    return tally


def _connected(url: str, tally: Tally) -> Controller:
    while True:
        try:
            return connect(url)
        except ControllerError as error:
            tally.marks[type(error).__name__] += 1


def _measured(controller: Controller, tone: Tone, tally: Tally) -> PointResult:
    """The tone's result; a failure is marked, and the tone repeated once under the same lease."""
    try:
        return controller.measure(tone)
    except ControllerError as error:
        tally.marks[type(error).__name__] += 1
        controller.acknowledge()
        return controller.measure(tone)


def _tone(generator: np.random.Generator) -> Tone:
    samples = int(generator.integers(50, 200))
    return Tone(
        axis=int(generator.integers(4)),
        amplitude_a=float(generator.uniform(0.01, 0.05)),
        periods=int(generator.integers(1, samples // 3)),
        samples=samples,
        blocks=int(generator.integers(1, 4)),
    )


def _same(tone: Tone, point: PointResult, truth: PointResult) -> bool:
    return (
        (tone.axis, tone.periods, tone.samples, tone.blocks)
        == (truth.tone.axis, truth.tone.periods, truth.tone.samples, truth.tone.blocks)
        and abs(tone.amplitude_a - truth.tone.amplitude_a) < 0.51e-6
        and all(
            np.allclose(getattr(point, x), getattr(truth, x), rtol=1e-6, atol=floor)
            for x, floor in (("R", 1e-12), ("U", 1e-4), ("I", 2e-6), ("Y", 1e-11))
        )
    )
