"""The emulator in its own process, against a client of raw bytes that shares no code with the codec."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest
from tests.robomend_board.processes import Control, RawClient, Running, running

OK = "02 05 01 00 00"


@pytest.fixture
def emulator() -> Iterator[Running]:
    with running("--on", "2") as emulator:
        yield emulator


@pytest.fixture
def client(emulator: Running) -> Iterator[RawClient]:
    with RawClient(emulator.port) as client:
        client.greeting = client.frame()
        yield client


@pytest.fixture
def control(emulator: Running) -> Iterator[Control]:
    with Control(emulator.control_port) as control:
        yield control


def readings(frame: bytes) -> list[tuple[int, float, float]]:
    """Take measurements apart by the table of the protocol: n × (u8, f32, f32)."""
    assert frame[1] == 2
    return [struct.unpack_from("<Bff", frame, 5 + 9 * n) for n in range(frame[4])]


def request(client: RawClient) -> list[tuple[int, float, float]]:
    assert client.ask("02 03 00 00") == OK
    return readings(client.frame())


# --- the protocol --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        ("02 04 02 00 0A 01", "01"),
        ("02 04 02 00 03 02", "02"),
        ("02 04 01 00 03", "02"),
        ("02 09 00 00", "04"),
        ("02 02 01 00 00", "04"),
    ],
)
def test_a_wrong_command_gets_its_code_and_the_connection_stays(
    client: RawClient, frame: str, code: str
) -> None:
    assert client.ask(frame) == f"02 05 01 00 {code}"
    assert client.ask("02 03 01 00 00") == OK


@pytest.mark.parametrize("garbage", ["00", "47 45 54 20 2F", "02 04 FF FF", "FF" * 1000])
def test_garbage_ends_the_connection_and_harms_no_other(
    emulator: Running, client: RawClient, garbage: str
) -> None:
    with RawClient(emulator.port) as vandal:
        vandal.frame()
        vandal.send(garbage)
        assert vandal.ends()
    assert client.ask("02 04 02 00 07 01") == OK


def test_many_commands_in_one_segment_are_answered_in_order(client: RawClient) -> None:
    frames = ["02 04 02 00 03 01", "02 04 02 00 0A 01", "02 04 02 00 03 05", "02 63 00 00"] * 50
    client.send(" ".join(frames))
    codes = [client.frame()[4] for _ in frames]
    assert codes == [0, 1, 2, 4] * 50


def test_each_connection_has_its_own_broadcast(emulator: Running, client: RawClient) -> None:
    with RawClient(emulator.port) as other:
        other.frame()
        assert client.ask("02 01 01 00 C8") == OK
        for _ in range(20):
            assert len(readings(client.frame())) == 10
        assert other.ask("02 04 02 00 07 01") == OK  # nothing was broadcast to it before
        while not readings(client.frame())[7][0]:
            pass
        client.send("02 01 01 00 00")
        while client.frame() != bytes.fromhex(OK):
            pass
        client.socket.settimeout(0.2)
        with pytest.raises(TimeoutError):
            client.frame()


def test_there_are_no_more_clients_than_allowed() -> None:
    with running("--max-clients", "2") as emulator, RawClient(emulator.port) as one:
        with RawClient(emulator.port) as two, RawClient(emulator.port) as three:
            assert one.frame() == two.frame()
            assert three.ends()
        while True:  # a place is free as soon as the board notices
            with RawClient(emulator.port) as four:
                try:
                    assert four.frame()[1] == 0
                    break
                except OSError:
                    continue


def test_a_client_that_does_not_read_is_dropped_and_holds_up_no_other(
    emulator: Running, client: RawClient, control: Control
) -> None:
    lazy = socket.socket()
    lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    lazy.settimeout(20)
    with lazy:
        lazy.connect(("127.0.0.1", emulator.port))

        def ask_without_reading_the_answers() -> None:
            while True:
                lazy.sendall(bytes.fromhex("02 03 00 00") * 1000)
                assert client.ask("02 03 00 00") == OK

        with pytest.raises(OSError, match=r"reset|Broken pipe"):
            ask_without_reading_the_answers()
    assert control.ask(status=True)["dropped"] == 1


# --- faults, as a client sees them ---------------------------------------------------------------------


def test_a_short_trips_the_channel_with_nobody_connected_to_see(control: Control) -> None:
    assert control.ask(watch=True)["ok"]
    assert {line["channel"] for line in (control.line() for _ in range(10))} == set(range(10))
    with_fault = control.ask(fault="short", channel=2)
    lines = [with_fault, control.line()]
    while lines[-1].get("on", True):
        lines.append(control.line())
    assert {"ok": True} in lines
    assert lines[-1]["channel"] == 2
    assert lines[-1]["powered"] is False


def test_a_brown_out_shows_in_the_voltage_and_starves_the_device(client: RawClient, control: Control) -> None:
    control.ask(fault="brown-out", volts=14)
    on, current_a, voltage_v = request(client)[2]
    assert (on, current_a) == (1, 0.0)
    assert voltage_v == pytest.approx(14, abs=0.2)
    assert control.ask(status=True)["channels"][2]["powered"] is False


def test_garbage_never_looks_like_the_start_of_a_frame(client: RawClient, control: Control) -> None:
    for _ in range(600):
        control.ask(fault="garbage", size=1)
    assert 2 not in client.read(600)


def test_refused_connections_are_accepted_again_on_the_same_port(emulator: Running, control: Control) -> None:
    assert control.ask(fault="refuse")["ok"]
    with pytest.raises(ConnectionRefusedError):
        RawClient(emulator.port)
    assert control.ask(clear="all")["ok"]
    with RawClient(emulator.port) as client:
        assert client.frame()[1] == 0
