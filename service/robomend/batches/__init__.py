"""Batches: logs that somebody hands in over HTTP, diagnosed by `robomend-batch` in processes of its own.

log_names.py   which names logs may have: below batch_folder, and of uploads
folders.py     where the files of a batch are, who holds them, and what is left over
child.py       what runs before the program in its process: it ends with the service, and has limits
program.py     what is asked for; the program that does it, started and ended with all its processes
record.py      the states of a batch, and what is written of it, with its event and audit entry
one_batch.py   one batch, from its beginning or from where a crash left it
batches.py     those of this folder; what the HTTP interface asks of them
"""
