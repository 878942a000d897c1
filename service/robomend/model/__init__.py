"""The system description: from what the user writes to clauses with provenance."""
