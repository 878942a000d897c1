"""Commands that ask a running service, over the Python client."""
