"""``ambit export``: models and measured responses in the formats of other tools."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import Json, print_json

if TYPE_CHECKING:
    from service.exports.linear import Linear
    from service.exports.responses import Responses

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
    as_json: Json = False,
) -> None:
    """Write a state space with names and units: A, B, C, D in continuous time."""
    from service.exports import files, linear
    from service.identification.result.shape import ResultSpaces
    from service.output import read_document, ready_folder

    _must_end(out, files.LINEAR_ENDINGS)
    document = read_document(result, "amb-commissioning-result", ResultSpaces)
    found = linear.of_result(document, plane.value, part.value)
    ready_folder(out.parent)
    written = files.write_linear(out, found)
    if as_json:
        print_json(_model_document(found) | {"files": {"model": str(written)}})
        return
    print(written)


@app.command()
def responses(
    experiment: Annotated[Path, typer.Argument(help="Experiment file, HDF5 or MATLAB.")],
    out: Annotated[Path, typer.Argument(help="File to write: .uff (UFF-58, all planes), .mat, .json or .csv.")],
    path: Annotated[Response, typer.Option(help="From one signal to another.")] = Response.u_y,
    sweep: Annotated[str, typer.Option(help="Sweep by its comment; the main one without it.")] = "",
    plane: Annotated[Plane | None, typer.Option(help="Only this plane.")] = None,
    as_json: Json = False,
) -> None:
    """Write measured frequency responses with their standard deviations, names and units."""
    from service.experiment import file
    from service.exports import files
    from service.exports import responses as measured
    from service.output import ready_folder

    _must_end(out, files.RESPONSE_ENDINGS)
    chosen = measured.of_experiment(file.read(experiment), path.value, sweep, plane.value if plane else None)
    ready_folder(out.parent)
    written = files.write_responses(out, list(chosen.values()))
    if as_json:
        each = written if len(written) == len(chosen) else written * len(chosen)  # one file may hold all
        paths = {name: str(path) for name, path in zip(chosen, each, strict=True)}
        print_json(_responses_document(list(chosen.values())) | {"files": paths})
        return
    for one in written:
        print(one)


@app.command()
def show(file: Annotated[Path, typer.Argument(help="File that export wrote.")], as_json: Json = False) -> None:
    """Read an export back and tell what it holds."""
    from service.exports import files
    from service.exports.errors import ExportError

    problems = []
    for read in (_read_model, _read_responses):
        try:
            document, words = read(file)
        except ExportError as error:
            problems.append(str(error))
            continue
        if as_json:
            print_json(document)
        else:
            print("\n".join(words))
        return
    # the reader that got further says more
    problem = problems[-1] if file.suffix.lower() not in files.LINEAR_ENDINGS else problems[0]
    raise ExportError(problem if str(file) in problem else f"{file}: {problem}; give a file as ambit export wrote it")


def _must_end(out: Path, endings: tuple[str, ...]) -> None:
    if out.suffix.lower() not in endings:
        raise typer.BadParameter(f"{out.name} must end with one of {', '.join(endings)}", param_hint="out")


def _read_model(file: Path) -> tuple[dict[str, Any], list[str]]:
    """What a file of a model holds, as data and in lines."""
    from service.exports import files

    m = files.read_linear(file)
    signals = zip((*m.inputs, *m.outputs), (*m.input_units, *m.output_units), strict=True)
    return _model_document(m), [f"{m.name}: {len(m.states)} states", *(f"{name} [{unit}]" for name, unit in signals)]


def _read_responses(file: Path) -> tuple[dict[str, Any], list[str]]:
    """The same of a file of responses."""
    from service.exports import files

    found = files.read_responses(file)
    return _responses_document(found), [
        f"{r.name}: {len(r.frequency_hz)} frequencies from {r.frequency_hz[0]:.4g} to {r.frequency_hz[-1]:.4g} Hz, "
        f"{', '.join(r.outputs)} per {', '.join(r.inputs)}"
        for r in found
    ]


def _model_document(model: Linear) -> dict[str, Any]:
    """A model as its file has it, without its matrices."""
    from service.exports import linear

    return {k: v for k, v in linear.document(model).items() if k not in "ABCD"}


def _responses_document(found: list[Responses]) -> dict[str, Any]:
    """Responses as their files have them, with the range of their frequencies in the place of all values."""
    from service.exports import responses

    values = ("frequency_hz", "real", "imag", "std")
    return {
        "responses": [
            {k: v for k, v in responses.document(r).items() if k not in values}
            | {
                "frequencies": len(r.frequency_hz),
                "from_hz": float(r.frequency_hz[0]),
                "to_hz": float(r.frequency_hz[-1]),
            }
            for r in found
        ]
    }
