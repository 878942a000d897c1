"""The REST client: Client for threads and scripts, AsyncClient for asyncio.

calls.py          what can be asked, as values      retry.py      when to ask again
asynchronous.py   AsyncClient: a method a call      sse.py        event streams, cut from bytes
sync.py           Client: made from it              errors.py     what can go wrong
"""

from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.calls import Versioned
from robomend_client.rest.errors import ApiError, ClientError, Unreachable
from robomend_client.rest.retry import NEVER, Retry
from robomend_client.rest.sync import Client

__all__ = ["NEVER", "ApiError", "AsyncClient", "Client", "ClientError", "Retry", "Unreachable", "Versioned"]
