"""A block upload over a line that loses, repeats and cuts frames: the whole content, or an error; never another one."""

import struct
from contextlib import suppress
from types import SimpleNamespace

import can
import numpy as np
import pytest
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.dictionary import object_dictionary
from drivers.canopen.upload import BlockUpload, UploadingSdoClient
from drivers.device.canopen import BlockSdoServer


class Line:
    """An upload and the device's own server, with a line between them that is told which frame to spoil, and how."""

    def __init__(self, content: bytes, spoil=lambda frame: [frame]) -> None:
        node = SimpleNamespace(
            object_dictionary=object_dictionary(5), get_data=lambda index, subindex, check_readable: content
        )
        self._server = BlockSdoServer(0x605, 0x585, node)
        self._server.network = SimpleNamespace(
            bus=None, send_message=lambda cob_id, frame: self._frames.extend(self._spoil(bytes(frame)))
        )
        self._spoil = lambda frame: [frame]
        self._frames: list[bytes] = []
        self._requests: list[bytes] = []
        self._server.block_upload(struct.pack("<BHBBBxx", 0xA4, 0x2201, 0, 127, 0))
        self._frames.clear()
        self._spoil = spoil
        self.upload = BlockUpload(self._requests.append)

    def run(self, reminders: int = 50) -> bytes:
        self.upload.start()
        while not self.upload.over.is_set():
            if self._requests:
                for request in self._spoil(self._requests.pop(0)):
                    if len(request) == 8 and request[0] >> 5 == 5 and request[0] & 3 != 1:
                        self._server.block_upload(request)
            elif self._frames:
                self.upload.take(self._frames.pop(0))
            elif reminders:
                reminders -= 1
                self.upload.remind()
            else:
                raise SdoCommunicationError("silence")
        if self.upload.failure:
            raise self.upload.failure
        return self.upload.data


@pytest.mark.parametrize("size", [1, 7, 8, 127 * 7, 127 * 7 + 1, 5000])
def test_content_comes_whole(size: int) -> None:
    content = np.random.default_rng(size).bytes(size)
    assert Line(content).run() == content


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([0.002, 0.01, 0.05]))
def test_spoilt_line_gives_the_content_or_an_error(seed: int, rate: float) -> None:
    generator = np.random.default_rng(seed)
    content = generator.bytes(3000)

    def spoil(frame: bytes) -> list[bytes]:
        if generator.random() > rate:
            return [frame]
        return ([], [frame, frame], [frame[:5]])[generator.integers(3)]

    with suppress(SdoCommunicationError, SdoAbortedError):
        assert Line(content, spoil).run() == content


@pytest.mark.parametrize("size", [5, 12, 127 * 7, 127 * 7 + 8, 3000])
def test_one_lost_frame_costs_no_second_start(size: int) -> None:
    content = np.random.default_rng(1).bytes(size)
    frames: list[bytes] = []
    Line(content, lambda frame: frames.append(frame) or [frame]).run()
    for lost in range(len(frames) - 2):  # the last two end it, and are not content
        passed = iter(range(10_000))
        line = Line(content, lambda frame, lost=lost, passed=passed: [] if next(passed) == lost else [frame])
        assert line.run() == content, f"without frame {lost} of {len(frames)}"


@pytest.mark.slow
def test_a_line_that_loses_one_frame_in_fifty_gives_the_content() -> None:
    """A first segment that was lost had the block before it acknowledged twice, and the device skip one."""
    generator = np.random.default_rng(2)
    content = generator.bytes(100_000)
    whole = 0
    for _ in range(20):
        with suppress(SdoCommunicationError, SdoAbortedError):
            whole += Line(content, lambda frame: [] if generator.random() < 0.02 else [frame]).run() == content
    assert whole >= 15


def test_abort_of_the_server_ends_it() -> None:
    upload = BlockUpload(lambda request: None)
    upload.start()
    upload.take(bytes([0x80, 0x01, 0x22, 0x00]) + (0x08000024).to_bytes(4, "little"))
    assert upload.over.is_set()
    assert isinstance(upload.failure, SdoAbortedError)


@pytest.mark.parametrize("off", [False, True])
@pytest.mark.parametrize("ends", ["between two looks", "in the wait"])
def test_an_upload_that_is_given_up_is_aborted_and_says_why_even_if_the_bus_is_off(
    monkeypatch: pytest.MonkeyPatch, ends: str, off: bool
) -> None:
    sent: list[bytes] = []

    def send(cob_id: int, frame: bytes) -> None:
        sent.append(bytes(frame))
        if off and frame[0] == 0x80:
            raise can.CanError("the bus is off")

    client = UploadingSdoClient(5, object_dictionary(5))
    client.network = SimpleNamespace(send_message=send)
    monkeypatch.setattr(client, "request_response", lambda request: bytes([0xC6, *request[1:4], 0, 0, 0, 0]))

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    if ends == "in the wait":
        monkeypatch.setattr(client, "_wait", interrupt)
    with pytest.raises(KeyboardInterrupt):
        client.block_upload(0x2201, 0, interrupt)
    assert sent[-1][0] == 0x80
