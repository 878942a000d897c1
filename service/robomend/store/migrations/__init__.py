"""How a database of an older version gets to the current one.
Alembic runs env.py and the files in versions/.
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Connection

from robomend.errors import StoreError


def configuration(connection: Connection | None = None) -> Config:
    """Return Alembic's configuration; it needs no ini file."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


def upgrade(connection: Connection, found: str, to: str = "head") -> None:
    """Migrate in the transaction that `connection` is in: all steps, or none.

    Raises:
        StoreError: the version found is none of ours: a newer robomend was here.
    """
    config = configuration(connection)
    if found:
        try:
            ScriptDirectory.from_config(config).get_revision(found)
        except CommandError as error:
            raise StoreError(
                f"the database has schema {found!r}, which a newer robomend has written; upgrade this one"
            ) from error
    command.upgrade(config, to)
