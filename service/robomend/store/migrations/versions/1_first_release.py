"""The schema of the first release: schema.py as it was then, which an empty database is made from.

Later steps follow this one: `revision = "2"`, `down_revision = "1"`, and `upgrade` with Alembic's operations.
"""

from __future__ import annotations

revision = "1"
down_revision = None


def upgrade() -> None:
    """Nothing: no released version had an older one."""
