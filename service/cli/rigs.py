"""``ambit rigs``, ``status``, ``stop``, ``acknowledge``, ``schedules``: what the rigs do now, from a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.client import Ca, Key, Url, client
from service.cli.console import Json, print_json, stdout
from service.cli.usage import value_of

if TYPE_CHECKING:
    from service.client import Client, Rig
    from service.client.shapes import Status

UNKNOWN = "–"
NOT_STOPPED = "not stopped yet: {}; trying on, use the hardware stop meanwhile"
Named = Annotated[str, typer.Argument(help="Name or id of the rig.")]


def rigs(url: Url = None, key: Key = None, ca: Ca = None, as_json: Json = False) -> None:
    """List the service's rigs, newest first: where their controllers are, and what they do now."""
    with client(url, key, ca) as ambit:
        found = [(rig, _status(ambit, rig)) for rig in ambit.rigs.list()]
    if as_json:
        listed = [rig.model_dump(mode="json") | {"status": now.model_dump(mode="json")} for rig, now in found]
        print_json({"rigs": listed})
        return
    if not found:
        print("no rigs: ambit submit experiment --rig rig.toml --controller URL makes one known")
        return
    rows = [(rig.id, rig.name, rig.controller_url, _state(now), now.lease_holder or "") for rig, now in found]
    _table(("id", "rig", "controller", "state", "moved by"), rows)


def status(rig: Named, url: Url = None, key: Key = None, ca: Ca = None, as_json: Json = False) -> None:
    """Tell what a rig does now: state, trip, excitation, displacements, currents, and who moves it.

    Exit status 1 where its controller does not answer.
    """
    from drivers.errors import ControllerError
    from sim.rig_file import parse

    with client(url, key, ca) as ambit:
        known = ambit.rigs.named(rig)
        now = ambit.rigs.status(known.id)
    if as_json:
        print_json(now.model_dump(mode="json"))
    elif now.reachable:
        for name, value in _figures(now, parse(known.datasheet).axes):
            print(f"{name}: {value}")
    if not now.reachable:
        raise ControllerError(f"the controller of {known.name} does not answer: {now.detail}")


def stop(rig: Named, url: Url = None, key: Key = None, ca: Ca = None, as_json: Json = False) -> None:
    """Stop a rig now: its excitation ramps to zero, and no job that there is moves its rotor again."""
    with client(url, key, ca, NOT_STOPPED) as ambit:
        known = ambit.rigs.named(rig)
        ambit.rigs.stop(known.id)
    if as_json:
        print_json({"rig": known.id, "stopped": True})
    else:
        print(f"{known.name}: stopped; ambit jobs --rig tells what has ended, ambit retry goes on with it")


def acknowledge(
    rig: Annotated[str | None, typer.Argument(help="Name or id of the service's rig.")] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Without a service: URL, modbus://, modbuss://, modbus+rtu:// or canopen://, as for ambit commission."
        ),
    ] = None,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Clear a latched trip, once its cause is found; nothing moves, and nobody may hold the rig."""
    if (rig is None) == (controller is None):
        raise typer.BadParameter("name a rig of the service, or give --controller: one of them")
    if rig is not None:
        with client(url, key, ca) as ambit:
            done = ambit.rigs.acknowledge(ambit.rigs.named(rig).id)
        trip, now = done.acknowledged, done.state
    else:
        trip, now = _acknowledged_at(str(controller))
    if as_json:
        print_json({"acknowledged": trip, "state": now})
    else:
        print(f"acknowledged: {trip}; now {now}" if trip else f"no trip is latched; {now}")


def _acknowledged_at(controller_url: str) -> tuple[str | None, str]:
    """What a controller had tripped of, and its state now."""
    from drivers.errors import AddressError
    from service import bootstrap
    from service.campaign.leased import acknowledged

    with value_of("--controller", AddressError):
        connection = bootstrap.connect(controller_url)
    try:
        return acknowledged(connection), connection.status().state.name.lower()
    finally:
        connection.close()


def schedules(
    rig: Annotated[str | None, typer.Option(help="Only of this rig, by name or id.")] = None,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """List the schedules of health checks, newest first: when they are due, and who is told."""
    with client(url, key, ca) as ambit:
        found = list(ambit.schedules.list(None if rig is None else ambit.rigs.named(rig, retired=True).id))
        names = {} if as_json else {known.id: known.name for known in ambit.rigs.list(retired=True)}
    if as_json:
        print_json({"schedules": [schedule.model_dump(mode="json") for schedule in found]})
        return
    if not found:
        checked = "no rig is" if rig is None else f"{rig} is not"
        print(f"no schedules: {checked} checked by itself; POST /api/v1/schedules makes one")
        return
    rows = [
        (
            s.id,
            names.get(s.rig, s.rig),
            f"{s.cron} {s.timezone}",
            f"{s.next_at:%Y-%m-%d %H:%M}" if s.enabled and s.next_at else "off",
            f"{s.webhook.url} on {s.webhook.on}" if s.webhook else "",
        )
        for s in found
    ]
    _table(("id", "rig", "when", "next, UTC", "webhook"), rows)


def _status(ambit: Client, rig: Rig) -> Status:
    """A rig now; one without a controller that others see is told as out of reach."""
    from service.client import ConflictingError
    from service.client.shapes import Status

    try:
        return ambit.rigs.status(rig.id)
    except ConflictingError as error:
        return Status(reachable=False, detail=error.detail, controller_url=rig.controller_url)


def _state(now: Status) -> str:
    if now.reachable:
        state = "levitated" if now.state == "done" else str(now.state)  # a tone is done, the rotor as before it
        return f"{state}: {now.trip_message}" if now.trip_message else state
    if not now.controller_url:
        return "no controller"
    return "simulated in its jobs" if now.controller_url.startswith("simulated:") else "does not answer"


def _figures(now: Status, axes: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    def told(value: float | None) -> str:
        return UNKNOWN if value is None else f"{value:.4g}"

    def by_axis(values: list[float] | None, scale: float, digits: int) -> str:
        if values is None:
            return UNKNOWN
        return "  ".join(f"{axis} {scale * x:z.{digits}f}" for axis, x in zip(axes, values, strict=False))

    yield "state", _state(now)
    yield "controller", f"{now.controller_url}, {now.identity}"
    left = "" if now.lease_seconds_left is None else f", {now.lease_seconds_left:.0f} s left"
    yield "moved by", f"{now.lease_holder}{left}" if now.lease_holder else "nobody"
    yield "excitation, A", told(now.excitation_a)
    yield "displacements, µm", by_axis(now.displacement_m, 1e6, 2)
    yield "currents, A", by_axis(now.current_a, 1.0, 3)
    yield "speed, rad/s", told(now.speed_rad_s)


def _table(heads: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(heads[0], no_wrap=True, min_width=30)
    for head in heads[1:]:
        table.add_column(head)
    for cells in rows:
        table.add_row(*map(Text, cells))  # names are no markup
    stdout().print(table)
