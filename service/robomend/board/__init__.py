"""The power board's client side: codec (bytes), session (states), link (asyncio)."""
