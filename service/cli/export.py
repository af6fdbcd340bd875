"""``ambit export``: models and measured responses in the formats of other tools."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Models and measured responses in the formats of other tools.")


class Plane(StrEnum):
    """Planes of a rig."""

    x = "x"
    y = "y"


class Part(StrEnum):
    """Parts of a plane's model, as in `service.exports.linear.PARTS`."""

    plant = "plant"
    amplifiers = "amplifiers"
    whole = "whole"


class Response(StrEnum):
    """Measured responses, as in `service.exports.responses.PATHS`."""

    u_y = "u->y"
    u_i = "u->i"
    i_y = "i->y"
    r_u = "r->u"
    r_y = "r->y"


@app.command()
def model(
    result: Annotated[Path, typer.Argument(help="result.json of a commissioning.")],
    out: Annotated[Path, typer.Argument(help="File to write; its ending says the format: .mat, .json or .csv.")],
    plane: Annotated[Plane, typer.Option(help="Plane.")] = Plane.x,
    part: Annotated[
        Part, typer.Option(help="plant (coil currents to displacements), amplifiers, or whole (both in series).")
    ] = Part.plant,
) -> None:
    """Write a state space with names and units: A, B, C, D in continuous time."""
    from service.exports import files, linear
    from service.identification.result.shape import ResultSpaces
    from service.output import read_document, ready_folder

    _must_end(out, files.LINEAR_ENDINGS)
    document = read_document(result, "amb-commissioning-result", ResultSpaces)
    found = linear.of_result(document, plane.value, part.value)
    ready_folder(out.parent)
    print(files.write_linear(out, found))


@app.command()
def responses(
    experiment: Annotated[Path, typer.Argument(help="Experiment file, HDF5 or MATLAB.")],
    out: Annotated[Path, typer.Argument(help="File to write: .uff (UFF-58, all planes), .mat, .json or .csv.")],
    path: Annotated[Response, typer.Option(help="From one signal to another.")] = Response.u_y,
    sweep: Annotated[str, typer.Option(help="Sweep by its comment; the main one without it.")] = "",
    plane: Annotated[Plane | None, typer.Option(help="Only this plane.")] = None,
) -> None:
    """Write measured frequency responses with their standard deviations, names and units."""
    from service.experiment import file
    from service.exports import files
    from service.exports import responses as measured
    from service.exports.errors import ExportError
    from service.output import ready_folder

    _must_end(out, files.RESPONSE_ENDINGS)
    found = measured.of_experiment(file.read(experiment), path.value, sweep)
    if plane and plane not in found:
        raise ExportError(f"the sweep excites no plane {plane.value!r}; it excites {', '.join(found)}")
    ready_folder(out.parent)
    chosen = [found[plane]] if plane else list(found.values())
    for written in files.write_responses(out, chosen):
        print(written)


@app.command()
def show(file: Annotated[Path, typer.Argument(help="File that export wrote.")]) -> None:
    """Read an export back and tell what it holds."""
    from service.exports import files
    from service.exports.errors import ExportError

    problems = []
    for reader in (_model_words, _response_words):
        try:
            print("\n".join(reader(file)))
            return
        except ExportError as error:
            problems.append(str(error))
    # the reader that got further says more
    problem = problems[-1] if file.suffix.lower() not in files.LINEAR_ENDINGS else problems[0]
    raise ExportError(problem if str(file) in problem else f"{file}: {problem}; give a file as ambit export wrote it")


def _must_end(out: Path, endings: tuple[str, ...]) -> None:
    if out.suffix.lower() not in endings:
        raise typer.BadParameter(f"{out.name} must end with one of {', '.join(endings)}", param_hint="out")


def _model_words(file: Path) -> list[str]:
    from service.exports import files

    m = files.read_linear(file)
    signals = zip((*m.inputs, *m.outputs), (*m.input_units, *m.output_units), strict=True)
    return [f"{m.name}: {len(m.states)} states", *(f"{name} [{unit}]" for name, unit in signals)]


def _response_words(file: Path) -> list[str]:
    from service.exports import files

    return [
        f"{r.name}: {len(r.frequency_hz)} frequencies from {r.frequency_hz[0]:.4g} to {r.frequency_hz[-1]:.4g} Hz, "
        f"{', '.join(r.outputs)} per {', '.join(r.inputs)}"
        for r in files.read_responses(file)
    ]
