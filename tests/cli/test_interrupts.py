"""Signals as facts: they end a wait where it stands, and nothing else."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from robomend.cli.interrupts import Interrupted, Interrupts


def test_a_signal_ends_a_wait_and_every_wait_after_it() -> None:
    with Interrupts() as interrupts:
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(Interrupted):
            interrupts.wait(30)
        with pytest.raises(Interrupted) as again:
            interrupts.check()
    assert again.value.number == signal.SIGINT


def test_between_two_waits_a_signal_breaks_nothing_off() -> None:
    with Interrupts() as interrupts:
        os.kill(os.getpid(), signal.SIGTERM)
        done = "what must be whole is done"
        assert done
        with pytest.raises(Interrupted):
            interrupts.wait(0)


def test_a_wait_ends_early_when_there_is_something_to_read() -> None:
    reader, writer = os.pipe()
    with Interrupts() as interrupts:
        assert interrupts.wait(0, reader) is False
        os.write(writer, b"!")
        assert interrupts.wait(30, reader) is True
    os.close(reader)
    os.close(writer)
