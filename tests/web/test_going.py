"""How these tests go to a page, while others change this computer's network."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser, Error
from tests import browser as browsing


@pytest.mark.parametrize(
    ("said", "goes"), [("net::ERR_NETWORK_CHANGED at x", 2), ("net::ERR_ABORTED at x", 1)]
)
def test_only_a_network_that_changed_is_no_reason_to_give_up(
    said: str, goes: int, browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, asked = browser.new_page(), []

    def goto(*_: object, **__: object) -> None:
        asked.append(said)
        if len(asked) == 1:
            raise Error(said)

    monkeypatch.setattr(browsing, "GOTO", goto)
    if goes == 1:
        with pytest.raises(Error, match="ABORTED"):
            page.goto("about:blank")
    else:
        page.goto("about:blank")
    assert len(asked) == goes
    page.close()
