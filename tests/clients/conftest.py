"""What tests of an agent have in common: the service that it talks to, played by a double."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.clients.service_double import ServiceDouble, service_double


@pytest.fixture
def service() -> Iterator[ServiceDouble]:
    with service_double() as double:
        yield double
