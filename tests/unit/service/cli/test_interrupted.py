"""Ctrl-C ends a command in one line, whatever it comes in the way of."""

import pytest

from service import cli


@pytest.mark.parametrize("stopped", [True, False])
def test_a_module_that_ctrl_c_stops_while_it_loads_is_a_command_that_was_stopped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], stopped: bool
) -> None:
    """A compiled one says "initialization failed", caused by the interruption; one that is broken is told as that."""

    def loading(*_: object, **__: object) -> None:
        raise ImportError("initialization failed") from (KeyboardInterrupt() if stopped else None)

    monkeypatch.setattr(cli, "app", loading)
    if stopped:
        assert cli.run(["gap"]) == 1
        assert capsys.readouterr().err == "ambit: stopped by the user; files that were finished are kept\n"
    else:
        with pytest.raises(ImportError, match="initialization failed"):
            cli.run(["gap"])
