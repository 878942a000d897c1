"""`python -m robomend_batch`: the command, for whoever has an interpreter and no path to its programs."""

from __future__ import annotations

from robomend_batch.main import main

if __name__ == "__main__":  # not in the workers, which import this module by another name
    main()
