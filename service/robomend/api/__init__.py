"""The HTTP interface: routers that translate and delegate, and what stands before them."""
