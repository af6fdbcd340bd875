"""What the command line says of a campaign that its controller did not see through."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from drivers.errors import BusError
from service import bootstrap
from service.cli.commission import commission_directly
from service.experiment.campaign import JOURNAL
from sim.reference import reference_datasheet


@pytest.mark.parametrize("measured", [True, False])
def test_a_bus_that_fails_is_told_with_what_is_kept_where_anything_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, measured: bool
) -> None:
    def silent(*_: object) -> None:
        if measured:
            (tmp_path / JOURNAL).write_bytes(b"")
        raise BusError("cannot connect: Connection refused")

    monkeypatch.setattr(bootstrap, "measure", silent)
    with pytest.raises(BusError, match=r"^cannot connect: Connection refused") as told:
        commission_directly(nullcontext(), reference_datasheet(), tmp_path, True, True, False, None)  # type: ignore[arg-type]
    assert (f"kept in {tmp_path}: run it again to go on" in str(told.value)) is measured
