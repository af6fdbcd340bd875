"""The command ``ambit``. Every command imports what it needs when it runs, so that ``--help`` is quick."""

from __future__ import annotations

import gc
import os
import sys

import typer

from service.cli import (
    client,
    commission,
    controller,
    db,
    demo,
    effects,
    export,
    gap,
    health,
    jobs,
    keys,
    recover,
    rig,
    rigs,
    serve,
)
from service.remarks import one_line, say

app = typer.Typer(
    name="ambit",
    help="Commissioning of active magnetic bearings: experiment, identification, diagnosis.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(demo.demo)
app.command()(commission.commission)
app.command()(commission.identify)
app.command()(recover.recover)
app.command()(controller.check_controller)
app.command()(effects.effects)
app.add_typer(export.app, name="export")
app.add_typer(gap.app, name="gap")
app.add_typer(health.app, name="health")
app.add_typer(rig.app, name="rig")
app.add_typer(keys.app, name="keys")
app.add_typer(db.app, name="db")
app.command()(serve.serve)
app.command()(serve.worker)
app.command()(client.submit)
app.command()(jobs.jobs)
app.command()(client.watch)
app.command()(client.cancel)
app.command()(client.retry)
app.command()(client.fetch)
app.command()(rigs.rigs)
app.command()(rigs.status)
app.command()(rigs.stop)
app.command()(rigs.acknowledge)
app.command()(rigs.schedules)

DONE, FAILED, BAD_USAGE = 0, 1, 2
INTERRUPTED = 130
"""What typer makes of Ctrl-C; told and turned into `FAILED`."""


ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""The matrices here are small: threads of linear algebra only wait for one another, and long on a busy machine."""


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: 0 done, 1 the job failed (one line on stderr), 2 bad usage (one line on stderr)."""
    status = run(sys.argv[1:] if arguments is None else arguments)
    gc.freeze()  # on its way out Python would search all that is loaded for garbage: about a second of a diagnosis
    sys.exit(status)


def run(arguments: list[str]) -> int:
    """Exit status of a command line."""
    from sim.errors import AmbError, reason

    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    try:
        status = app(arguments, prog_name="ambit", standalone_mode=False)
    except typer.TyperException as error:
        return _bad_usage(error)
    except (typer.Abort, KeyboardInterrupt):
        status = INTERRUPTED
    except ImportError as error:
        if not _interrupted(error):
            raise
        status = INTERRUPTED
    except BrokenPipeError:
        return _reader_left()
    except AmbError as error:
        say(f"ambit: {one_line(str(error))}")
        return FAILED
    except OSError as error:  # no part of the product has said what it means
        file = f"{error.filename}: " if error.filename else ""
        say(f"{' '.join(['ambit', *arguments[:1]])}: {file}{reason(error)}")
        return FAILED
    if status == INTERRUPTED:
        say("ambit: stopped by the user; files that were finished are kept")
        return FAILED
    return status if isinstance(status, int) else DONE


def _interrupted(error: BaseException) -> bool:
    """Whether Ctrl-C is behind an error: a compiled module that it stops while it loads cannot say so otherwise."""
    causes = [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) is not None:
        causes.append(cause)
    return any(isinstance(cause, KeyboardInterrupt) for cause in causes)


def _bad_usage(error: typer.TyperException) -> int:
    text = one_line(error.format_message()).replace("Value error, ", "")  # a library's words, not a user's
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "ambit"
    if text:  # nothing was said where the help was asked for by giving no command
        say(f"{command}: {text.rstrip('.')}; see {command} --help")
    return BAD_USAGE


def _reader_left() -> int:
    """A pipe such as ``ambit effects | head`` was closed: not an error of the job, but not done either."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED
