"""Whether a command line is one that ``ambit`` understands, without running it."""

from __future__ import annotations

import typer

from service.cli import app


def assert_understood(arguments: list[str]) -> None:
    """Raise what the command would say of its usage."""
    command, context, rest = typer.main.get_command(app), None, list(arguments)
    while hasattr(command, "commands"):
        context = command.make_context("ambit", rest, parent=context)
        name, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert command is not None, name
    command.make_context("ambit", rest, parent=context)
