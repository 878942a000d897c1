"""How a database of an older version gets to the current one.
Alembic runs env.py and the files in versions/, one for each change of schema.py since the first release.
"""

from __future__ import annotations

import re
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Connection

from robomend.errors import StoreError

_BEFORE_RELEASES = re.compile(r"00\d\d")
"""What schemas were called before the first release; since then they are 1, 2, 3, …"""


def upgrade(connection: Connection, found: str) -> None:
    """Migrate in the transaction that `connection` is in: all steps, or none.

    Raises:
        StoreError: the version found is a newer robomend's, or a development version's.
    """
    if _BEFORE_RELEASES.fullmatch(found):
        raise StoreError(
            f"the database has schema {found!r} of a development version from before the first release,"
            " which this robomend cannot read; name another database, or an empty folder"
        )
    config = Config()  # it needs no ini file
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.attributes["connection"] = connection
    try:
        ScriptDirectory.from_config(config).get_revision(found)
    except CommandError as error:
        raise StoreError(
            f"the database has schema {found!r}, which a newer robomend has written; upgrade this one"
        ) from error
    command.upgrade(config, "head")
