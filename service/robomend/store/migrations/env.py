"""Alembic's entry: run the migrations on the connection that we were given, in its transaction."""

from __future__ import annotations

from alembic import context

from robomend.store.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite alters a table by copying it
)
context.run_migrations()
