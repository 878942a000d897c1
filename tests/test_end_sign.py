"""The end of a thread that looks again and again: it is waited for, and it stays."""

from __future__ import annotations

import threading

from robomend.end_sign import EndSign


def test_a_wait_ends_with_the_sign_and_every_later_one_at_once() -> None:
    sign, ends = EndSign(), []
    waiting = threading.Thread(target=lambda: ends.append(sign.wait(60.0)))
    waiting.start()
    assert not sign.is_set()
    sign.set()
    waiting.join(30.0)
    assert ends == [True]
    assert sign.is_set()
    assert sign.wait(60.0)


def test_without_it_a_wait_lasts_as_long_as_it_may() -> None:
    sign = EndSign()
    assert not sign.wait(0.0)
    assert not sign.wait(0.001)


def test_it_may_come_twice() -> None:
    sign = EndSign()
    sign.set()
    sign.set()
    assert sign.wait(0.0)
